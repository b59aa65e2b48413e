"""The equations of motion: rigid body, hanging slosh, one bending mode, feet on the ground.

The slosh is a spherical pendulum whose rod pulls at its hinge: the pull follows from the rod's constant length, in
closed form. The mode is coupled as in hybrid coordinates: the angular momentum is J ω + δ dq/dt, and its bending is
driven by -δ · dω/dt. Undamped, without thrust and ground, momentum, angular momentum and energy are conserved
exactly. The site frame is taken as inertial.
"""

from __future__ import annotations

from math import sqrt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import quaternion_at, quaternion_rate, to_child, to_parent
from lidar_emu.numerics.vectors import Vector, add, cross, dot, multiply, scale, store, subtract, vector_at
from lidar_emu.trajectory.powered.contact import feet_push
from lidar_emu.trajectory.powered.vehicle import (
    ATTITUDE,
    BEND,
    BENDING,
    HANG,
    POSITION,
    RATE,
    SWAY,
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
    """Constant radii of gyration: what leaves takes its own angular momentum along, and nothing is left to add."""
    return scale(mass_kg / body.start_kg, body.inertia_kgm2)


@kernel
def angular_acceleration(inertia: Vector, coupling: Vector, torque: Vector) -> Vector:
    """(J - δ δᵀ)⁻¹ torque, by Sherman and Morrison."""
    free = (torque[0] / inertia[0], torque[1] / inertia[1], torque[2] / inertia[2])
    eased = (coupling[0] / inertia[0], coupling[1] / inertia[1], coupling[2] / inertia[2])
    return add(free, scale(dot(coupling, free) / (1.0 - dot(coupling, eased)), eased))


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

    ground_push, ground_torque = feet_push(body, state)
    force = add((0.0, 0.0, -thrust_n), to_child(turn, ground_push))
    resisting = body.bend_damping_radps * state[BENDING] + body.bend_radps * body.bend_radps * state[BEND]
    momentum = add(multiply(inertia, rate), scale(state[BENDING], coupling))
    torque = add(add(torque_nm, ground_torque), subtract(scale(resisting, coupling), cross(rate, momentum)))

    if body.slosh_kg > 0.0:
        hang, sway = to_child(turn, vector_at(state, HANG)), to_child(turn, vector_at(state, SWAY))
        rod, hinge = scale(body.rod_m, hang), body.hinge_m
        drag = scale(-body.slosh_damping_per_s * body.slosh_kg, subtract(sway, cross(rate, rod)))
        force, torque = subtract(force, drag), subtract(torque, cross(add(hinge, rod), drag))
        # Without the rod's pull first; then as much of it as keeps the rod's length.
        pushed = scale(1.0 / rigid_kg, force)
        turned = angular_acceleration(inertia, coupling, torque)
        lever = cross(hinge, hang)
        yielding = angular_acceleration(inertia, coupling, lever)
        centripetal = cross(rate, cross(rate, hinge))
        lacking = dot(sway, sway) / body.rod_m + dot(hang, drag) / body.slosh_kg
        lacking -= dot(hang, add(pushed, centripetal)) + dot(turned, lever)
        pull = lacking / (1.0 / body.slosh_kg + 1.0 / rigid_kg + dot(lever, yielding))
        acceleration = add(pushed, scale(pull / rigid_kg, hang))
        turned = add(turned, scale(pull, yielding))
        at_hinge = add(acceleration, add(cross(turned, hinge), centripetal))
        of_slosh = scale(1.0 / body.slosh_kg, subtract(drag, scale(pull, hang)))
        store(derivative, HANG, scale(1.0 / body.rod_m, vector_at(state, SWAY)))
        store(derivative, SWAY, to_parent(turn, subtract(of_slosh, at_hinge)))
    else:
        acceleration = scale(1.0 / rigid_kg, force)
        turned = angular_acceleration(inertia, coupling, torque)
        store(derivative, HANG, (0.0, 0.0, 0.0))
        store(derivative, SWAY, (0.0, 0.0, 0.0))

    store(derivative, POSITION, velocity)
    fall = gravity_at(body, vector_at(state, POSITION))
    store(derivative, VELOCITY, add(to_parent(turn, acceleration), fall))
    store(derivative, RATE, turned)
    spin = quaternion_rate(turn, rate)
    for i in range(4):
        derivative[ATTITUDE + i] = spin[i]
    derivative[BEND] = state[BENDING]
    derivative[BENDING] = -resisting - dot(coupling, turned)
