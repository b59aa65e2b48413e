"""A rectangle of the map, and the rows and columns of a grid within it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray


class Rectangle(NamedTuple):
    """A rectangle of the map, edges included, in metres of the site frame."""

    west_m: float
    east_m: float
    south_m: float
    north_m: float

    def holds(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """Whether points lie in the rectangle, (n,)."""
        across = (self.west_m <= east_m) & (east_m <= self.east_m)
        return np.asarray(across & (self.south_m <= north_m) & (north_m <= self.north_m))


def indices_between(
    low_m: float, high_m: float, first_m: float, pixel_m: float, count: int, margin: int
) -> range:
    """Rows or columns of a grid between two coordinates, extended on each side by `margin` where the grid reaches."""
    first = min(max(math.floor((low_m - first_m) / pixel_m) - margin, 0), count - 2)
    end = min(max(math.ceil((high_m - first_m) / pixel_m) + margin + 1, first + 2), count)
    return range(first, end)
