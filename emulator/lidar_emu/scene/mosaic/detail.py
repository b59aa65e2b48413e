"""Seeded relief below the pixel of an elevation grid, by the scaling law of the grid, where the beams of a run reach.

The grid spacing is halved repeatedly. A new point is the ordinary kriging estimate from its neighbours, under the law
that heights r apart differ by the variance A r^2H, plus a Gaussian number with the variance of that estimate (Lewis
1987, "Generalized stochastic subdivision", with the variogram of fractional Brownian relief). The given samples are
unchanged, each scale has the roughness of the law, and a point depends only on its surroundings and its own random
number: it is independent of how the grid is cropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.scenario.ground import Detail
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.mosaic.nested import extent, nest
from lidar_emu.scene.procedural.generate import second_structure_function
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.scene.ray_reach import Rectangle

MARGIN = 4
"""Margin, in samples of the grid, on which the detail of an area depends."""

_LAGS = np.array([1, 2, 4])
_ROUGHEST, _SMOOTHEST = 0.05, 0.95
_TILE = 128
"""Side of the blocks in which the random numbers of a level are drawn."""
_TRIM = 4
"""Rows and columns along each edge of a refined grid whose neighbours are incomplete."""

_CENTRE = [(row, column) for row in (-3, -1, 1, 3) for column in (-3, -1, 1, 3)]
_EDGE = [(row, column) for row in (-2, -1, 0, 1, 2) for column in (-2, -1, 0, 1, 2) if (row + column) % 2]
"""Neighbours, in rows and columns of the refined grid: of a new point at the centre of four, and of one between two
given points."""


class Law(NamedTuple):
    """Heights r metres apart differ by a Gaussian of variance A r^2H."""

    hurst: float
    variance_at_1_m: float
    """Factor A, for r in metres."""

    def rms_slope(self, baseline_m: float) -> float:
        """Root mean square difference of height over a baseline, divided by the baseline."""
        return float(math.sqrt(self.variance_at_1_m) * baseline_m ** (self.hurst - 1.0))


def law_with(hurst: float, rms_slope: float, baseline_m: float) -> Law:
    """Law with a given rms slope over a baseline."""
    return Law(hurst, (rms_slope * baseline_m ** (1.0 - hurst)) ** 2)


def law_of(height_m: FloatArray, pixel_m: float, hurst: float | None = None) -> Law | None:
    """Estimate the law of a grid at its finest scales, by second differences over 1, 2 and 4 pixels.

    Second differences are insensitive to tilt; under the law their variance is (4 - 4^H) A r^2H. A fits the finest lag,
    H fits the growth over all three, limited to 0.05 to 0.95, since products are smooth at their finest scale.

    Args:
        height_m: (rows, columns) heights; NaN where missing.
        pixel_m: mean spacing of both directions.
        hurst: H, if it is given.

    Returns:
        The law; None if the grid is too small or has too many holes for an estimate.
    """
    if min(height_m.shape) <= 2 * _LAGS[-1]:
        return None
    square_m2 = second_structure_function(height_m, _LAGS)
    if not np.isfinite(square_m2).all():
        return None
    if not square_m2.all():
        return Law(_SMOOTHEST if hurst is None else hurst, 0.0)
    if hurst is None:
        growth = np.polyfit(np.log(_LAGS), np.log(square_m2), 1)[0] / 2
        hurst = float(np.clip(growth, _ROUGHEST, _SMOOTHEST))
    return Law(hurst, float(square_m2[0]) / (4.0 - 4.0**hurst) / pixel_m ** (2 * hurst))


def refine(
    height_m: FloatArray,
    first: tuple[int, int],
    pixel_m: tuple[float, float],
    halvings: int,
    law: Law,
    seed: int,
) -> FloatArray:
    """Refine an area of a grid with detail.

    Args:
        height_m: (rows, columns) heights of the area with `MARGIN` samples around it.
        first: row and column of the first of these samples in the whole grid; may be negative.
        pixel_m: spacing of rows and of columns.
        halvings: how often the spacing is halved.
        law: law of the relief.
        seed: seed of the random numbers.

    Returns:
        Heights of the area alone, 2^halvings steps from sample to sample.
    """
    row, column = first
    for level in range(halvings):
        row, column = 2 * row, 2 * column
        step_m = pixel_m[0] / 2 ** (level + 1), pixel_m[1] / 2 ** (level + 1)
        height_m = _halved(height_m, (row, column), step_m, law, (seed, level))
        row, column = row + _TRIM, column + _TRIM
    # Each halving turns a margin of M into 2 M - 4 steps: a margin of 4 is preserved.
    return height_m[MARGIN:-MARGIN, MARGIN:-MARGIN]


def _halved(
    coarse_m: FloatArray, first: tuple[int, int], step_m: tuple[float, float], law: Law, key: tuple[int, int]
) -> FloatArray:
    """The grid with a new point between every two, without the edges that have too few neighbours."""
    rows, columns = (2 * n - 1 for n in coarse_m.shape)
    fine_m = np.zeros((rows, columns))
    fine_m[::2, ::2] = coarse_m
    weight, deviation_m = _kriging(_CENTRE, step_m, law)
    _set_points(fine_m, (3, 3), _CENTRE, weight, deviation_m, first, (*key, 0))
    weight, deviation_m = _kriging(_EDGE, step_m, law)
    _set_points(fine_m, (5, 4), _EDGE, weight, deviation_m, first, (*key, 1))
    _set_points(fine_m, (4, 5), _EDGE, weight, deviation_m, first, (*key, 2))
    return fine_m[_TRIM:-_TRIM, _TRIM:-_TRIM]


def _set_points(
    fine_m: FloatArray,
    start: tuple[int, int],
    neighbours: list[tuple[int, int]],
    weight: FloatArray,
    deviation_m: float,
    first: tuple[int, int],
    key: tuple[int, int, int],
) -> None:
    ends = fine_m.shape[0] - start[0], fine_m.shape[1] - start[1]
    count = len(range(start[0], ends[0], 2)), len(range(start[1], ends[1], 2))
    place = (first[0] + start[0]) // 2, (first[1] + start[1]) // 2
    points = deviation_m * lattice(key, place, count)
    for (row, column), share in zip(neighbours, weight.tolist(), strict=True):
        points += share * fine_m[start[0] + row : ends[0] + row : 2, start[1] + column : ends[1] + column : 2]
    fine_m[start[0] : ends[0] : 2, start[1] : ends[1] : 2] = points


def _kriging(
    neighbours: list[tuple[int, int]], step_m: tuple[float, float], law: Law
) -> tuple[FloatArray, float]:
    """Kriging weights (neighbours,) of a point, and the standard deviation of the estimate."""
    place_m = np.array(neighbours, dtype=np.float64) * step_m
    between_m = np.hypot(*(place_m[:, None] - place_m).transpose(2, 0, 1))
    # In units in which the law is r^2H / 2: the weights do not depend on A.
    unit_m = math.hypot(*step_m)
    system = np.ones((len(place_m) + 1, len(place_m) + 1))
    system[:-1, :-1] = (between_m / unit_m) ** (2 * law.hurst) / 2
    system[-1, -1] = 0.0
    to_point = np.append((np.hypot(*place_m.T) / unit_m) ** (2 * law.hurst) / 2, 1.0)
    solution = np.linalg.solve(system, to_point)
    variance_m2 = law.variance_at_1_m * unit_m ** (2 * law.hurst) * float((solution * to_point).sum())
    return solution[:-1], math.sqrt(max(variance_m2, 0.0))


def lattice(key: tuple[int, int, int], first: tuple[int, int], count: tuple[int, int]) -> FloatArray:
    """Standard normal numbers (rows, columns) of an unbounded lattice, each determined by key and position alone."""
    part = np.empty(count)
    for tile_row in range(first[0] // _TILE, (first[0] + count[0] - 1) // _TILE + 1):
        for tile_column in range(first[1] // _TILE, (first[1] + count[1] - 1) // _TILE + 1):
            rows, of_rows = _overlap(tile_row * _TILE, first[0], count[0])
            columns, of_columns = _overlap(tile_column * _TILE, first[1], count[1])
            # Seeds must be natural numbers, but positions west and north of the first sample are negative.
            stream = generator(*key, tile_row + 2**31, tile_column + 2**31)
            tile = stream.standard_normal((_TILE, _TILE))
            part[rows, columns] = tile[of_rows, of_columns]
    return part


def _overlap(tile: int, first: int, count: int) -> tuple[slice, slice]:
    start, end = max(tile, first), min(tile + _TILE, first + count)
    return slice(start - first, end - first), slice(start - tile, end - tile)


MAXIMUM_SAMPLES = 40_000_000
EDGE_PIXELS = 3
"""Margin, in pixels of the grid, between the area that beams need and the edge of the detail; two of them are the seam.
"""
SEAM_PIXELS = 2


def detailed(
    outer: Scene,
    base: Samples,
    whole: Samples,
    needed: Rectangle,
    part: Detail,
    where: str,
    build: Callable[[Samples, str], GridGround],
) -> Scene:
    """Set a finer grid with detail into one of the grids of a ground.

    Args:
        outer: ground in which the grid was nested last.
        base: samples of the grid as nested.
        whole: samples of the grid in its file, from which the law of its relief is estimated.
        needed: area that needs detail; nothing is done if it is empty.
        part: the scenario's `detail`.
        where: file of the grid, for refusals.
        build: builds the finer grid's ground, with nothing beyond, from samples and a description.
    """
    pixel_m = whole.pixel_north_m, whole.pixel_east_m
    halvings = math.ceil(math.log2(max(pixel_m) / part.spacing_m) - 1e-9)
    if halvings <= 0 or not needed.west_m <= needed.east_m:
        return outer
    rows, columns = whole.within(needed, EDGE_PIXELS)
    _check_size(where, rows, columns, pixel_m, halvings)
    law = _law(whole, part, where)
    margin_m = _with_margin(base, rows, columns, whole.height_m.shape)
    height_m = refine(
        margin_m, (rows.start - MARGIN, columns.start - MARGIN), pixel_m, halvings, law, part.seed
    )
    samples = Samples(
        height_m=height_m,
        west_m=whole.west_m + columns.start * pixel_m[1],
        south_m=whole.south_m + rows.start * pixel_m[0],
        pixel_east_m=pixel_m[1] / 2**halvings,
        pixel_north_m=pixel_m[0] / 2**halvings,
        interpolation=whole.interpolation,
    )
    slope_deg = math.degrees(math.atan(law.rms_slope(max(pixel_m))))
    description = (
        f"detail to {max(pixel_m) / 2**halvings:.3g} m, H {law.hurst:.2f}, rms slope {slope_deg:.2g}° over a pixel, "
        f"{height_m.shape[1]} x {height_m.shape[0]} samples"
    )
    return nest(samples, extent(samples), outer, SEAM_PIXELS * max(pixel_m), lambda s: build(s, description))


def _check_size(where: str, rows: range, columns: range, pixel_m: tuple[float, float], halvings: int) -> None:
    samples = (len(rows) - 1) * (len(columns) - 1) * 4**halvings
    if samples > MAXIMUM_SAMPLES:
        found = f"{samples} samples over {len(columns) * pixel_m[1]:.0f} m x {len(rows) * pixel_m[0]:.0f} m"
        remedy = f"at most {MAXIMUM_SAMPLES} fit: raise spacing_m, or lower below_m"
        raise InputError(where, "ground.detail", Finding(found), remedy)


def _law(whole: Samples, part: Detail, where: str) -> Law:
    pixel_m = (whole.pixel_north_m + whole.pixel_east_m) / 2
    if part.hurst is not None and part.rms_slope_deg is not None:
        return law_with(part.hurst, math.tan(math.radians(part.rms_slope_deg)), pixel_m)
    law = law_of(whole.height_m, pixel_m, part.hurst)
    if law is None:
        found = Finding("too few samples to estimate the roughness of the grid")
        raise InputError(where, "ground.detail", found, "state hurst and rms_slope_deg")
    if part.rms_slope_deg is None:
        return law
    return law_with(law.hurst, math.tan(math.radians(part.rms_slope_deg)), pixel_m)


def _with_margin(base: Samples, rows: range, columns: range, count: tuple[int, ...]) -> FloatArray:
    """Heights of these rows and columns with a margin; beyond the edge of the grid they continue by point
    reflection."""
    taken, padding = [], []
    for lines, first, whole in ((rows, base.first_row, count[0]), (columns, base.first_column, count[1])):
        start, end = max(lines.start - MARGIN, 0), min(lines.stop + MARGIN, whole)
        taken.append(slice(start - first, end - first))
        padding.append((start - lines.start + MARGIN, lines.stop + MARGIN - end))
    return np.pad(base.height_m[tuple(taken)], padding, mode="reflect", reflect_type="odd")
