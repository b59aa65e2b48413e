"""The vehicle of a powered descent: constants, actuators, feet and equations of motion.

Commands are held and lags are of first order: thrust and torque are exponentials of the time since the command, and the
propellant used is an integral of thrust. None of them is integrated in steps: no lag, however short, makes the motion
stiff, and the rocket equation holds to rounding.

Without thrust and ground contact they conserve momentum, angular momentum and energy.
"""

from __future__ import annotations

from math import cos, exp, expm1, inf, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import (
    Vector,
    add,
    cross,
    multiply,
    quaternion_at,
    quaternion_rate,
    scale,
    store,
    subtract,
    to_child,
    to_parent,
    vector_at,
)
from lidar_emu.scenario import trajectory as parts

POSITION, VELOCITY, ATTITUDE, RATE = 0, 3, 6, 10
"""Site frame, m and m/s; unit quaternion site_from_body; rad/s about the body's axes."""
SIZE = 13

STANDARD_GRAVITY_MPS2 = 9.80665


class VehicleConstants(NamedTuple):
    """Constants of the equations of motion."""

    start_kg: float
    inertia_kgm2: Vector
    """At `start_kg`."""
    gravity_mps2: float
    curvature_per_m: float
    """1 / radius of the celestial body; 0 makes gravity uniform."""
    ground_m: float
    feet_m: FloatArray
    """(feet, 3) Positions in the body frame."""
    stiffness_npm: float
    foot_damping_spm: float
    friction: float


def vehicle_constants(
    vehicle: parts.Vehicle, gravity_mps2: float, body_radius_m: float, ground_m: float
) -> VehicleConstants:
    """Constants of a scenario's vehicle."""
    gear = vehicle.gear
    return VehicleConstants(
        start_kg=vehicle.mass_kg,
        inertia_kgm2=vehicle.inertia_kgm2,
        gravity_mps2=gravity_mps2,
        curvature_per_m=1 / body_radius_m,
        ground_m=ground_m,
        feet_m=_feet(gear),
        stiffness_npm=gear.stiffness_npm,
        foot_damping_spm=gear.damping_spm,
        friction=gear.friction,
    )


def _feet(gear: parts.Gear) -> FloatArray:
    """Feet (n, 3) on a circle in the body frame, the first between forward and right."""
    angles = [2 * pi * (i + 0.5) / gear.feet for i in range(gear.feet)]
    return np.array([(gear.radius_m * cos(a), gear.radius_m * sin(a), gear.below_m) for a in angles])


class Lags(NamedTuple):
    """Time constants, and the engine's exhaust speed."""

    valve_s: float
    torque_s: float
    exhaust_mps: float


class ActuatorState(NamedTuple):
    """State of the actuators at a command: their values at its instant, and the commanded ones."""

    thrust_n: float
    mass_kg: float
    torque_nm: Vector
    thrust_command_n: float
    torque_command_nm: Vector


@kernel
def remaining_share(since_s: float, lag_s: float) -> float:
    """Fraction of a commanded change that remains."""
    return exp(-since_s / lag_s) if lag_s > 0.0 else 0.0


@kernel
def thrust_after(actuators: ActuatorState, lags: Lags, since_s: float) -> float:
    """Thrust in newtons, at a time since the command."""
    change_n = actuators.thrust_n - actuators.thrust_command_n
    return actuators.thrust_command_n + change_n * remaining_share(since_s, lags.valve_s)


@kernel
def mass_after(actuators: ActuatorState, lags: Lags, since_s: float) -> float:
    """Mass in kilograms: mass at the command less impulse over exhaust speed."""
    impulse_ns = actuators.thrust_command_n * since_s
    if lags.valve_s > 0.0:
        change_n = actuators.thrust_n - actuators.thrust_command_n
        impulse_ns -= change_n * lags.valve_s * expm1(-since_s / lags.valve_s)
    return actuators.mass_kg - impulse_ns / lags.exhaust_mps


@kernel
def torque_after(actuators: ActuatorState, lags: Lags, since_s: float) -> Vector:
    """Torque about the body's axes in newton metres."""
    now, to, missing = (
        actuators.torque_nm,
        actuators.torque_command_nm,
        remaining_share(since_s, lags.torque_s),
    )
    return (
        to[0] + (now[0] - to[0]) * missing,
        to[1] + (now[1] - to[1]) * missing,
        to[2] + (now[2] - to[2]) * missing,
    )


@kernel
def with_command(
    actuators: ActuatorState, lags: Lags, since_s: float, thrust_n: float, torque_nm: Vector
) -> ActuatorState:
    """State of the actuators at a new command, given at a time since the last."""
    return ActuatorState(
        thrust_after(actuators, lags, since_s),
        mass_after(actuators, lags, since_s),
        torque_after(actuators, lags, since_s),
        thrust_n,
        torque_nm,
    )


SLIDING_MPS = 0.02
"""Below this speed friction is proportional to it."""


@kernel
def lowest_foot_m(body: VehicleConstants, state: FloatArray) -> float:
    """Height of the lowest foot above the ground; negative while the spring is compressed."""
    turn, lowest = quaternion_at(state, ATTITUDE), inf
    for foot in range(len(body.feet_m)):
        lowest = min(lowest, to_parent(turn, vector_at(body.feet_m[foot], 0))[2])
    height_m: float = state[POSITION + 2] + lowest - body.ground_m
    return height_m


@kernel
def ground_reaction(body: VehicleConstants, state: FloatArray) -> tuple[Vector, Vector]:
    """Force in the site frame and torque about the body's axes.

    A foot's force is k d (1 + c d') with depth d (Hunt and Crossley, 1975): it starts from 0, and the power that it
    dissipates, k c d d'^2, is never negative.
    """
    turn, rate = quaternion_at(state, ATTITUDE), vector_at(state, RATE)
    velocity = vector_at(state, VELOCITY)
    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(len(body.feet_m)):
        foot = vector_at(body.feet_m[i], 0)
        depth_m = body.ground_m - state[POSITION + 2] - to_parent(turn, foot)[2]
        if depth_m > 0.0:
            moving = add(velocity, to_parent(turn, cross(rate, foot)))
            normal = max(0.0, body.stiffness_npm * depth_m * (1.0 - body.foot_damping_spm * moving[2]))
            sliding = sqrt(moving[0] * moving[0] + moving[1] * moving[1])
            friction_nspm = body.friction * normal / max(sliding, SLIDING_MPS)
            push = (-friction_nspm * moving[0], -friction_nspm * moving[1], normal)
            force, torque = add(force, push), add(torque, cross(foot, to_child(turn, push)))
    return force, torque


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
