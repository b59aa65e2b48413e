"""An elevation grid: the surface through its samples, and the ground beyond it."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.records import as_record
from lidar_emu.scene.grid import cast
from lidar_emu.scene.grid.pyramid import build_pyramid
from lidar_emu.scene.grid.samples import Samples
from lidar_emu.scene.grid.structures import BILINEAR, NO_GROUND, PLANE, SPHERE, TRIANGLES, GridConstants
from lidar_emu.scene.plane import PlaneGround
from lidar_emu.scene.ray_hits import Hits, contiguous
from lidar_emu.scene.sphere import SphereGround


class GridGround:
    """An elevation grid over the site's horizontal plane; its heights include the curvature of the body.

    A cell is the bilinear surface between four samples, or two triangles; a cell with a missing sample counts as beyond
    the grid. Where the edge of the grid is higher or lower than the ground beyond it, a vertical face joins the two.
    Without ground beyond, a ray that reaches such an edge from below the surface hits nothing.

    Args:
        samples: heights in the site frame.
        beyond: ground around the grid and in its holes, through the origin; None if there is none.
        description: one line for plans.
        origin_altitude_m: height of the origin above the body's sphere.
        reflectance: albedo, also of the ground beyond.
    """

    def __init__(
        self,
        samples: Samples,
        beyond: PlaneGround | SphereGround | None,
        description: str,
        origin_altitude_m: float,
        reflectance: float = 1.0,
    ) -> None:
        self.samples = samples
        self.reflectance = reflectance
        self.beyond = beyond
        self.description = description
        self.origin_altitude_m = origin_altitude_m
        # The ground beyond, a level plane or a sphere, is nowhere higher than the origin.
        hole_m = -np.inf if beyond is None else 0.0
        self._maxima, self._levels = build_pyramid(samples.height_m, hole_m)
        self._constants = self._record()

    def with_reflectance(self, reflectance: float) -> GridGround:
        """The same ground with another albedo; samples are shared."""
        twin = copy(self)
        twin.reflectance = reflectance
        twin._constants = twin._record()
        return twin

    def _record(self) -> Any:
        samples = self.samples
        lowest_m, highest_m = samples.bounds_with(self.beyond)
        return as_record(
            GridConstants(
                west_m=float(samples.west_m),
                south_m=float(samples.south_m),
                cells_per_m_east=1 / samples.pixel_east_m,
                cells_per_m_north=1 / samples.pixel_north_m,
                ceiling_m=float(highest_m),
                floor_m=lowest_m - 1.0,
                first_column=float(samples.first_column),
                first_row=float(samples.first_row),
                interpolation=TRIANGLES if samples.interpolation == "triangles" else BILINEAR,
                beyond=_kind_of(self.beyond),
                beyond_radius_m=self.beyond.radius_m if isinstance(self.beyond, SphereGround) else np.inf,
                albedo=float(self.reflectance),
            )
        )

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        origin, direction = contiguous(origin_site_m, direction_site)
        hits = hits or Hits.empty(len(origin))
        cast.cast_rays(
            origin,
            direction,
            bundle,
            self._constants,
            self.samples.height_m,
            self._maxima,
            self._levels,
            *hits.on_static_ground,
        )
        return hits

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        east, north = contiguous(east_m, north_m)
        height = np.empty_like(east)
        cast.surface_heights(self._constants, self.samples.height_m, east, north, height)
        if self.beyond is None:
            return height
        return np.where(np.isnan(height), self.beyond.height_m(east, north), height)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """True over the grid, holes included, and wherever there is ground beyond it."""
        if self.beyond is not None:
            return self.beyond.covers(east_m, north_m)
        east, north = self.samples.east_m, self.samples.north_m
        return np.asarray(
            (east[0] <= east_m) & (east_m <= east[-1]) & (north[0] <= north_m) & (north_m <= north[-1])
        )


def _kind_of(beyond: PlaneGround | SphereGround | None) -> int:
    if beyond is None:
        return NO_GROUND
    return PLANE if isinstance(beyond, PlaneGround) else SPHERE
