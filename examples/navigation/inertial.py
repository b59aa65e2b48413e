"""What an inertial unit hands to a filter, and how good it is."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from beams import Array

GRAVITY_SITE_MPS2 = np.array([0.0, 0.0, -1.62])
"""The Moon's. A simulated unit shares it with the filter: an error of gravity is none of those that are shown."""


@dataclass(frozen=True)
class Grade:
    """How good it is."""

    accelerometer_bias_mps2: float = 3e-3
    """Standard deviation of a bias that stays, as for the gyroscope."""
    accelerometer_noise: float = 5e-4
    """Of velocity after one second: m/s per square root of s."""
    gyroscope_bias_radps: float = 5e-6
    gyroscope_noise: float = 2e-5
    """Of angle after one second: rad per square root of s."""


TACTICAL = Grade()


class Increment(NamedTuple):
    """What was felt in an interval."""

    duration_s: float
    angle_body_rad: Array
    """Rotation vector."""
    velocity_body_mps: Array
    """Of the forces other than gravity, along the body's axes at the interval's start."""


class Inertial(Protocol):
    """An inertial unit."""

    @property
    def end_ns(self) -> int:
        """Up to which it knows what was felt."""
        ...

    def between(self, start_ns: int, end_ns: int) -> Iterator[Increment]:
        """What was felt from one instant to another, not after `end_ns`."""
        ...
