"""The equations of motion: rigid body, slosh, one bending mode, feet on the ground.

Slosh is a spherical pendulum; the tension of its rod follows in closed form from the rod's constant length. The bending
mode is coupled in hybrid coordinates: the angular momentum is J ω + δ dq/dt, and the mode is driven by -δ · dω/dt.
Without damping, thrust and ground contact the equations conserve momentum, angular momentum and energy. The site frame
is taken as inertial.
"""

from __future__ import annotations

from math import sqrt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import quaternion_at, quaternion_rate, to_child, to_parent
from lidar_emu.numerics.vectors import Vector, add, cross, dot, multiply, scale, store, subtract, vector_at
from lidar_emu.trajectory.powered.contact import ground_reaction
from lidar_emu.trajectory.powered.vehicle import (
    ATTITUDE,
    BEND,
    BENDING,
    POSITION,
    RATE,
    SLOSH_DIRECTION,
    SLOSH_VELOCITY,
    VELOCITY,
    VehicleConstants,
)


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
def angular_acceleration(inertia: Vector, coupling: Vector, torque: Vector) -> Vector:
    """(J - δ δᵀ)⁻¹ torque, by the Sherman-Morrison formula."""
    free = (torque[0] / inertia[0], torque[1] / inertia[1], torque[2] / inertia[2])
    coupled = (coupling[0] / inertia[0], coupling[1] / inertia[1], coupling[2] / inertia[2])
    return add(free, scale(dot(coupling, free) / (1.0 - dot(coupling, coupled)), coupled))


@kernel
def set_derivative(
    body: VehicleConstants,
    mass_kg: float,
    thrust_n: float,
    torque_nm: Vector,
    state: FloatArray,
    derivative: FloatArray,
) -> None:
    """Set the derivative of a state (21,) under the thrust and torque at that instant."""
    turn, rate = quaternion_at(state, ATTITUDE), vector_at(state, RATE)
    velocity = vector_at(state, VELOCITY)
    inertia, coupling = inertia_at(body, mass_kg), body.bend_coupling
    rigid_kg = mass_kg - body.slosh_kg

    ground_push, ground_torque = ground_reaction(body, state)
    force = add((0.0, 0.0, -thrust_n), to_child(turn, ground_push))
    resisting = body.bend_damping_radps * state[BENDING] + body.bend_radps * body.bend_radps * state[BEND]
    momentum = add(multiply(inertia, rate), scale(state[BENDING], coupling))
    torque = add(add(torque_nm, ground_torque), subtract(scale(resisting, coupling), cross(rate, momentum)))

    if body.slosh_kg > 0.0:
        along_rod, slosh_mps = (
            to_child(turn, vector_at(state, SLOSH_DIRECTION)),
            to_child(turn, vector_at(state, SLOSH_VELOCITY)),
        )
        rod, hinge = scale(body.rod_m, along_rod), body.hinge_m
        drag = scale(-body.slosh_damping_per_s * body.slosh_kg, subtract(slosh_mps, cross(rate, rod)))
        force, torque = subtract(force, drag), subtract(torque, cross(add(hinge, rod), drag))
        # First without the rod's tension, then the tension that keeps the rod's length.
        pushed = scale(1.0 / rigid_kg, force)
        turned = angular_acceleration(inertia, coupling, torque)
        lever = cross(hinge, along_rod)
        unit_response = angular_acceleration(inertia, coupling, lever)
        centripetal = cross(rate, cross(rate, hinge))
        lacking = dot(slosh_mps, slosh_mps) / body.rod_m + dot(along_rod, drag) / body.slosh_kg
        lacking -= dot(along_rod, add(pushed, centripetal)) + dot(turned, lever)
        pull = lacking / (1.0 / body.slosh_kg + 1.0 / rigid_kg + dot(lever, unit_response))
        acceleration = add(pushed, scale(pull / rigid_kg, along_rod))
        turned = add(turned, scale(pull, unit_response))
        at_hinge = add(acceleration, add(cross(turned, hinge), centripetal))
        of_slosh = scale(1.0 / body.slosh_kg, subtract(drag, scale(pull, along_rod)))
        store(derivative, SLOSH_DIRECTION, scale(1.0 / body.rod_m, vector_at(state, SLOSH_VELOCITY)))
        store(derivative, SLOSH_VELOCITY, to_parent(turn, subtract(of_slosh, at_hinge)))
    else:
        acceleration = scale(1.0 / rigid_kg, force)
        turned = angular_acceleration(inertia, coupling, torque)
        store(derivative, SLOSH_DIRECTION, (0.0, 0.0, 0.0))
        store(derivative, SLOSH_VELOCITY, (0.0, 0.0, 0.0))

    store(derivative, POSITION, velocity)
    fall = gravity_at(body, vector_at(state, POSITION))
    store(derivative, VELOCITY, add(to_parent(turn, acceleration), fall))
    store(derivative, RATE, turned)
    spin = quaternion_rate(turn, rate)
    for i in range(4):
        derivative[ATTITUDE + i] = spin[i]
    derivative[BEND] = state[BENDING]
    derivative[BENDING] = -resisting - dot(coupling, turned)
