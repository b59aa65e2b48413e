"""What the navigation of a flight computer stated: its solutions, as arrays."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray


class Trust(IntEnum):
    """What a navigation did with a value of a beam; the words of `trust` in the interface definition."""

    NOT_JUDGED = 0
    USED = 1
    INVALID = 2
    GATED = 3
    INCONSISTENT = 4
    UNTIMELY = 5
    EXCLUDED = 6


REJECTED = (Trust.GATED, Trust.INCONSISTENT, Trust.UNTIMELY, Trust.EXCLUDED)
"""What a navigation does with a value that it could have used."""


class Solutions(NamedTuple):
    """Solutions in the order of their times of validity; NaN where the navigation stated no value.

    Positions and velocities are those of the body frame's origin in the site frame, east, north and up.
    """

    time_s: FloatArray
    """(n,) Time of validity since the epoch, on the device's clock."""
    arrived_s: FloatArray
    """(n,) When the solution had arrived, on the same clock; NaN if that is unknown."""
    altitude_m: FloatArray
    """(n,) Height above the ground straight below."""
    sigma_altitude_m: FloatArray
    """(n,) Its standard deviation, as the navigation states it."""
    position_site_m: FloatArray
    """(n, 3)"""
    sigma_position_m: FloatArray
    """(n, 3)"""
    velocity_site_mps: FloatArray
    """(n, 3)"""
    sigma_velocity_mps: FloatArray
    """(n, 3)"""
    range_trust: NDArray[np.int8]
    """(n, beams) A code of `Trust`."""
    speed_trust: NDArray[np.int8]
    """(n, beams) A code of `Trust`."""

    @property
    def known(self) -> BoolArray:
        """(n,) Whether a solution states an altitude or a velocity."""
        return np.isfinite(self.altitude_m) | np.isfinite(self.velocity_site_mps).all(axis=1)
