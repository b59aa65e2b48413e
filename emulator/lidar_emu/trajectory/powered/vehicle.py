"""Constants of a vehicle for the kernels, and the index of each quantity in the state of motion."""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vectors import Vector
from lidar_emu.scenario import vehicle as parts

POSITION, VELOCITY, ATTITUDE, RATE = 0, 3, 6, 10
"""Site frame, m and m/s; unit quaternion site_from_body; rad/s about the body's axes."""
SLOSH_DIRECTION, SLOSH_VELOCITY = 13, 16
"""Slosh in the site frame: unit vector from the hinge to the mass, and velocity of the mass relative to the hinge."""
BEND, BENDING = 19, 20
"""Modal coordinate of the flexible mode, and its derivative."""
SIZE = 21

STANDARD_GRAVITY_MPS2 = 9.80665


class VehicleConstants(NamedTuple):
    """Constants of the equations of motion; absent parts have a mass of 0."""

    start_kg: float
    inertia_kgm2: Vector
    """At `start_kg`."""
    gravity_mps2: float
    curvature_per_m: float
    """1 / radius of the celestial body; 0 makes gravity uniform."""
    slosh_kg: float
    rod_m: float
    hinge_m: Vector
    slosh_damping_per_s: float
    bend_radps: float
    bend_damping_radps: float
    """Twice the damping ratio times the frequency."""
    bend_coupling: Vector
    """Angular momentum of the mode per bending speed, about each axis."""
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
    slosh, mode, gear = vehicle.slosh, vehicle.flexible_mode, vehicle.gear
    dry = vehicle.dry_mass_kg / vehicle.mass_kg
    x, y, z = vehicle.inertia_kgm2
    shares = (0.0, 0.0, 0.0) if mode is None else mode.inertia_share
    bend_radps = 0.0 if mode is None else 2 * pi * mode.frequency_hz
    return VehicleConstants(
        start_kg=vehicle.mass_kg,
        inertia_kgm2=vehicle.inertia_kgm2,
        gravity_mps2=gravity_mps2,
        curvature_per_m=1 / body_radius_m,
        slosh_kg=0.0 if slosh is None else slosh.mass_kg,
        rod_m=1.0 if slosh is None else slosh.length_m,
        hinge_m=(0.0, 0.0, 0.0) if slosh is None else slosh.hinge_body_m,
        slosh_damping_per_s=0.0 if slosh is None else slosh.damping_per_s,
        bend_radps=bend_radps,
        bend_damping_radps=0.0 if mode is None else 2 * mode.damping_ratio * bend_radps,
        bend_coupling=(sqrt(shares[0] * dry * x), sqrt(shares[1] * dry * y), sqrt(shares[2] * dry * z)),
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
