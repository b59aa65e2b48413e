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
from lidar_emu.numerics.vectors import (
    Vector,
    child_of,
    each,
    inner,
    minus,
    outer,
    parent_of,
    plus,
    put,
    quaternion_at,
    times,
    turning,
    vector_at,
)
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
    Body,
)


@kernel
def gravity_at(body: Body, position_m: Vector) -> Vector:
    """Of a central mass below the origin, m/s² in the site frame."""
    k = body.curvature_per_m
    x, y, z = k * position_m[0], k * position_m[1], 1.0 + k * position_m[2]
    squared = x * x + y * y + z * z
    return times(-body.gravity_mps2 / (squared * sqrt(squared)), (x, y, z))


@kernel
def inertia_at(body: Body, mass_kg: float) -> Vector:
    """Constant radii of gyration: what leaves takes its own angular momentum along, and nothing is left to add."""
    return times(mass_kg / body.start_kg, body.inertia_kgm2)


@kernel
def angular_acceleration(inertia: Vector, coupling: Vector, torque: Vector) -> Vector:
    """(J - δ δᵀ)⁻¹ torque, by Sherman and Morrison."""
    free = (torque[0] / inertia[0], torque[1] / inertia[1], torque[2] / inertia[2])
    eased = (coupling[0] / inertia[0], coupling[1] / inertia[1], coupling[2] / inertia[2])
    return plus(free, times(inner(coupling, free) / (1.0 - inner(coupling, eased)), eased))


@kernel
def set_derivative(
    body: Body, mass_kg: float, thrust_n: float, torque_nm: Vector, state: FloatArray, derivative: FloatArray
) -> None:
    """Of a state (21,), under what the actuators give at that instant."""
    turn, rate = quaternion_at(state, ATTITUDE), vector_at(state, RATE)
    velocity = vector_at(state, VELOCITY)
    inertia, coupling = inertia_at(body, mass_kg), body.bend_coupling
    rigid_kg = mass_kg - body.slosh_kg

    ground_push, ground_torque = feet_push(body, state)
    force = plus((0.0, 0.0, -thrust_n), child_of(turn, ground_push))
    resisting = body.bend_damping_radps * state[BENDING] + body.bend_radps * body.bend_radps * state[BEND]
    momentum = plus(each(inertia, rate), times(state[BENDING], coupling))
    torque = plus(plus(torque_nm, ground_torque), minus(times(resisting, coupling), outer(rate, momentum)))

    if body.slosh_kg > 0.0:
        hang, sway = child_of(turn, vector_at(state, HANG)), child_of(turn, vector_at(state, SWAY))
        rod, hinge = times(body.rod_m, hang), body.hinge_m
        drag = times(-body.slosh_damping_per_s * body.slosh_kg, minus(sway, outer(rate, rod)))
        force, torque = minus(force, drag), minus(torque, outer(plus(hinge, rod), drag))
        # Without the rod's pull first; then as much of it as keeps the rod's length.
        pushed = times(1.0 / rigid_kg, force)
        turned = angular_acceleration(inertia, coupling, torque)
        lever = outer(hinge, hang)
        yielding = angular_acceleration(inertia, coupling, lever)
        centripetal = outer(rate, outer(rate, hinge))
        lacking = inner(sway, sway) / body.rod_m + inner(hang, drag) / body.slosh_kg
        lacking -= inner(hang, plus(pushed, centripetal)) + inner(turned, lever)
        pull = lacking / (1.0 / body.slosh_kg + 1.0 / rigid_kg + inner(lever, yielding))
        acceleration = plus(pushed, times(pull / rigid_kg, hang))
        turned = plus(turned, times(pull, yielding))
        at_hinge = plus(acceleration, plus(outer(turned, hinge), centripetal))
        of_slosh = times(1.0 / body.slosh_kg, minus(drag, times(pull, hang)))
        put(derivative, HANG, times(1.0 / body.rod_m, vector_at(state, SWAY)))
        put(derivative, SWAY, parent_of(turn, minus(of_slosh, at_hinge)))
    else:
        acceleration = times(1.0 / rigid_kg, force)
        turned = angular_acceleration(inertia, coupling, torque)
        put(derivative, HANG, (0.0, 0.0, 0.0))
        put(derivative, SWAY, (0.0, 0.0, 0.0))

    put(derivative, POSITION, velocity)
    fall = gravity_at(body, vector_at(state, POSITION))
    put(derivative, VELOCITY, plus(parent_of(turn, acceleration), fall))
    put(derivative, RATE, turned)
    spin = turning(turn, rate)
    for i in range(4):
        derivative[ATTITUDE + i] = spin[i]
    derivative[BEND] = state[BENDING]
    derivative[BENDING] = -resisting - inner(coupling, turned)
