"""A finer ground within a wider one, over a rectangle of the site's map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.records import as_record
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.grid.traverse import FACE_DEPTH_M, clip
from lidar_emu.scene.map_area import Rectangle
from lidar_emu.scene.ray_hits import Hits, Scene, contiguous


class Seam(NamedTuple):
    """Transition between a grid and the ground around it."""

    feather_m: float
    """Width of the strip over which the heights are blended."""
    step_m: float
    """Maximum remaining difference of height along the edge."""
    offset_m: float
    """Median height of the grid above the ground that it replaces, from the files; NaN if they do not overlap."""
    scatter_m: float
    """Scatter of this offset: half the width of the central 68 %."""


class NestedGround:
    """Two grounds; the inner one replaces the outer one over its rectangle.

    A ray is cast onto the parts in the order in which it passes over them. At the seam the two surfaces differ by at
    most `seam.step_m`: a ray that arrives less than that below the surface ahead hits it, as if the surface were
    continuous, so that no ray is lost.

    Args:
        outer: surrounding ground, which may itself be nested.
        inner: ground over the rectangle, with nothing beyond.
        rectangle: extent of the inner ground.
        seam: transition between the two.
    """

    def __init__(self, outer: Scene, inner: GridGround, rectangle: Rectangle, seam: Seam) -> None:
        self.outer, self.inner, self.rectangle, self.seam = outer, inner, rectangle, seam
        self.description = f"{inner.description}; in {outer.description}"
        self.origin_altitude_m = inner.origin_altitude_m
        self._lift_m = seam.step_m + FACE_DEPTH_M

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        origin, direction = contiguous(origin_site_m, direction_site)
        hits = hits or Hits.empty(len(origin))
        t_in, t_out = np.empty(len(origin)), np.empty(len(origin))
        _set_stretches(origin, direction, as_record(self.rectangle), t_in, t_out)
        if (t_in == 0.0).all():
            self.inner.cast(origin, direction, hits, bundle)
        else:
            self.outer.cast(origin, direction, hits, bundle)
            begins_here = t_in == 0.0
            comes_here = (t_in <= t_out) & ~(hits.range_m <= t_in) & ~hits.inside
            self._go_on(self.inner, origin, direction, hits, begins_here | comes_here, t_in)
        leaves = np.isnan(hits.range_m) & ~hits.inside & (t_in <= t_out) & np.isfinite(t_out)
        if leaves.any():
            self._go_on(self.outer, origin, direction, hits, leaves, t_out)
        return hits

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        inner_m = self.inner.height_m(east_m, north_m)
        return np.where(np.isnan(inner_m), self.outer.height_m(east_m, north_m), inner_m)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        return self.inner.covers(east_m, north_m) | self.outer.covers(east_m, north_m)

    def _go_on(
        self,
        ground: Scene,
        origin: FloatArray,
        direction: FloatArray,
        hits: Hits,
        rays: BoolArray,
        t: FloatArray,
    ) -> None:
        """Continue rays over a ground from t (n,) on, and set their hits."""
        rows = np.flatnonzero(rays)
        hits.set_rows(rows, self._cast_from(ground, origin[rows], direction[rows], t[rows]))
        hits.range_m[rows] += t[rows]

    def _cast_from(self, ground: Scene, origin: FloatArray, direction: FloatArray, t: FloatArray) -> Hits:
        """Hits of rays on a ground, with ranges relative to t (n,). Rays that are below it at the seam hit it there."""
        start = origin + t[:, None] * direction
        hits = ground.cast(start, direction)
        below = np.flatnonzero(hits.inside & (t > 0.0))
        if below.size:
            # Clear of the ground by more than rounding.
            least_m = ground.height_m(start[below, 0], start[below, 1]) + 8 * np.spacing(
                np.abs(start[below]).max(axis=1)
            )
            lifted = below[least_m - start[below, 2] <= self._lift_m]
            start[below, 2] = least_m
            hits.set_rows(lifted, ground.cast(start[lifted], direction[lifted]))
            # A ray that is lower than the seam's step came out of a hole without ground.
            hits.inside[below] = False
        return hits


@kernel(outermost=True)
def _set_stretches(
    origin: FloatArray,
    direction: FloatArray,
    rectangles: NDArray[np.void],
    t_in: FloatArray,
    t_out: FloatArray,
) -> None:
    """Set the first and last t >= 0 at which rays are over a rectangle; (inf, -inf) if they never are. A ray with NaN
    gets an empty interval at its start."""
    area = rectangles[0]
    west, east, south, north = area.west_m, area.east_m, area.south_m, area.north_m
    for k in range(len(t_in)):
        x_in, x_out = clip(origin[k, 0] - west, direction[k, 0], east - west)
        y_in, y_out = clip(origin[k, 1] - south, direction[k, 1], north - south)
        t_in[k], t_out[k] = max(x_in, y_in, 0.0), min(x_out, y_out)
        if not np.isfinite(origin[k].sum() + direction[k].sum()):
            t_in[k], t_out[k] = 0.0, -np.inf
        elif not t_in[k] <= t_out[k]:
            t_in[k], t_out[k] = np.inf, -np.inf
