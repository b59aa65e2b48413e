"""Solution of a powered descent: the whole flight is integrated before the run."""

from __future__ import annotations

from math import cos, hypot, inf, radians, sin, sqrt, tan
from typing import NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import (
    SITE_FROM_NED,
    compose,
    cross,
    from_yaw_pitch_roll,
    rotate,
    to_quaternion,
)
from lidar_emu.numerics.vectors import vector_at
from lidar_emu.scenario.trajectory import Polynomial, PoweredDescent
from lidar_emu.trajectory.powered.actuators import Acting, Lags
from lidar_emu.trajectory.powered.control import GIVEN_UP_S, Guide, asked_at
from lidar_emu.trajectory.powered.integration import (
    ALOFT,
    CROWDED,
    EMPTY,
    LOST,
    SLOPE,
    Course,
    Record,
    Schedule,
    fly,
)
from lidar_emu.trajectory.powered.motion import gravity_at
from lidar_emu.trajectory.powered.steps import StepSizes
from lidar_emu.trajectory.powered.vehicle import (
    ATTITUDE,
    HANG,
    POSITION,
    RATE,
    SIZE,
    STANDARD_GRAVITY_MPS2,
    VELOCITY,
    VehicleConstants,
    vehicle_constants,
)

MOST_STEPS = 500_000
"""Kept in memory, 416 bytes each."""
PER_SWING = 0.2
"""Longest step times the frequency of the slosh, of the bending mode and of the spin at the start, in radians."""
PER_BOUNCE = 0.1
"""Longest step on the ground times the frequency of the feet."""


class Descent(NamedTuple):
    """All that the kernel takes: who flies, how, and from where."""

    body: VehicleConstants
    lags: Lags
    guide: Guide
    schedule: Schedule
    step_sizes: StepSizes
    acting: Acting
    state: FloatArray
    """(21,) At the start."""


def prepare(part: PoweredDescent, body_radius_m: float = inf) -> Descent:
    """The numbers of a scenario's descent over a body of some radius (infinite: uniform gravity)."""
    vehicle = part.vehicle
    body = vehicle_constants(vehicle, part.gravity_mps2, body_radius_m, part.target.up_m)
    guide = _guide(part)
    state = _start(part, body, guide)
    weight_n = vehicle.mass_kg * part.gravity_mps2
    thrust_n = min(max(weight_n, vehicle.engine.minimum_thrust_n), vehicle.engine.maximum_thrust_n)
    none = (0.0, 0.0, 0.0)
    return Descent(
        body=body,
        lags=Lags(
            vehicle.engine.valve_lag_s,
            vehicle.attitude_control.lag_s,
            vehicle.engine.specific_impulse_s * STANDARD_GRAVITY_MPS2,
        ),
        guide=guide,
        schedule=Schedule(
            1 / part.control_rate_hz,
            part.cut_off_height_m,
            part.after_touchdown_s,
            part.longest_s,
            vehicle.dry_mass_kg,
            MOST_STEPS,
        ),
        step_sizes=_step_sizes(part, body),
        acting=Acting(thrust_n, vehicle.mass_kg, none, thrust_n, none),
        state=state,
    )


def solve(descent: Descent) -> tuple[Course, Record]:
    """Fly it twice: to count the steps, and to note them."""
    counted = _fly(descent, _record(0))
    record = _record(counted.steps)
    return _fly(descent, record), record


def fly_descent(part: PoweredDescent, body_radius_m: float = inf) -> tuple[Course, Record]:
    """The flight of a scenario.

    Raises:
        InputError: it runs out of propellant, never lands, or its numbers leave what can be computed.
    """
    descent = prepare(part, body_radius_m)
    course, record = solve(descent)
    refusal = {
        EMPTY: ("vehicle.dry_mass_kg", "tanks empty", "a flight that lands with propellant left"),
        ALOFT: ("longest_s", "not on the ground", "a flight that lands before longest_s"),
        LOST: ("step_s", "motion no longer finite", "a vehicle that step_s can follow"),
        CROWDED: ("step_s", f"{MOST_STEPS} steps", "a longer step_s, control period or lag"),
    }.get(course.outcome)
    if refusal is not None:
        key, found, allowed = refusal
        raise InputError(
            "trajectory", key, Finding(f"{found} after {course.end_s:.2f} s"), f"allowed: {allowed}"
        )
    return course, record


def _fly(descent: Descent, record: Record) -> Course:
    body, lags, guide, schedule, step_sizes, acting, state = descent
    slopes, stepped = np.empty((4, SIZE)), np.empty(SIZE)
    return Course(
        *fly(body, lags, guide, schedule, step_sizes, acting, state.copy(), slopes, stepped, record)
    )


def _record(steps: int) -> Record:
    """Empty arrays for a number of steps; without rows where there are none."""
    knots = steps + 1 if steps else 0
    slopes = np.empty((steps, SLOPE)), np.empty((steps, SLOPE))
    return Record(np.empty(knots), np.empty((knots, SIZE)), np.empty((knots, 2)), *slopes)


def _guide(part: PoweredDescent) -> Guide:
    engine, control, target = part.vehicle.engine, part.vehicle.attitude_control, part.target
    heading = radians(part.heading_deg)
    gate_up_m = target.up_m + part.vehicle.gear.below_m + part.gate_height_m
    gate_m = (target.east_m, target.north_m, gate_up_m)
    gate_s = 0.0
    if isinstance(part.guidance, Polynomial):
        asked_s = part.guidance.time_to_gate_s
        gate_s = _time_to_gate_s(part, gate_m) if asked_s is None else asked_s
    return Guide(
        polynomial=isinstance(part.guidance, Polynomial),
        gate_m=gate_m,
        gate_s=gate_s,
        descent_mps=part.descent_speed_mps,
        steepest=tan(radians(part.maximum_tilt_deg)),
        heading=(sin(heading), cos(heading), 0.0),
        least_n=engine.minimum_thrust_n,
        most_n=engine.maximum_thrust_n,
        bandwidth_radps=control.bandwidth_radps,
        most_torque_nm=control.maximum_torque_nm,
        most_rate_radps=radians(control.maximum_rate_degps),
    )


def _time_to_gate_s(part: PoweredDescent, gate_m: tuple[float, float, float]) -> float:
    """Distance over the mean of the speeds at its ends, and never so short that the polynomial is left at once."""
    (east_m, north_m, up_m), velocity = part.start.position_site_m, part.start.velocity_site_mps
    distance_m = hypot(east_m - gate_m[0], north_m - gate_m[1], up_m - gate_m[2])
    return max(2 * distance_m / (hypot(*velocity) + part.descent_speed_mps), 2 * GIVEN_UP_S)


def _step_sizes(part: PoweredDescent, body: VehicleConstants) -> StepSizes:
    longest_s = min(part.step_s, 1 / part.control_rate_hz, PER_SWING / max(_swings_radps(part, body)))
    rigid_kg = part.vehicle.dry_mass_kg - body.slosh_kg
    bounce_radps = sqrt(len(body.feet_m) * body.stiffness_npm / rigid_kg)
    lags = [lag for lag in (part.vehicle.engine.valve_lag_s, part.vehicle.attitude_control.lag_s) if lag > 0]
    first_s = min([longest_s, *(lag / 4 for lag in lags)])
    return StepSizes(first_s, 0.5, longest_s, min(longest_s, PER_BOUNCE / bounce_radps))


def _swings_radps(part: PoweredDescent, body: VehicleConstants) -> list[float]:
    """Highest frequencies of what steps have to follow in flight; the first is the vehicle's own control."""
    vehicle, spin = part.vehicle, part.start.attitude
    swings = [vehicle.attitude_control.bandwidth_radps]
    if spin is not None:
        swings.append(hypot(*spin.body_rate_radps))
    if vehicle.slosh is not None:
        pushed_mps2 = vehicle.engine.maximum_thrust_n / (vehicle.dry_mass_kg - body.slosh_kg)
        swings.append(sqrt(pushed_mps2 / body.rod_m))
    if vehicle.flexible_mode is not None:
        # The body swings against the mode, which makes that faster than with the body held.
        swings.append(body.bend_radps / sqrt(1 - sum(vehicle.flexible_mode.inertia_share)))
    return swings


def _start(part: PoweredDescent, body: VehicleConstants, guide: Guide) -> FloatArray:
    """The slosh hangs along the engine, at rest in the body."""
    state = np.zeros(SIZE)
    state[POSITION : POSITION + 3] = part.start.position_site_m
    state[VELOCITY : VELOCITY + 3] = part.start.velocity_site_mps
    attitude = part.start.attitude
    if attitude is None:
        gravity = gravity_at(body, vector_at(state, POSITION))
        site_from_body = _pointing(np.array(asked_at(guide, 0.0, gravity, state)), np.array(guide.heading))
    else:
        angles = np.radians([attitude.yaw_deg, attitude.pitch_deg, attitude.roll_deg])
        site_from_body = compose(SITE_FROM_NED, from_yaw_pitch_roll(*angles))
        state[RATE : RATE + 3] = attitude.body_rate_radps
    state[ATTITUDE : ATTITUDE + 4] = to_quaternion(site_from_body)
    state[HANG : HANG + 3] = site_from_body[:, 2]
    rod = np.array([0.0, 0.0, body.rod_m])
    state[HANG + 3 : HANG + 6] = rotate(site_from_body, cross(state[RATE : RATE + 3], rod))
    return state


def _pointing(thrust: FloatArray, heading: FloatArray) -> FloatArray:
    """site_from_body with body -z along the thrust and body x towards the heading."""
    z = -thrust / np.sqrt(np.sum(thrust**2))
    y = cross(z, heading)
    y /= np.sqrt(np.sum(y**2))
    return np.stack([cross(y, z), y, z], axis=-1)
