"""Guidance and attitude control: what they command at a control tick, from the true state of motion.

Guidance asks for a thrust acceleration. Up to the gate it follows the scenario's law; after it the vehicle is held over
the target and let down at a constant speed. The engine can only push along body -z: attitude control turns the body so
that this lies along what is asked for, and the throttle gives the part that lies along it now.
"""

from __future__ import annotations

from math import atan2, sqrt
from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import quaternion_at, to_child
from lidar_emu.numerics.vectors import Vector, add, dot, multiply, norm, scale, subtract, vector_at
from lidar_emu.trajectory.powered.vehicle import ATTITUDE, POSITION, RATE, VELOCITY

UP = (0.0, 0.0, 1.0)
GIVEN_UP_S = 2.0
"""Time before the gate at which the polynomial is left: its gains grow as the inverse square of the time to go."""
HOLDING_S = 2.0
"""Time constant of the descent from the gate on."""
LEAST_UPWARD = 0.2
"""Least upward thrust that is commanded, as a share of gravity: it leaves a direction to tilt from."""


class Guide(NamedTuple):
    """Constants of guidance and control."""

    polynomial: bool
    """Else a gravity turn."""
    gate_m: Vector
    gate_s: float
    """Flight time at which the polynomial ends."""
    descent_mps: float
    steepest: float
    """Tangent of the maximum tilt."""
    heading: Vector
    """Unit vector along which body x points when the vehicle is upright."""
    least_n: float
    most_n: float
    bandwidth_radps: float
    most_torque_nm: float
    most_rate_radps: float


@kernel
def asked_acceleration(
    guide: Guide, time_s: float, position_m: Vector, velocity_mps: Vector, gravity: Vector
) -> Vector:
    """Thrust per mass in the site frame, within the tilt that is allowed."""
    if guide.polynomial:
        to_go_s = guide.gate_s - time_s
        if to_go_s > GIVEN_UP_S:
            asked = to_gate(guide, to_go_s, position_m, velocity_mps)
        else:
            asked = let_down(guide, subtract(position_m, guide.gate_m), velocity_mps)
    elif position_m[2] > guide.gate_m[2]:
        asked = against_velocity(guide, position_m[2] - guide.gate_m[2], velocity_mps, gravity)
    else:
        asked = let_down(guide, (0.0, 0.0, 0.0), velocity_mps)
    return within_tilt(guide, subtract(asked, gravity), gravity)


@kernel
def to_gate(guide: Guide, to_go_s: float, position_m: Vector, velocity_mps: Vector) -> Vector:
    """The quadratic in time that reaches the gate at its velocity and without acceleration (Klumpp, Apollo lunar
    descent guidance, 1974)."""
    lacking_m = subtract(guide.gate_m, position_m)
    both_mps = add(velocity_mps, (0.0, 0.0, -guide.descent_mps))
    return subtract(scale(12.0 / (to_go_s * to_go_s), lacking_m), scale(6.0 / to_go_s, both_mps))


@kernel
def against_velocity(guide: Guide, drop_m: float, velocity_mps: Vector, gravity: Vector) -> Vector:
    """Constant deceleration along the straight path to the gate's height; gravity bends the path down.

    What gravity does across the velocity is left to it: the sum of this and the thrust has no other part across.
    """
    speed = max(norm(velocity_mps), guide.descent_mps)
    ahead = scale(1.0 / speed, velocity_mps)
    path_m = drop_m / max(-ahead[2], 0.1)
    braking = (speed * speed - guide.descent_mps * guide.descent_mps) / (2.0 * path_m)
    across = subtract(gravity, scale(dot(gravity, ahead), ahead))
    return add(across, scale(-braking, ahead))


@kernel
def let_down(guide: Guide, beside_m: Vector, velocity_mps: Vector) -> Vector:
    """Acceleration towards the descent speed, critically damped to zero beside the target."""
    return (
        -beside_m[0] / (4.0 * HOLDING_S * HOLDING_S) - velocity_mps[0] / HOLDING_S,
        -beside_m[1] / (4.0 * HOLDING_S * HOLDING_S) - velocity_mps[1] / HOLDING_S,
        -(velocity_mps[2] + guide.descent_mps) / HOLDING_S,
    )


@kernel
def within_tilt(guide: Guide, asked: Vector, gravity: Vector) -> Vector:
    """The vertical part as it is, the horizontal as far as the tilt allows."""
    upward = max(asked[2], LEAST_UPWARD * norm(gravity))
    sideways = sqrt(asked[0] * asked[0] + asked[1] * asked[1])
    share = min(1.0, guide.steepest * upward / sideways) if sideways > 0.0 else 1.0
    return share * asked[0], share * asked[1], upward


@kernel
def throttle(guide: Guide, mass_kg: float, asked: Vector, state: FloatArray) -> float:
    """Thrust that gives as much of what is asked for as lies along the engine."""
    along = -to_child(quaternion_at(state, ATTITUDE), asked)[2]
    return min(max(mass_kg * along, guide.least_n), guide.most_n)


@kernel
def turning_torque(guide: Guide, inertia: Vector, asked: Vector, state: FloatArray) -> Vector:
    """Torque about the body's axes that turns the engine to what is asked for, and body x to the heading."""
    turn = quaternion_at(state, ATTITUDE)
    x, y, z = to_child(turn, asked)
    off = sqrt(x * x + y * y)
    tilt = atan2(off, -z) / off if off > 0.0 else 0.0
    heading = to_child(turn, guide.heading)
    error = (tilt * y, -tilt * x, atan2(heading[1], heading[0]))
    # Critically damped: the rate wanted is half the bandwidth times the error.
    wanted = limited(scale(0.5 * guide.bandwidth_radps, error), guide.most_rate_radps)
    lacking = subtract(wanted, vector_at(state, RATE))
    return limited(multiply(inertia, scale(2.0 * guide.bandwidth_radps, lacking)), guide.most_torque_nm)


@kernel
def limited(v: Vector, most: float) -> Vector:
    """Each component between -most and most."""
    return (
        min(max(v[0], -most), most),
        min(max(v[1], -most), most),
        min(max(v[2], -most), most),
    )


@kernel
def asked_at(guide: Guide, time_s: float, gravity: Vector, state: FloatArray) -> Vector:
    """`asked_acceleration` for a state (21,)."""
    return asked_acceleration(guide, time_s, vector_at(state, POSITION), vector_at(state, VELOCITY), gravity)
