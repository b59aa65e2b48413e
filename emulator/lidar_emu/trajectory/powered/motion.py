"""The equations of motion of a rigid body with feet on the ground. The site frame is taken as inertial.

Without thrust and ground contact they conserve momentum, angular momentum and energy.
"""

from __future__ import annotations

from math import sqrt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import quaternion_at, quaternion_rate, to_parent
from lidar_emu.numerics.vectors import Vector, add, cross, multiply, scale, store, subtract, vector_at
from lidar_emu.trajectory.powered.contact import ground_reaction
from lidar_emu.trajectory.powered.vehicle import ATTITUDE, POSITION, RATE, VELOCITY, VehicleConstants


@kernel
def gravity_at(body: VehicleConstants, position_m: Vector) -> Vector:
    """Gravity of a central mass below the origin, m/s² in the site frame."""
    k = body.curvature_per_m
    x, y, z = k * position_m[0], k * position_m[1], 1.0 + k * position_m[2]
    squared = x * x + y * y + z * z
    return scale(-body.gravity_mps2 / (squared * sqrt(squared)), (x, y, z))


@kernel
def inertia_at(body: VehicleConstants, mass_kg: float) -> Vector:
    """Inertia about the body's axes at constant radii of gyration, for which jet damping cancels."""
    return scale(mass_kg / body.start_kg, body.inertia_kgm2)


@kernel
def set_derivative(
    body: VehicleConstants,
    mass_kg: float,
    thrust_n: float,
    torque_nm: Vector,
    state: FloatArray,
    derivative: FloatArray,
) -> None:
    """Set the derivative of a state (13,) under the thrust and torque at that instant."""
    turn, rate = quaternion_at(state, ATTITUDE), vector_at(state, RATE)
    inertia = inertia_at(body, mass_kg)
    ground_push, ground_torque = ground_reaction(body, state)
    force = add(to_parent(turn, (0.0, 0.0, -thrust_n)), ground_push)
    torque = subtract(add(torque_nm, ground_torque), cross(rate, multiply(inertia, rate)))
    fall = gravity_at(body, vector_at(state, POSITION))
    store(derivative, POSITION, vector_at(state, VELOCITY))
    store(derivative, VELOCITY, add(scale(1.0 / mass_kg, force), fall))
    store(derivative, RATE, (torque[0] / inertia[0], torque[1] / inertia[1], torque[2] / inertia[2]))
    spin = quaternion_rate(turn, rate)
    for i in range(4):
        derivative[ATTITUDE + i] = spin[i]
