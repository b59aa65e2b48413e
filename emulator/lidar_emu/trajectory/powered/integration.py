"""Integration of a powered descent: control ticks, steps between them, cut-off and touchdown at their instants."""

from __future__ import annotations

from math import isfinite, nan
from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import quaternion_at, quaternion_rate
from lidar_emu.numerics.vectors import store, vector_at
from lidar_emu.trajectory.powered.actuators import ActuatorState, Lags, mass_after, thrust_after, with_command
from lidar_emu.trajectory.powered.contact import lowest_foot_m
from lidar_emu.trajectory.powered.control import (
    GuidanceConstants,
    attitude_torque,
    specific_thrust_at,
    throttle,
)
from lidar_emu.trajectory.powered.motion import gravity_at, inertia_at
from lidar_emu.trajectory.powered.steps import (
    StepSizes,
    next_step_s,
    runge_kutta_step,
    set_slope,
    step_to_height,
)
from lidar_emu.trajectory.powered.vehicle import ATTITUDE, POSITION, RATE, SIZE, VELOCITY, VehicleConstants

BURNING, FALLING, STANDING = 0, 1, 2
LANDED, OUT_OF_PROPELLANT, NOT_FINITE, NOT_LANDED, TOO_MANY_STEPS = 0, 1, 2, 3, 4
"""Outcomes of a flight: landed, out of propellant, no longer finite, still aloft, or too many steps."""
SLOPE_SIZE = 14
"""Size of a recorded slope: first, then second derivatives of position and quaternion."""


class Schedule(NamedTuple):
    """Times, heights and limits at which the phases of a flight change."""

    control_period_s: float
    cut_off_m: float
    after_touchdown_s: float
    longest_s: float
    dry_kg: float
    maximum_steps: int


class Descent(NamedTuple):
    """Arguments of the integration: vehicle, guidance, schedule, step sizes and initial state."""

    body: VehicleConstants
    lags: Lags
    guide: GuidanceConstants
    schedule: Schedule
    step_sizes: StepSizes
    actuators: ActuatorState
    state: FloatArray
    """(13,) Initial state."""


class StepHistory(NamedTuple):
    """Recorded steps of a flight; arrays without rows are not written."""

    time_s: FloatArray
    """(steps + 1,) At the start of each step, and at the end of the last."""
    state: FloatArray
    """(steps + 1, 13)"""
    mass_and_thrust: FloatArray
    """(steps + 1, 2)"""
    start: FloatArray
    """(steps, 14) Slope at the start of each step."""
    end: FloatArray
    """(steps, 14) Slope at its end, which differs from the next start where a command changes it."""


class FlightOutcome(NamedTuple):
    """Outcome of a flight."""

    status: int
    steps: int
    end_s: float
    cut_off_s: float
    touchdown_s: float


@kernel(outermost=True)
def fly(descent: Descent, slopes: FloatArray, stepped: FloatArray, record: StepHistory) -> FlightOutcome:
    """Integrate the initial state, which is overwritten, to the end of the flight, with buffers (4, 13) and (13,)."""
    body, lags, guide, schedule, step_sizes, actuators, state = descent
    phase, tick, steps, recording = BURNING, 0, 0, len(record.time_s) > 0
    now_s, since_s, end_s = 0.0, 0.0, schedule.longest_s
    cut_off_s = touchdown_s = nan
    while now_s < end_s:
        actuators = commands(body, lags, guide, phase, now_s, since_s, actuators, state)
        since_s = 0.0
        tick += 1
        until_s = min(tick * schedule.control_period_s, end_s)
        while now_s < until_s and steps <= schedule.maximum_steps:
            set_slope(body, lags, actuators, since_s, state, slopes[0])
            if recording:
                record_state(record, lags, actuators, steps, now_s, since_s, state)
                set_derivatives(state, slopes[0], record.start[steps])
            remaining_s = until_s - now_s
            step_s = next_step_s(
                step_sizes,
                step_sizes.standing_s if phase == STANDING else step_sizes.longest_s,
                since_s,
                remaining_s,
            )
            runge_kutta_step(body, lags, actuators, since_s, step_s, state, slopes, stepped)
            event_m = schedule.cut_off_m if phase == BURNING else 0.0
            reached = phase != STANDING and lowest_foot_m(body, stepped) <= event_m
            if reached:
                step_s = step_to_height(
                    body, lags, actuators, since_s, step_s, event_m, state, slopes, stepped
                )
            since_s += step_s
            now_s = until_s if step_s == remaining_s else now_s + step_s
            copy_state(state, stepped)
            set_slope(body, lags, actuators, since_s, state, slopes[0])
            if recording:
                set_derivatives(state, slopes[0], record.end[steps])
            steps += 1
            if reached:
                if phase == BURNING:
                    phase, cut_off_s = FALLING, now_s
                if event_m == 0.0:
                    phase, touchdown_s, end_s = STANDING, now_s, now_s + schedule.after_touchdown_s
                    until_s = min(until_s, end_s)
                actuators = commands(body, lags, guide, phase, now_s, since_s, actuators, state)
                since_s = 0.0
        if not isfinite(state.sum()):
            return FlightOutcome(NOT_FINITE, steps, now_s, cut_off_s, touchdown_s)
        if mass_after(actuators, lags, since_s) < schedule.dry_kg:
            return FlightOutcome(OUT_OF_PROPELLANT, steps, now_s, cut_off_s, touchdown_s)
        if steps > schedule.maximum_steps:
            return FlightOutcome(TOO_MANY_STEPS, steps, now_s, cut_off_s, touchdown_s)
    if recording:
        record_state(record, lags, actuators, steps, now_s, since_s, state)
    return FlightOutcome(LANDED if phase == STANDING else NOT_LANDED, steps, now_s, cut_off_s, touchdown_s)


@kernel
def commands(
    body: VehicleConstants,
    lags: Lags,
    guide: GuidanceConstants,
    phase: int,
    time_s: float,
    since_s: float,
    actuators: ActuatorState,
    state: FloatArray,
) -> ActuatorState:
    """Command engine and attitude control under thrust, attitude control alone in free fall, neither on the ground."""
    if phase == STANDING:
        return with_command(actuators, lags, since_s, 0.0, (0.0, 0.0, 0.0))
    mass_kg = mass_after(actuators, lags, since_s)
    gravity = gravity_at(body, vector_at(state, POSITION))
    thrust_mps2 = specific_thrust_at(guide, time_s, gravity, state)
    torque_nm = attitude_torque(guide, inertia_at(body, mass_kg), thrust_mps2, state)
    thrust_n = throttle(guide, mass_kg, thrust_mps2, state) if phase == BURNING else 0.0
    return with_command(actuators, lags, since_s, thrust_n, torque_nm)


@kernel
def record_state(
    record: StepHistory,
    lags: Lags,
    actuators: ActuatorState,
    step: int,
    time_s: float,
    since_s: float,
    state: FloatArray,
) -> None:
    """Record time, state, mass and thrust at an instant."""
    record.time_s[step] = time_s
    record.mass_and_thrust[step, 0] = mass_after(actuators, lags, since_s)
    record.mass_and_thrust[step, 1] = thrust_after(actuators, lags, since_s)
    copy_state(record.state[step], state)


@kernel
def copy_state(target: FloatArray, source: FloatArray) -> None:
    """Copy a state; assigning a slice would make numba allocate a temporary array."""
    for i in range(SIZE):
        target[i] = source[i]


@kernel
def set_derivatives(state: FloatArray, slope: FloatArray, row: FloatArray) -> None:
    """Set the first and second derivatives of position and quaternion, (14,)."""
    store(row, 0, vector_at(state, VELOCITY))
    store(row, 7, vector_at(slope, VELOCITY))
    turn, spin = quaternion_at(state, ATTITUDE), quaternion_at(slope, ATTITUDE)
    onward = quaternion_rate(spin, vector_at(state, RATE))
    turned = quaternion_rate(turn, vector_at(slope, RATE))
    for i in range(4):
        row[3 + i] = spin[i]
        row[10 + i] = onward[i] + turned[i]
