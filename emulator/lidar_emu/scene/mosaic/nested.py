"""A finer ground within a wider one, over a rectangle of the site's map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.grid.traverse import FACE_DEPTH_M, clip
from lidar_emu.scene.ray_hits import Hits, RayCaster, Scene
from lidar_emu.scene.ray_reach import Rectangle


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


class NestedGround(RayCaster):
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

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, bundle: int) -> None:
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
        """Continue rays over a ground from t (n,) on, and set their hits. Rays below it at the seam hit it there."""
        rows = np.flatnonzero(rays)
        way, t = direction[rows], t[rows]
        start = origin[rows] + t[:, None] * way
        found = ground.cast(start, way)
        below = np.flatnonzero(found.inside & (t > 0.0))
        if below.size:
            # Clear of the ground by more than rounding.
            clearance_m = 8 * np.spacing(np.abs(start[below]).max(axis=1))
            least_m = ground.height_m(start[below, 0], start[below, 1]) + clearance_m
            lifted = below[least_m - start[below, 2] <= self._lift_m]
            start[below, 2] = least_m
            found.set_rows(lifted, ground.cast(start[lifted], way[lifted]))
            # A ray that is lower than the seam's step came out of a hole without ground.
            found.inside[below] = False
        hits.set_rows(rows, found)
        hits.range_m[rows] += t


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


_COMPARED = 10_000
"""Maximum number of samples at which two grids are compared; more would not improve the comparison."""
_ROWS_AT_ONCE = 256
_BESIDE_M = 1e-9


def nest(
    samples: Samples,
    area: Rectangle,
    outer: Scene,
    feather_m: float,
    build: Callable[[Samples], GridGround],
) -> NestedGround:
    """Nest a grid in a ground.

    Over a strip along its edges, and around missing samples, the grid is blended with the surrounding ground; at its
    edge and where a sample is missing it has that ground's height. Without ground there, it is unchanged.

    Args:
        samples: samples of the grid, or of a cropped part.
        area: extent of the whole grid.
        outer: surrounding ground.
        feather_m: width of the strip.
        build: builds the grid's ground, with nothing beyond, from samples.
    """
    offset_m, scatter_m = _compared(samples, outer)
    inner = build(replace(samples, height_m=_feathered(samples, area, outer, feather_m)))
    step_m = _step_m(inner, outer, area)
    return NestedGround(outer, inner, area, Seam(feather_m, step_m, offset_m, scatter_m))


def extent(samples: Samples) -> Rectangle:
    """Area that the samples span."""
    east_m, north_m = samples.east_m, samples.north_m
    return Rectangle(float(east_m[0]), float(east_m[-1]), float(north_m[0]), float(north_m[-1]))


def _compared(samples: Samples, outer: Scene) -> tuple[float, float]:
    step = max(1, int(np.sqrt(samples.height_m.size / _COMPARED)))
    east_m, north_m = np.meshgrid(samples.east_m[::step], samples.north_m[::step])
    outer_m = outer.height_m(east_m.ravel(), north_m.ravel())
    difference_m = samples.height_m[::step, ::step].ravel() - outer_m
    difference_m = difference_m[np.isfinite(difference_m)]
    if not difference_m.size:
        return np.nan, np.nan
    low_m, median_m, high_m = np.percentile(difference_m, [16, 50, 84])
    return float(median_m), float(high_m - low_m) / 2


def _feathered(samples: Samples, area: Rectangle, outer: Scene, feather_m: float) -> FloatArray:
    height_m = samples.height_m.copy()
    away_m = _from_holes_m(samples)
    east_m, north_m = samples.east_m, samples.north_m
    from_sides_m = np.minimum(east_m - area.west_m, area.east_m - east_m)
    from_ends_m = np.minimum(north_m - area.south_m, area.north_m - north_m)
    for first in range(0, len(height_m), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        near_m = np.minimum(from_ends_m[rows, None], from_sides_m)
        if away_m is not None:
            near_m = np.minimum(near_m, away_m[rows])
        # Also without a strip the edge has the outer heights: nothing else closes the seam.
        row, column = np.nonzero((near_m < feather_m) | (near_m == 0.0))
        part = np.minimum(near_m[row, column] / feather_m, 1.0) if feather_m else np.zeros(len(row))
        share = part * part * (3.0 - 2.0 * part)
        own_m = height_m[rows][row, column]
        outer_m = outer.height_m(east_m[column], north_m[rows][row])
        mixed_m = np.where(share > 0.0, share * own_m + (1.0 - share) * outer_m, outer_m)
        height_m[rows][row, column] = np.where(np.isnan(outer_m), own_m, mixed_m)
    return height_m


def _from_holes_m(samples: Samples) -> FloatArray | None:
    """Distance (rows, columns) to the nearest missing sample; None if there is none."""
    missing = np.isnan(samples.height_m)
    if not missing.any():
        return None
    from scipy.ndimage import distance_transform_edt

    pitch_m = samples.pixel_north_m, samples.pixel_east_m
    return np.asarray(distance_transform_edt(~missing, sampling=pitch_m), dtype=np.float64)


def _step_m(inner: GridGround, outer: Scene, rectangle: Rectangle) -> float:
    """Maximum difference along the edges: at a grid line of either side, just beside it, or half-way between two."""
    east_lines_m, north_lines_m = grid_lines_m(outer)
    east_m = _places_m(np.append(inner.samples.east_m, east_lines_m), *rectangle[:2])
    north_m = _places_m(np.append(inner.samples.north_m, north_lines_m), *rectangle[2:])
    edges_m = [(east_m, np.full(len(east_m), edge_m)) for edge_m in rectangle[2:]]
    edges_m += [(np.full(len(north_m), edge_m), north_m) for edge_m in rectangle[:2]]
    apart_m = [np.abs(inner.height_m(*edge_m) - outer.height_m(*edge_m)) for edge_m in edges_m]
    return float(np.nanmax(np.concatenate(apart_m), initial=0.0))


def _places_m(lines_m: FloatArray, first_m: float, last_m: float) -> FloatArray:
    lines_m = np.unique(lines_m[(first_m <= lines_m) & (lines_m <= last_m)])
    beside_m = lines_m[:, None] + np.array([-_BESIDE_M, 0.0, _BESIDE_M])
    places_m = np.concatenate([beside_m.ravel(), (lines_m[1:] + lines_m[:-1]) / 2])
    return np.asarray(np.clip(places_m, first_m, last_m), dtype=np.float64)


def grid_lines_m(ground: Scene) -> tuple[FloatArray, FloatArray]:
    """East coordinates of the grid lines of a ground that run north, and north coordinates of those that run east."""
    if isinstance(ground, NestedGround):
        pairs = zip(grid_lines_m(ground.inner), grid_lines_m(ground.outer), strict=True)
        east_m, north_m = (np.concatenate(pair) for pair in pairs)
        return east_m, north_m
    if isinstance(ground, GridGround):
        return ground.samples.east_m, ground.samples.north_m
    return np.empty(0), np.empty(0)
