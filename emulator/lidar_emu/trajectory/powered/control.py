"""Guidance and attitude control: thrust and torque commands at a control tick, from the true state of motion.

Guidance commands a specific thrust (force per mass). Up to the gate it follows the scenario's law; from the gate on the
vehicle descends over the target at a constant speed. The engine pushes along body -z only: attitude control turns that
axis to the commanded direction, and the throttle delivers the component along the present axis.
"""

from __future__ import annotations

from math import atan2, sqrt
from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import (
    Vector,
    add,
    dot,
    multiply,
    norm,
    quaternion_at,
    scale,
    subtract,
    to_child,
    vector_at,
)
from lidar_emu.trajectory.powered.dynamics import ATTITUDE, POSITION, RATE, VELOCITY

UP = (0.0, 0.0, 1.0)
POLYNOMIAL_END_S = 2.0
"""Time before the gate at which the polynomial is left: its gains grow as the inverse square of the time to go."""
DESCENT_LAG_S = 2.0
"""Time constant of the velocity from the gate on."""
MINIMUM_UPWARD = 0.2
"""Minimum commanded upward thrust, as a fraction of gravity: it keeps the commanded direction defined."""


class GuidanceConstants(NamedTuple):
    """Constants of guidance and control."""

    polynomial: bool
    """Whether the approach follows the polynomial; otherwise it is a gravity turn."""
    gate_m: Vector
    gate_s: float
    """Flight time at which the polynomial ends."""
    descent_mps: float
    tangent_maximum_tilt: float
    """Tangent of the maximum tilt."""
    heading: Vector
    """Unit vector along which body x points when the vehicle is upright."""
    minimum_thrust_n: float
    maximum_thrust_n: float
    bandwidth_radps: float
    maximum_torque_nm: float
    maximum_rate_radps: float


@kernel
def specific_thrust(
    guide: GuidanceConstants, time_s: float, position_m: Vector, velocity_mps: Vector, gravity: Vector
) -> Vector:
    """Commanded specific thrust in the site frame, within the maximum tilt."""
    if guide.polynomial:
        to_go_s = guide.gate_s - time_s
        if to_go_s > POLYNOMIAL_END_S:
            acceleration = approach_polynomial(guide, to_go_s, position_m, velocity_mps)
        else:
            acceleration = terminal_descent(guide, subtract(position_m, guide.gate_m), velocity_mps)
    elif position_m[2] > guide.gate_m[2]:
        acceleration = gravity_turn(guide, position_m[2] - guide.gate_m[2], velocity_mps, gravity)
    else:
        acceleration = terminal_descent(guide, (0.0, 0.0, 0.0), velocity_mps)
    return limit_tilt(guide, subtract(acceleration, gravity), gravity)


@kernel
def approach_polynomial(
    guide: GuidanceConstants, to_go_s: float, position_m: Vector, velocity_mps: Vector
) -> Vector:
    """Acceleration, quadratic in time, that reaches the gate at its velocity and without acceleration (Klumpp, Apollo
    lunar descent guidance, 1974)."""
    position_error_m = subtract(guide.gate_m, position_m)
    both_mps = add(velocity_mps, (0.0, 0.0, -guide.descent_mps))
    return subtract(scale(12.0 / (to_go_s * to_go_s), position_error_m), scale(6.0 / to_go_s, both_mps))


@kernel
def gravity_turn(guide: GuidanceConstants, drop_m: float, velocity_mps: Vector, gravity: Vector) -> Vector:
    """Constant deceleration along the straight path to the gate's height; gravity bends the path down.

    The acceleration across the velocity is gravity's component there, so that the thrust has none.
    """
    speed = max(norm(velocity_mps), guide.descent_mps)
    ahead = scale(1.0 / speed, velocity_mps)
    path_m = drop_m / max(-ahead[2], 0.1)
    braking = (speed * speed - guide.descent_mps * guide.descent_mps) / (2.0 * path_m)
    across = subtract(gravity, scale(dot(gravity, ahead), ahead))
    return add(across, scale(-braking, ahead))


@kernel
def terminal_descent(guide: GuidanceConstants, offset_m: Vector, velocity_mps: Vector) -> Vector:
    """Acceleration towards the descent speed; the horizontal offset from the target is critically damped."""
    return (
        -offset_m[0] / (4.0 * DESCENT_LAG_S * DESCENT_LAG_S) - velocity_mps[0] / DESCENT_LAG_S,
        -offset_m[1] / (4.0 * DESCENT_LAG_S * DESCENT_LAG_S) - velocity_mps[1] / DESCENT_LAG_S,
        -(velocity_mps[2] + guide.descent_mps) / DESCENT_LAG_S,
    )


@kernel
def limit_tilt(guide: GuidanceConstants, thrust_mps2: Vector, gravity: Vector) -> Vector:
    """Limit the horizontal component to the maximum tilt, and keep the vertical one above its minimum."""
    upward = max(thrust_mps2[2], MINIMUM_UPWARD * norm(gravity))
    sideways = sqrt(thrust_mps2[0] * thrust_mps2[0] + thrust_mps2[1] * thrust_mps2[1])
    share = min(1.0, guide.tangent_maximum_tilt * upward / sideways) if sideways > 0.0 else 1.0
    return share * thrust_mps2[0], share * thrust_mps2[1], upward


@kernel
def throttle(guide: GuidanceConstants, mass_kg: float, thrust_mps2: Vector, state: FloatArray) -> float:
    """Thrust that delivers the component of the command along the engine axis, within the engine's limits."""
    along = -to_child(quaternion_at(state, ATTITUDE), thrust_mps2)[2]
    return min(max(mass_kg * along, guide.minimum_thrust_n), guide.maximum_thrust_n)


@kernel
def attitude_torque(
    guide: GuidanceConstants, inertia: Vector, thrust_mps2: Vector, state: FloatArray
) -> Vector:
    """Torque about the body's axes that turns the engine to the commanded direction, and body x to the heading."""
    turn = quaternion_at(state, ATTITUDE)
    x, y, z = to_child(turn, thrust_mps2)
    off = sqrt(x * x + y * y)
    tilt = atan2(off, -z) / off if off > 0.0 else 0.0
    heading = to_child(turn, guide.heading)
    error = (tilt * y, -tilt * x, atan2(heading[1], heading[0]))
    # Critically damped: the commanded rate is half the bandwidth times the error.
    wanted = clamp(scale(0.5 * guide.bandwidth_radps, error), guide.maximum_rate_radps)
    lacking = subtract(wanted, vector_at(state, RATE))
    return clamp(multiply(inertia, scale(2.0 * guide.bandwidth_radps, lacking)), guide.maximum_torque_nm)


@kernel
def clamp(v: Vector, limit: float) -> Vector:
    """Limit each component to the range from -limit to limit."""
    return (
        min(max(v[0], -limit), limit),
        min(max(v[1], -limit), limit),
        min(max(v[2], -limit), limit),
    )


@kernel
def specific_thrust_at(guide: GuidanceConstants, time_s: float, gravity: Vector, state: FloatArray) -> Vector:
    """`specific_thrust` for a state (13,)."""
    return specific_thrust(guide, time_s, vector_at(state, POSITION), vector_at(state, VELOCITY), gravity)
