"""A flight from its start to its end: control ticks, steps between them, cut-off and touchdown where they happen."""

from __future__ import annotations

from math import isfinite, nan
from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import quaternion_at, quaternion_rate
from lidar_emu.numerics.vectors import store, vector_at
from lidar_emu.trajectory.powered.actuators import Acting, Lags, commanded, mass_after, thrust_after
from lidar_emu.trajectory.powered.contact import lowest_foot_m
from lidar_emu.trajectory.powered.control import Guide, asked_at, throttle, turning_torque
from lidar_emu.trajectory.powered.motion import gravity_at, inertia_at
from lidar_emu.trajectory.powered.steps import StepSizes, next_step_s, set_slope, set_stepped, step_to_height
from lidar_emu.trajectory.powered.vehicle import ATTITUDE, POSITION, RATE, SIZE, VELOCITY, VehicleConstants

BURNING, FALLING, STANDING = 0, 1, 2
ENDED, EMPTY, LOST, ALOFT, CROWDED = 0, 1, 2, 3, 4
"""Outcomes of a flight: landed, out of propellant, no longer finite, still aloft, or too many steps."""
SLOPE = 14
"""Numbers of a slope: first, then second derivatives of position and quaternion."""


class Schedule(NamedTuple):
    """Times, heights and limits at which the phases of a flight change."""

    control_period_s: float
    cut_off_m: float
    after_touchdown_s: float
    longest_s: float
    dry_kg: float
    most_steps: int


class Record(NamedTuple):
    """Steps of a flight; arrays without rows are not written to."""

    time_s: FloatArray
    """(steps + 1,) At the start of each step, and at the end of the last."""
    state: FloatArray
    """(steps + 1, 21)"""
    mass_and_thrust: FloatArray
    """(steps + 1, 2)"""
    start: FloatArray
    """(steps, 14) Slope where a step starts,"""
    end: FloatArray
    """(steps, 14) and where it ends: a command may change it there."""


class Course(NamedTuple):
    """Outcome of a flight."""

    outcome: int
    steps: int
    end_s: float
    cut_off_s: float
    touchdown_s: float


@kernel(outermost=True)
def fly(
    body: VehicleConstants,
    lags: Lags,
    guide: Guide,
    schedule: Schedule,
    step_sizes: StepSizes,
    acting: Acting,
    state: FloatArray,
    slopes: FloatArray,
    stepped: FloatArray,
    record: Record,
) -> Course:
    """Fly a state (21,) on to the end, with scratch space (4, 21) and (21,)."""
    phase, tick, steps = BURNING, 0, 0
    now_s, since_s, end_s = 0.0, 0.0, schedule.longest_s
    cut_off_s = touchdown_s = nan
    while now_s < end_s:
        acting = commands(body, lags, guide, phase, now_s, since_s, acting, state)
        since_s = 0.0
        tick += 1
        until_s = min(tick * schedule.control_period_s, end_s)
        while now_s < until_s and steps <= schedule.most_steps:
            set_slope(body, lags, acting, since_s, state, slopes[0])
            note_start(record, lags, acting, steps, now_s, since_s, state, slopes[0])
            remaining_s = until_s - now_s
            step_s = next_step_s(
                step_sizes,
                step_sizes.standing_s if phase == STANDING else step_sizes.longest_s,
                since_s,
                remaining_s,
            )
            set_stepped(body, lags, acting, since_s, step_s, state, slopes, stepped)
            event_m = schedule.cut_off_m if phase == BURNING else 0.0
            reached = phase != STANDING and lowest_foot_m(body, stepped) <= event_m
            if reached:
                step_s = step_to_height(body, lags, acting, since_s, step_s, event_m, state, slopes, stepped)
            since_s += step_s
            now_s = until_s if step_s == remaining_s else now_s + step_s
            take(state, stepped)
            set_slope(body, lags, acting, since_s, state, slopes[0])
            note_end(record, steps, state, slopes[0])
            steps += 1
            if reached:
                if phase == BURNING:
                    phase, cut_off_s = FALLING, now_s
                if event_m == 0.0:
                    phase, touchdown_s, end_s = STANDING, now_s, now_s + schedule.after_touchdown_s
                    until_s = min(until_s, end_s)
                acting = commands(body, lags, guide, phase, now_s, since_s, acting, state)
                since_s = 0.0
        if not isfinite(state.sum()):
            return Course(LOST, steps, now_s, cut_off_s, touchdown_s)
        if mass_after(acting, lags, since_s) < schedule.dry_kg:
            return Course(EMPTY, steps, now_s, cut_off_s, touchdown_s)
        if steps > schedule.most_steps:
            return Course(CROWDED, steps, now_s, cut_off_s, touchdown_s)
    note_last(record, lags, acting, steps, now_s, since_s, state)
    return Course(ENDED if phase == STANDING else ALOFT, steps, now_s, cut_off_s, touchdown_s)


@kernel
def commands(
    body: VehicleConstants,
    lags: Lags,
    guide: Guide,
    phase: int,
    time_s: float,
    since_s: float,
    acting: Acting,
    state: FloatArray,
) -> Acting:
    """Engine and control while burning, control alone while falling, neither on the ground."""
    if phase == STANDING:
        return commanded(acting, lags, since_s, 0.0, (0.0, 0.0, 0.0))
    mass_kg = mass_after(acting, lags, since_s)
    gravity = gravity_at(body, vector_at(state, POSITION))
    asked = asked_at(guide, time_s, gravity, state)
    torque_nm = turning_torque(guide, inertia_at(body, mass_kg), asked, state)
    thrust_n = throttle(guide, mass_kg, asked, state) if phase == BURNING else 0.0
    return commanded(acting, lags, since_s, thrust_n, torque_nm)


@kernel
def note_start(
    record: Record,
    lags: Lags,
    acting: Acting,
    step: int,
    time_s: float,
    since_s: float,
    state: FloatArray,
    slope: FloatArray,
) -> None:
    if len(record.time_s) > 0:
        note_last(record, lags, acting, step, time_s, since_s, state)
        set_second_order(state, slope, record.start[step])


@kernel
def note_end(record: Record, step: int, state: FloatArray, slope: FloatArray) -> None:
    if len(record.time_s) > 0:
        set_second_order(state, slope, record.end[step])


@kernel
def note_last(
    record: Record, lags: Lags, acting: Acting, step: int, time_s: float, since_s: float, state: FloatArray
) -> None:
    """The motion at an instant, without its slope."""
    if len(record.time_s) > 0:
        record.time_s[step] = time_s
        record.mass_and_thrust[step, 0] = mass_after(acting, lags, since_s)
        record.mass_and_thrust[step, 1] = thrust_after(acting, lags, since_s)
        take(record.state[step], state)


@kernel
def take(target: FloatArray, source: FloatArray) -> None:
    """Copy a state; assigning a slice would make numba allocate a temporary array."""
    for i in range(SIZE):
        target[i] = source[i]


@kernel
def set_second_order(state: FloatArray, slope: FloatArray, row: FloatArray) -> None:
    """First and second derivatives of position and quaternion, (14,)."""
    store(row, 0, vector_at(state, VELOCITY))
    store(row, 7, vector_at(slope, VELOCITY))
    turn, spin = quaternion_at(state, ATTITUDE), quaternion_at(slope, ATTITUDE)
    onward = quaternion_rate(spin, vector_at(state, RATE))
    turned = quaternion_rate(turn, vector_at(slope, RATE))
    for i in range(4):
        row[3 + i] = spin[i]
        row[10 + i] = onward[i] + turned[i]
