"""The samples of an elevation grid in the site frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.generated_ground import Interpolation
from lidar_emu.scene.plane import PlaneGround
from lidar_emu.scene.sphere import SphereGround


@dataclass(frozen=True)
class Samples:
    """Samples of a grid in the site frame, or of a part of it, with at least four neighbouring samples. Coordinates of
    a part count from the whole grid's first sample: rays hit it with the same bits."""

    height_m: FloatArray
    """(rows, columns) site z, rows from south to north, columns from west to east; NaN where missing."""
    west_m: float
    """East coordinate of the whole grid's first column."""
    south_m: float
    """North coordinate of the whole grid's first row."""
    pixel_east_m: float
    """Distance between columns."""
    pixel_north_m: float
    """Distance between rows."""
    interpolation: Interpolation = "bilinear"
    """Surface of a cell, see `scenario.site.ElevationGrid`."""
    first_column: int = 0
    """Index in the whole grid of the first column held."""
    first_row: int = 0
    """Index in the whole grid of the first row held."""
    bounds_m: tuple[float, float] | None = None
    """Lowest and highest height of the whole grid and of the ground that fills its holes, where known; equal for all
    parts."""

    @property
    def east_m(self) -> FloatArray:
        """East coordinates (columns,)."""
        columns = np.arange(self.first_column, self.first_column + self.height_m.shape[1], dtype=np.float64)
        return self.west_m + self.pixel_east_m * columns

    @property
    def north_m(self) -> FloatArray:
        """North coordinates (rows,)."""
        rows = np.arange(self.first_row, self.first_row + self.height_m.shape[0], dtype=np.float64)
        return self.south_m + self.pixel_north_m * rows

    def bounds_with(self, beyond: PlaneGround | SphereGround | None) -> tuple[float, float]:
        """Lowest and highest height of the samples, and of the ground beyond where it fills holes."""
        if self.bounds_m is not None:
            return self.bounds_m
        lowest_m, highest_m = float(np.nanmin(self.height_m)), float(np.nanmax(self.height_m))
        if beyond is None:
            return lowest_m, highest_m
        radius_m = beyond.radius_m if isinstance(beyond, SphereGround) else np.inf
        # A sphere falls by less than the square of the distance divided by its radius.
        square_m2 = max(np.square(self.east_m)) + max(np.square(self.north_m))
        return min(lowest_m, -float(square_m2) / radius_m), max(highest_m, 0.0)
