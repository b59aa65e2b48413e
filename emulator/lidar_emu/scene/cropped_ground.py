"""Ground of which only what a run can reach is held; the rest comes back if a ray needs it after all."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scene.map_area import Rectangle
from lidar_emu.scene.ray_hits import Hits, Scene, contiguous
from lidar_emu.scene.ray_reach import Span, strays


class Kept(NamedTuple):
    """What is held of one grid."""

    span: Span
    """Of the whole grid; its heights are bounds for all grids of the ground."""
    area: Rectangle
    """Of what is held."""
    samples: int
    """Of the whole grid."""
    held: int
    """Of these."""


class CroppedGround:
    """A ground cut to what a run can reach.

    Which rays a run has is known beforehand, but for a fault that is ordered in flight, and for those who use the
    scene otherwise. So each ray is checked: what may need more than is held is cast onto the whole, which is built
    for the first of them. A hit is thus never that of a ground with a missing part.

    Args:
        held: what is left.
        kept: of each grid.
        build_whole: builds the ground uncut.
    """

    def __init__(self, held: Scene, kept: tuple[Kept, ...], build_whole: Callable[[], Scene]) -> None:
        self.held, self.kept = held, kept
        self.description = held.description
        self.origin_altitude_m = held.origin_altitude_m
        self._build_whole = build_whole

    @cached_property
    def whole(self) -> Scene:
        """Uncut."""
        return self._build_whole()

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        """First contact with the ground; see `Scene.cast`."""
        origin, direction = contiguous(origin_site_m, direction_site)
        hits = self.held.cast(origin, direction, hits, bundle)
        stray = self._strays(origin, direction)
        if stray.any():
            hits.set_rows(np.flatnonzero(stray), self.whole.cast(origin[stray], direction[stray]))
        return hits

    def cast_exact(self, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
        """Onto the whole ground."""
        return self.whole.cast_exact(origin_site_m, direction_site)

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """(n,) z of the ground; see `Scene.height_m`."""
        cut_away = self._cut_away(east_m, north_m)
        if cut_away.any():
            return np.where(
                cut_away, self.whole.height_m(east_m, north_m), self.held.height_m(east_m, north_m)
            )
        return self.held.height_m(east_m, north_m)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """Where the whole ground is."""
        return self.held.covers(east_m, north_m) | self._cut_away(east_m, north_m)

    def _strays(self, origin: FloatArray, direction: FloatArray) -> BoolArray:
        stray = np.zeros(len(origin), dtype=np.bool_)
        for grid in self.kept:
            stray |= strays(origin, direction, grid.span, grid.area)
        return stray

    def _cut_away(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """(n,) Whether there is a grid of which this place has been cut away."""
        cut = np.zeros(np.shape(east_m), dtype=np.bool_)
        for grid in self.kept:
            cut |= grid.span.area.holds(east_m, north_m) & ~grid.area.holds(east_m, north_m)
        return cut
