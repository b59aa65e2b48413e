"""Detail below the pixel of a grid, where the beams of a run can reach."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.ground import Detail
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.mosaic.nested import extent, nest
from lidar_emu.scene.procedural.detail import MARGIN, Law, law_of, law_with, refine
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.scene.ray_reach import Rectangle, indices_between

MAXIMUM_SAMPLES = 40_000_000
EDGE = 3
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
    count = whole.height_m.shape
    rows = indices_between(needed.south_m, needed.north_m, whole.south_m, pixel_m[0], count[0], EDGE)
    columns = indices_between(needed.west_m, needed.east_m, whole.west_m, pixel_m[1], count[1], EDGE)
    _check_size(where, rows, columns, pixel_m, halvings)
    law = _law(whole, part, where)
    margin_m = _with_margin(base, rows, columns, count)
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
