"""Ground cropped to the part that a run can reach; a ray that needs more causes the whole ground to be built."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scene.map_area import Rectangle
from lidar_emu.scene.ray_hits import Hits, Scene, contiguous
from lidar_emu.scene.ray_reach import Span, strays


class CroppedGrid(NamedTuple):
    """The part of one grid that is in memory."""

    span: Span
    """Extent of the whole grid, with heights that bound all grids of the ground."""
    area: Rectangle
    """Area of that part."""
    samples: int
    """Samples of the whole grid."""
    retained: int
    """Samples of that part."""


class CroppedGround:
    """A ground cut to what a run can reach.

    The rays of a run are known in advance, except with faults injected in flight and in other uses of the scene. Each
    ray is therefore checked: a ray that may need more than that part is cast onto the whole ground, which is built
    on first use. The hits equal those on the whole ground.

    Args:
        cropped: the cropped ground.
        grids: the part of each grid in memory.
        build_whole: builds the whole ground.
    """

    def __init__(
        self, cropped: Scene, grids: tuple[CroppedGrid, ...], build_whole: Callable[[], Scene]
    ) -> None:
        self.cropped, self.grids = cropped, grids
        self.description = cropped.description
        self.origin_altitude_m = cropped.origin_altitude_m
        self._build_whole = build_whole

    @cached_property
    def whole(self) -> Scene:
        """The ground before cropping."""
        return self._build_whole()

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        origin, direction = contiguous(origin_site_m, direction_site)
        hits = self.cropped.cast(origin, direction, hits, bundle)
        stray = self._strays(origin, direction)
        if stray.any():
            hits.set_rows(np.flatnonzero(stray), self.whole.cast(origin[stray], direction[stray]))
        return hits

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        cut_away = self._cut_away(east_m, north_m)
        if cut_away.any():
            return np.where(
                cut_away, self.whole.height_m(east_m, north_m), self.cropped.height_m(east_m, north_m)
            )
        return self.cropped.height_m(east_m, north_m)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """(n,) Whether points lie over the whole ground."""
        return self.cropped.covers(east_m, north_m) | self._cut_away(east_m, north_m)

    def _strays(self, origin: FloatArray, direction: FloatArray) -> BoolArray:
        stray = np.zeros(len(origin), dtype=np.bool_)
        for grid in self.grids:
            stray |= strays(origin, direction, grid.span, grid.area)
        return stray

    def _cut_away(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """(n,) Whether cropping has removed these points from any grid."""
        cut = np.zeros(np.shape(east_m), dtype=np.bool_)
        for grid in self.grids:
            cut |= grid.span.area.holds(east_m, north_m) & ~grid.area.holds(east_m, north_m)
        return cut
