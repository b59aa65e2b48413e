"""The interface of an inertial unit, and its errors."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from beams import Array

GRAVITY_SITE_MPS2 = np.array([0.0, 0.0, -1.62])
"""Gravity of the Moon. The simulated unit uses the same value as the filter: errors of gravity are not modelled."""


@dataclass(frozen=True)
class Grade:
    """Errors of an inertial unit."""

    accelerometer_bias_mps2: float = 3e-3
    """Standard deviation of a constant bias, as for the gyroscope."""
    accelerometer_noise: float = 5e-4
    """Velocity random walk: m/s per square root of s."""
    gyroscope_bias_radps: float = 5e-6
    gyroscope_noise: float = 2e-5
    """Angle random walk: rad per square root of s."""


TACTICAL = Grade()


class Increment(NamedTuple):
    """Measured increments over an interval."""

    duration_s: float
    angle_body_rad: Array
    """Rotation vector."""
    velocity_body_mps: Array
    """Velocity increment by forces other than gravity, in the body's axes at the start of the interval."""


class Inertial(Protocol):
    """An inertial unit."""

    @property
    def end_ns(self) -> int:
        """End of the available data."""
        ...

    def between(self, start_ns: int, end_ns: int) -> Iterator[Increment]:
        """Increments from one instant to another, not after `end_ns`."""
        ...
