"""A part of the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.arrays import BoolArray, FloatArray


class Rectangle(NamedTuple):
    """A part of the map, edges included, in metres of the site frame."""

    west_m: float
    east_m: float
    south_m: float
    north_m: float

    def holds(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """(n,) Whether points lie in it."""
        across = (self.west_m <= east_m) & (east_m <= self.east_m)
        return np.asarray(across & (self.south_m <= north_m) & (north_m <= self.north_m))
