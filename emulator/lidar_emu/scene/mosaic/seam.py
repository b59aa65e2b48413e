"""Blending of a finer grid into the surrounding ground along its edges and holes, and comparison of the two."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.grid.samples import Samples
from lidar_emu.scene.map_area import Rectangle
from lidar_emu.scene.mosaic.nested import NestedGround, Seam
from lidar_emu.scene.ray_hits import Scene

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
    """Median of the differences between a grid and the ground that it replaces, and their scatter."""
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
    return max(_apart_m(inner, outer, *edge_m) for edge_m in edges_m)


def _apart_m(inner: Scene, outer: Scene, east_m: FloatArray, north_m: FloatArray) -> float:
    apart_m = np.abs(inner.height_m(east_m, north_m) - outer.height_m(east_m, north_m))
    return float(np.nanmax(apart_m, initial=0.0))


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
