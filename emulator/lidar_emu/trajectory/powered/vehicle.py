"""Constants of a vehicle for the kernels, and the index of each quantity in the state of motion."""

from __future__ import annotations

from math import cos, pi, sin
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vectors import Vector
from lidar_emu.scenario import vehicle as parts

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
