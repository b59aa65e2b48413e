"""Solution of a powered descent: the whole flight is integrated before the run.

Within a step, velocity and the derivative of the quaternion are cubics through their values and derivatives at its
ends, so that acceleration and rates follow the equations of motion; position and quaternion are their integrals from
the start of the step. Differences of positions, which a very short step before an event would magnify, are not formed.
The error is of fourth order in the step, like the integration's.
"""

from __future__ import annotations

from math import cos, hypot, inf, radians, sin, sqrt, tan

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vector_arrays import (
    SITE_FROM_NED,
    compose,
    cross,
    from_quaternions,
    from_yaw_pitch_roll,
)
from lidar_emu.numerics.vectors import to_quaternion, vector_at
from lidar_emu.scenario.trajectory import Polynomial, PoweredDescent
from lidar_emu.trajectory.curves import piece_at
from lidar_emu.trajectory.powered.control import POLYNOMIAL_END_S, GuidanceConstants, specific_thrust_at
from lidar_emu.trajectory.powered.dynamics import (
    ATTITUDE,
    POSITION,
    RATE,
    SIZE,
    STANDARD_GRAVITY_MPS2,
    VELOCITY,
    ActuatorState,
    Lags,
    VehicleConstants,
    gravity_at,
    vehicle_constants,
)
from lidar_emu.trajectory.powered.integration import (
    NOT_FINITE,
    NOT_LANDED,
    OUT_OF_PROPELLANT,
    SLOPE_SIZE,
    TOO_MANY_STEPS,
    Descent,
    FlightOutcome,
    Schedule,
    StepHistory,
    StepSizes,
    fly,
)
from lidar_emu.trajectory.profile import Trajectory, VehicleState

MAXIMUM_STEPS = 500_000
"""Recorded steps occupy 352 bytes each."""
PHASE_PER_STEP = 0.2
"""Longest step times the bandwidth of attitude control, or the spin at the start, in radians."""
BOUNCE_PHASE_PER_STEP = 0.1
"""Longest step on the ground times the frequency of the feet."""


def prepare(part: PoweredDescent, body_radius_m: float = inf) -> Descent:
    """Arguments of the integration for a scenario; an infinite body radius makes gravity uniform."""
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
            MAXIMUM_STEPS,
        ),
        step_sizes=_step_sizes(part, body),
        actuators=ActuatorState(thrust_n, vehicle.mass_kg, none, thrust_n, none),
        state=state,
    )


def solve(descent: Descent) -> tuple[FlightOutcome, StepHistory]:
    """Integrate twice: to count the steps, and to record them."""
    counted = _fly(descent, _record(0))
    record = _record(counted.steps)
    return _fly(descent, record), record


def fly_descent(part: PoweredDescent, body_radius_m: float = inf) -> tuple[FlightOutcome, StepHistory]:
    """Solve the powered descent of a scenario.

    Raises:
        InputError: the vehicle runs out of propellant or does not land, or its motion overflows.
    """
    descent = prepare(part, body_radius_m)
    outcome, record = solve(descent)
    refusal = {
        OUT_OF_PROPELLANT: (
            "vehicle.dry_mass_kg",
            "out of propellant",
            "shorten the flight, or carry more",
        ),
        NOT_LANDED: ("longest_s", "not on the ground", "raise it, or change guidance or engine"),
        NOT_FINITE: ("step_s", "motion no longer finite", "choose a vehicle that step_s can follow"),
        TOO_MANY_STEPS: ("step_s", f"{MAXIMUM_STEPS} steps", "use a longer step_s, control period or lag"),
    }.get(outcome.status)
    if refusal is not None:
        key, found, remedy = refusal
        raise InputError("trajectory", key, Finding(f"{found} after {outcome.end_s:.2f} s"), remedy)
    return outcome, record


def _fly(descent: Descent, record: StepHistory) -> FlightOutcome:
    descent = descent._replace(state=descent.state.copy())
    return FlightOutcome(*fly(descent, np.empty((4, SIZE)), np.empty(SIZE), record))


def _record(steps: int) -> StepHistory:
    knots = steps + 1 if steps else 0
    slopes = np.empty((steps, SLOPE_SIZE)), np.empty((steps, SLOPE_SIZE))
    return StepHistory(np.empty(knots), np.empty((knots, SIZE)), np.empty((knots, 2)), *slopes)


def _guide(part: PoweredDescent) -> GuidanceConstants:
    engine, control, target = part.vehicle.engine, part.vehicle.attitude_control, part.target
    heading = radians(part.heading_deg)
    gate_up_m = target.up_m + part.vehicle.gear.below_m + part.gate_height_m
    gate_m = (target.east_m, target.north_m, gate_up_m)
    gate_s = 0.0
    if isinstance(part.guidance, Polynomial):
        asked_s = part.guidance.time_to_gate_s
        gate_s = _time_to_gate_s(part, gate_m) if asked_s is None else asked_s
    return GuidanceConstants(
        polynomial=isinstance(part.guidance, Polynomial),
        gate_m=gate_m,
        gate_s=gate_s,
        descent_mps=part.descent_speed_mps,
        tangent_maximum_tilt=tan(radians(part.maximum_tilt_deg)),
        heading=(sin(heading), cos(heading), 0.0),
        minimum_thrust_n=engine.minimum_thrust_n,
        maximum_thrust_n=engine.maximum_thrust_n,
        bandwidth_radps=control.bandwidth_radps,
        maximum_torque_nm=control.maximum_torque_nm,
        maximum_rate_radps=radians(control.maximum_rate_degps),
    )


def _time_to_gate_s(part: PoweredDescent, gate_m: tuple[float, float, float]) -> float:
    (east_m, north_m, up_m), velocity = part.start.position_site_m, part.start.velocity_site_mps
    distance_m = hypot(east_m - gate_m[0], north_m - gate_m[1], up_m - gate_m[2])
    return max(2 * distance_m / (hypot(*velocity) + part.descent_speed_mps), 2 * POLYNOMIAL_END_S)


def _step_sizes(part: PoweredDescent, body: VehicleConstants) -> StepSizes:
    fastest_radps = part.vehicle.attitude_control.bandwidth_radps
    if part.start.attitude is not None:
        fastest_radps = max(fastest_radps, hypot(*part.start.attitude.body_rate_radps))
    longest_s = min(part.step_s, 1 / part.control_rate_hz, PHASE_PER_STEP / fastest_radps)
    bounce_radps = sqrt(len(body.feet_m) * body.stiffness_npm / part.vehicle.dry_mass_kg)
    lags = [lag for lag in (part.vehicle.engine.valve_lag_s, part.vehicle.attitude_control.lag_s) if lag > 0]
    first_s = min([longest_s, *(lag / 4 for lag in lags)])
    contact_s = longest_s if bounce_radps == 0.0 else min(longest_s, BOUNCE_PHASE_PER_STEP / bounce_radps)
    return StepSizes(first_s, 0.5, longest_s, contact_s)


def _start(part: PoweredDescent, body: VehicleConstants, guide: GuidanceConstants) -> FloatArray:
    state = np.zeros(SIZE)
    state[POSITION : POSITION + 3] = part.start.position_site_m
    state[VELOCITY : VELOCITY + 3] = part.start.velocity_site_mps
    attitude = part.start.attitude
    if attitude is None:
        gravity = gravity_at(body, vector_at(state, POSITION))
        site_from_body = _pointing(
            np.array(specific_thrust_at(guide, 0.0, gravity, state)), np.array(guide.heading)
        )
    else:
        angles = np.radians([attitude.yaw_deg, attitude.pitch_deg, attitude.roll_deg])
        site_from_body = compose(SITE_FROM_NED, from_yaw_pitch_roll(*angles))
        state[RATE : RATE + 3] = attitude.body_rate_radps
    state[ATTITUDE : ATTITUDE + 4] = to_quaternion(site_from_body)
    return state


def _pointing(thrust: FloatArray, heading: FloatArray) -> FloatArray:
    """site_from_body with body -z along the thrust and body x towards the heading."""
    z = -thrust / np.sqrt(np.sum(thrust**2))
    y = cross(z, heading)
    y /= np.sqrt(np.sum(y**2))
    return np.stack([cross(y, z), y, z], axis=-1)


COORDINATES = 7
"""Position and quaternion."""
ORDERS = 5


class DescentTrajectory(Trajectory):
    """The whole flight as a polynomial per step."""

    def __init__(self, part: PoweredDescent, body_radius_m: float) -> None:
        self.outcome, self.record = fly_descent(part, body_radius_m)
        self.duration_s = self.outcome.end_s
        mass_kg = self.record.mass_and_thrust[:, 0]
        self.propellant_kg = float(mass_kg[0] - mass_kg[-1])
        """Propellant burnt in the whole flight."""
        self._start_s, self._pieces = self.record.time_s, polynomials(self.record)

    def state(self, time_s: FloatArray) -> VehicleState:
        """State of the vehicle at scenario times (n,); after the end, it continues with the last acceleration."""
        motion, attitude = np.empty((3, len(time_s), 3)), np.empty((3, len(time_s), 4))
        _read(self._start_s, self._pieces, time_s, motion, attitude)
        return VehicleState(time_s, motion[0], motion[1], motion[2], *from_quaternions(attitude))


def polynomials(record: StepHistory) -> FloatArray:
    """Coefficients (steps + 1, 5, 7) of the powers 0 to 4 of the time since each step's start; the last polynomial
    continues the motion after the end."""
    pieces = np.zeros((len(record.time_s), ORDERS, COORDINATES))
    pieces[:, 0, :3] = record.state[:, POSITION : POSITION + 3]
    pieces[:, 0, 3:] = record.state[:, ATTITUDE : ATTITUDE + 4]
    step_s = np.diff(record.time_s)[:, None]
    (first, second), (first_end, second_end) = _by_order(record.start), _by_order(record.end)
    slope = (first_end - first) / step_s
    pieces[:-1, 1], pieces[:-1, 2] = first, second / 2
    pieces[:-1, 3] = (3 * slope - 2 * second - second_end) / step_s / 3
    pieces[:-1, 4] = (second + second_end - 2 * slope) / step_s**2 / 4
    pieces[-1, 1], pieces[-1, 2] = first_end[-1], second_end[-1] / 2
    return pieces


def _by_order(slope: FloatArray) -> tuple[FloatArray, FloatArray]:
    return slope[:, :COORDINATES], slope[:, COORDINATES:]


@kernel(outermost=True)
def _read(
    start_s: FloatArray, pieces: FloatArray, time_s: FloatArray, motion: FloatArray, attitude: FloatArray
) -> None:
    for k in range(len(time_s)):
        place = piece_at(start_s, time_s[k])
        since_s, power = time_s[k] - start_s[place], pieces[place]
        for i in range(COORDINATES):
            orders = motion[:, k, i : i + 1] if i < 3 else attitude[:, k, i - 3 : i - 2]
            c1, c2, c3, c4 = power[1, i], power[2, i], power[3, i], power[4, i]
            orders[0, 0] = power[0, i] + since_s * (c1 + since_s * (c2 + since_s * (c3 + since_s * c4)))
            orders[1, 0] = c1 + since_s * (2 * c2 + since_s * (3 * c3 + since_s * 4 * c4))
            orders[2, 0] = 2 * c2 + since_s * (6 * c3 + since_s * 12 * c4)
