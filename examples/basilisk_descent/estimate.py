"""Estimate from four beams: height above the ground, its slope, and the velocity relative to it. Geometry alone."""

from collections.abc import Sequence
from math import cos, radians, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_protocol import Message

Array = NDArray[np.float64]
AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)
"""Azimuths of the beams about body z, from x to y, of the scanner `square`; packets carry the other angle."""


class Estimate(NamedTuple):
    """Estimate in the body's axes: x forward, y right, z down."""

    height_m: float
    """Distance from the plane through the four footprints."""
    up_body: Array
    """Unit normal of that plane."""
    velocity_body_mps: Array

    @property
    def climb_mps(self) -> float:
        """Speed along the normal."""
        return float(self.up_body @ self.velocity_body_mps)

    @property
    def drift_body_mps(self) -> Array:
        """Velocity along the plane."""
        return self.velocity_body_mps - self.climb_mps * self.up_body


def solve(message: Message) -> Estimate | None:
    """Least squares over the beams with valid ranges, and over the beams with valid speeds; None with too few of
    either."""
    ranges = _valid(message, "range_valid", "range_m")
    speeds = _valid(message, "speed_valid", "closing_speed_mps")
    if min(len(ranges), len(speeds)) < 3:
        return None
    # The plane -up · p = height contains the footprints p = range u: each gives an equation that is linear in up /
    # height.
    scaled_up = _least_squares([-range_m * u for u, range_m in ranges], [1.0] * len(ranges))
    velocity_mps = _least_squares(*zip(*speeds, strict=True))
    height_m = 1 / float(np.linalg.norm(scaled_up))
    return Estimate(height_m, scaled_up * height_m, velocity_mps)


def _valid(message: Message, flag: str, name: str) -> list[tuple[Array, float]]:
    """Direction and value of each valid beam."""
    found = []
    for beam, azimuth_deg in zip(message.beams, AZIMUTHS_DEG, strict=True):
        angle_deg, value = beam["beam_angle_deg"], beam[name]
        if beam[flag] and angle_deg is not None and value is not None:
            found.append((_direction(angle_deg, azimuth_deg), float(value)))
    return found


def _least_squares(directions: Sequence[Array], values: Sequence[float]) -> Array:
    solution: Array = np.linalg.lstsq(np.array(directions), np.array(values), rcond=None)[0]
    return solution


def _direction(angle_deg: float, azimuth_deg: float) -> Array:
    off, around = radians(angle_deg), radians(azimuth_deg)
    return np.array([sin(off) * cos(around), sin(off) * sin(around), cos(off)])
