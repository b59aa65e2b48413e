"""Integration of a powered descent: control ticks, steps between them, cut-off and touchdown at their instants.

The steps after a command begin at a quarter of the shortest lag and grow with the time since the command, so that they
resolve the exponentials of `actuators` for any lag.
"""

from __future__ import annotations

from math import isfinite, nan
from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import quaternion_at, quaternion_rate, store, vector_at
from lidar_emu.trajectory.powered.control import (
    GuidanceConstants,
    attitude_torque,
    specific_thrust_at,
    throttle,
)
from lidar_emu.trajectory.powered.dynamics import (
    ATTITUDE,
    POSITION,
    RATE,
    SIZE,
    VELOCITY,
    ActuatorState,
    Lags,
    VehicleConstants,
    gravity_at,
    inertia_at,
    lowest_foot_m,
    mass_after,
    set_derivative,
    thrust_after,
    torque_after,
    with_command,
)

BISECTIONS = 52
"""Bisections of a step in the search for an event: down to the last bit."""


class StepSizes(NamedTuple):
    """Lengths of steps."""

    first_s: float
    """First step after a command."""
    growth: float
    """Largest next step, as a fraction of the time since the command."""
    longest_s: float
    standing_s: float
    """Longest step on the ground."""


@kernel
def next_step_s(step_sizes: StepSizes, longest_s: float, since_s: float, remaining_s: float) -> float:
    """Length of the next step; the last two before the end of an interval have equal lengths."""
    step_s = min(longest_s, max(step_sizes.first_s, step_sizes.growth * since_s))
    if step_s >= remaining_s:
        return remaining_s
    return min(step_s, 0.5 * remaining_s) if 2.0 * step_s > remaining_s else step_s


@kernel
def set_slope(
    body: VehicleConstants,
    lags: Lags,
    actuators: ActuatorState,
    since_s: float,
    state: FloatArray,
    slope: FloatArray,
) -> None:
    """Set the derivative of a state at a time since the last command."""
    mass_kg, thrust_n = mass_after(actuators, lags, since_s), thrust_after(actuators, lags, since_s)
    set_derivative(body, mass_kg, thrust_n, torque_after(actuators, lags, since_s), state, slope)


@kernel
def runge_kutta_step(
    body: VehicleConstants,
    lags: Lags,
    actuators: ActuatorState,
    since_s: float,
    step_s: float,
    state: FloatArray,
    slopes: FloatArray,
    stepped: FloatArray,
) -> None:
    """Set the state (13,) one step later; `slopes` (4, 13) holds the slope at the present state in its first row."""
    half_s = 0.5 * step_s
    add_scaled(state, half_s, slopes[0], stepped)
    set_slope(body, lags, actuators, since_s + half_s, stepped, slopes[1])
    add_scaled(state, half_s, slopes[1], stepped)
    set_slope(body, lags, actuators, since_s + half_s, stepped, slopes[2])
    add_scaled(state, step_s, slopes[2], stepped)
    set_slope(body, lags, actuators, since_s + step_s, stepped, slopes[3])
    for i in range(SIZE):
        mean = (slopes[0, i] + 2.0 * (slopes[1, i] + slopes[2, i]) + slopes[3, i]) / 6.0
        stepped[i] = state[i] + step_s * mean


@kernel
def add_scaled(state: FloatArray, by_s: float, slope: FloatArray, moved: FloatArray) -> None:
    for i in range(SIZE):
        moved[i] = state[i] + by_s * slope[i]


@kernel
def step_to_height(
    body: VehicleConstants,
    lags: Lags,
    actuators: ActuatorState,
    since_s: float,
    step_s: float,
    height_m: float,
    state: FloatArray,
    slopes: FloatArray,
    stepped: FloatArray,
) -> float:
    """Length of the step at whose end the lowest foot reaches a height, given a step that ends below it.

    Each trial is a step of its own length from the same state, so that the event has the accuracy of the method.
    """
    above_s, below_s = 0.0, step_s
    for _ in range(BISECTIONS):
        middle_s = 0.5 * (above_s + below_s)
        runge_kutta_step(body, lags, actuators, since_s, middle_s, state, slopes, stepped)
        if lowest_foot_m(body, stepped) > height_m:
            above_s = middle_s
        else:
            below_s = middle_s
    runge_kutta_step(body, lags, actuators, since_s, below_s, state, slopes, stepped)
    return below_s


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
        if not _is_bounded(state):
            return FlightOutcome(NOT_FINITE, steps, now_s, cut_off_s, touchdown_s)
        if mass_after(actuators, lags, since_s) < schedule.dry_kg:
            return FlightOutcome(OUT_OF_PROPELLANT, steps, now_s, cut_off_s, touchdown_s)
        if steps > schedule.maximum_steps:
            return FlightOutcome(TOO_MANY_STEPS, steps, now_s, cut_off_s, touchdown_s)
    if recording:
        record_state(record, lags, actuators, steps, now_s, since_s, state)
    return FlightOutcome(LANDED if phase == STANDING else NOT_LANDED, steps, now_s, cut_off_s, touchdown_s)


@kernel
def _is_bounded(state: FloatArray) -> bool:
    """Whether the squares of a state are finite: a motion that diverges passes 1e154 m/s long before infinity."""
    squares = 0.0
    for k in range(len(state)):
        squares += state[k] * state[k]
    return isfinite(squares)


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
