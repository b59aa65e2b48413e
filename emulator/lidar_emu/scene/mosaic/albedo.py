"""Ground whose albedo varies with position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.grid.cell import surface
from lidar_emu.scene.grid.structures import BILINEAR
from lidar_emu.scene.ray_hits import GROUND, Hits, Scene, contiguous


@dataclass(frozen=True)
class Albedo:
    """Samples of the albedo in the site frame, bilinear between them."""

    share: FloatArray
    """(rows, columns) Albedo, 0 to 1, rows from south to north; NaN where missing."""
    west_m: float
    """East coordinate of the whole map's first column."""
    south_m: float
    """North coordinate of the whole map's first row."""
    pixel_east_m: float
    """Distance between columns."""
    pixel_north_m: float
    """Distance between rows."""
    first_column: int = 0
    """Index in the whole map of the first column held."""
    first_row: int = 0
    """Index in the whole map of the first row held."""


@kernel(outermost=True)
def _paint(
    origin: FloatArray,
    direction: FloatArray,
    range_m: FloatArray,
    object_id: NDArray[np.int16],
    share: FloatArray,
    place: FloatArray,
    reflectance: FloatArray,
) -> None:
    west, south, columns_per_m, rows_per_m, first_column, first_row = place
    for k in range(range_m.shape[0]):
        if object_id[k] != GROUND:
            continue
        u = (origin[k, 0] + range_m[k] * direction[k, 0] - west) * columns_per_m - first_column
        v = (origin[k, 1] + range_m[k] * direction[k, 1] - south) * rows_per_m - first_row
        if 0.0 <= u <= share.shape[1] - 1 and 0.0 <= v <= share.shape[0] - 1:
            found = surface(share, BILINEAR, u, v)
            if found == found:
                reflectance[k] = found


class PaintedGround:
    """A ground with the albedo of a map, and its own where the map has none.

    Args:
        ground: ground that is hit.
        albedo: its albedo by position.
    """

    def __init__(self, ground: Scene, albedo: Albedo) -> None:
        self.ground = ground
        self.albedo = albedo
        self.description, self.origin_altitude_m = ground.description, ground.origin_altitude_m
        self.height_m, self.covers = ground.height_m, ground.covers
        self._place = np.array(
            [
                albedo.west_m,
                albedo.south_m,
                1 / albedo.pixel_east_m,
                1 / albedo.pixel_north_m,
                albedo.first_column,
                albedo.first_row,
            ]
        )

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        hits = self.ground.cast(origin_site_m, direction_site, hits, bundle)
        origin, direction = contiguous(origin_site_m, direction_site)
        _paint(
            origin, direction, hits.range_m, hits.object_id, self.albedo.share, self._place, hits.reflectance
        )
        return hits
