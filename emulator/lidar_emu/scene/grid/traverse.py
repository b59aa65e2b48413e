"""Traversal of an elevation grid by a ray, block by block and cell by cell."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.grid.cell import TRIANGLES, CellRay, Grid, Interval, cell_of, corners, descent, facet

CLEAR, SURFACE, BEYOND, FACE = 0, 1, 2, 3
"""First contact of a ray: none, the surface of a cell, the ground beyond the grid, or the vertical face that joins the
two where their heights differ."""

FACE_DEPTH_M = 1e-6
"""A ray that enters this far below the ground hits a face; less is rounding at a continuous edge."""


@kernel
def meet_beyond(start: float, end: float, beyond: Interval) -> tuple[int, float]:
    """First t in [start, end] inside the ground beyond, in which the ray's line lies on an interval."""
    enter, leave = beyond
    t = max(start, enter)
    if not t <= min(end, leave):
        return CLEAR, np.nan
    return (FACE if start - enter > FACE_DEPTH_M else BEYOND), t


@kernel
def clip(position: float, rate: float, length: float) -> Interval:
    """First and last t with ``0 <= position + rate * t <= length``; (inf, -inf) if there is none."""
    if rate == 0.0:
        return (-np.inf, np.inf) if 0.0 <= position <= length else (np.inf, -np.inf)
    t0, t1 = -position / rate, (length - position) / rate
    return min(t0, t1), max(t0, t1)


@kernel
def _index(position: float, rate: float, index: int, first: int, last: int) -> int:
    """Cell at a coordinate, limited to its block and never behind ``index`` in the ray's direction."""
    if rate > 0.0:
        first = index
    elif rate < 0.0:
        last = index
    else:
        return index
    if position < first:
        return first
    return min(int(position), last)


@kernel
def _crossing(position: float, rate: float, first: int, end: int) -> float:
    """Parameter t at which a coordinate leaves the cells first ... end-1."""
    if rate > 0.0:
        return (end - position) / rate
    if rate < 0.0:
        return (first - position) / rate
    return np.inf


@kernel
def starting_level(reach: float, top_level: int) -> int:
    """Level at which four blocks are as long as the ray's path over the ground."""
    level = 0
    while level < top_level and (4 << level) < reach:
        level += 1
    return level


@kernel
def _meet_facet(
    grid: Grid,
    cell: tuple[int, int],
    southeast: bool,
    ray: CellRay,
    t: float,
    t_exit: float,
    beyond: Interval,
) -> tuple[int, float]:
    """First contact of a ray between t and t_exit, where it is over a facet of cell (i, j).

    The sign at the far end decides wherever possible, not the root: the next facet starts from the same point, so that
    a ray through an edge or a vertex hits one of its facets whatever the rounding. The root is relative to that point
    too: it has the same bits wherever the ray was followed from.
    """
    (i, j), (u, v, z, du, dv, dz) = cell, ray
    plane = facet(corners(grid.nodes, i, j), grid.constants.interpolation, southeast)
    corner, east, north, twist = plane
    if twist != twist:
        return meet_beyond(t, t_exit, beyond)
    a, b = (u - i) + t * du, (v - j) + t * dv
    height = (z + t * dz) - (corner + a * east + b * north + a * b * twist)
    if height <= 0.0:
        return (SURFACE if height >= -FACE_DEPTH_M else FACE), t
    a, b, above = (u - i) + t_exit * du, (v - j) + t_exit * dv, z + t_exit * dz
    s = descent(plane, (a, b, above), (du, dv, dz), t_exit - t)
    return (SURFACE, t_exit + s) if s == s else (CLEAR, np.nan)


@kernel
def _meet_cell(
    grid: Grid, cell: tuple[int, int], ray: CellRay, t: float, t_exit: float, beyond: Interval
) -> tuple[int, float]:
    i, j = cell
    southeast, t_facet = ray.u - i >= ray.v - j, t_exit
    if grid.constants.interpolation == TRIANGLES and ray.du != ray.dv:
        t_diagonal = ((ray.v - j) - (ray.u - i)) / (ray.du - ray.dv)
        southeast = (t < t_diagonal) == (ray.du < ray.dv)
        if t < t_diagonal < t_exit:
            t_facet = t_diagonal
    met, t_met = _meet_facet(grid, cell, southeast, ray, t, t_facet, beyond)
    if met == CLEAR and t_facet < t_exit:
        return _meet_facet(grid, cell, not southeast, ray, t_facet, t_exit, beyond)
    return met, t_met


@kernel
def traverse(
    grid: Grid, ray: CellRay, t: float, t_end: float, near: bool, face: int, beyond: Interval
) -> tuple[int, float, int, int, int]:
    """First contact of a ray between t and t_end, where it is over the grid.

    A block is skipped where the ray stays above its maximum. Otherwise the ray advances to that maximum and the block
    is opened. Cells are followed by index, from the edge by which the ray left the preceding one, and never looked up
    by position alone, so that none is left out.

    Args:
        grid, ray: grid and ray.
        t, t_end: interval in which the ray is over the grid.
        near: whether the ray is known to be close to the surface at t: cells are tested before blocks.
        face: axis (0 east, 1 north) of the edge by which the ray entered.
        beyond: interval in which the ray's line is in the ground beyond, which also fills cells without samples.

    Returns:
        Kind of contact, t, cell (i, j), and the axis of the edge by which the ray entered it.
    """
    u, v, z, du, dv, dz = ray
    maxima, levels = grid.maxima, grid.levels
    rows, columns = grid.nodes.shape[0] - 1, grid.nodes.shape[1] - 1
    i, j = cell_of(u + t * du, columns), cell_of(v + t * dv, rows)
    # The ray never rises above the level at which it begins: it crosses few of that level's blocks.
    top_level = starting_level(max(abs(du), abs(dv)) * (t_end - t), levels.shape[0] - 1)
    level = 0 if near else top_level
    while True:
        i_first, j_first = (i >> level) << level, (j >> level) << level
        i_end, j_end = min(i_first + (1 << level), columns), min(j_first + (1 << level), rows)
        t_u = _crossing(u, du, i_first, i_end)
        t_v = _crossing(v, dv, j_first, j_end)
        t_exit = max(min(t_u, t_v, t_end), t)
        if level == 0:
            met, t_met = _meet_cell(grid, (i, j), ray, t, t_exit, beyond)
            if met != CLEAR:
                return met, t_met, i, j, face
        else:
            highest = maxima[levels[level, 0] + (j >> level) * levels[level, 1] + (i >> level)]
            if z + (t_exit if dz < 0.0 else t) * dz <= highest:
                if dz < 0.0:
                    t = min(max(t, (highest - z) / dz), t_exit)
                    i = _index(u + t * du, du, i, i_first, i_end - 1)
                    j = _index(v + t * dv, dv, j, j_first, j_end - 1)
                level -= 1
                continue
        if t_exit >= t_end:
            return CLEAR, np.nan, i, j, face
        t = t_exit
        parent = level + 1
        if t_u <= t_v:
            face, i_before = 0, i
            i = i_end if du > 0.0 else i_first - 1
            j = _index(v + t * dv, dv, j, j_first, j_end - 1)
            climbs = (i >> parent) != (i_before >> parent)
        else:
            face, j_before = 1, j
            j = j_end if dv > 0.0 else j_first - 1
            i = _index(u + t * du, du, i, i_first, i_end - 1)
            climbs = (j >> parent) != (j_before >> parent)
        if not (0 <= i < columns and 0 <= j < rows):
            return CLEAR, np.nan, i, j, face
        if climbs and level < top_level:
            level += 1


_ROWS_AT_ONCE = 64
"""Rows of cells processed at a time, an even number."""


def cell_maxima(nodes_m: FloatArray, hole_m: float) -> FloatArray:
    """Greatest height of each cell; ``hole_m`` where a corner is missing.

    The bilinear surface of a cell never rises above its highest corner.
    """
    rows = np.maximum(nodes_m[:-1], nodes_m[1:])
    cells = np.maximum(rows[:, :-1], rows[:, 1:])
    return np.asarray(np.where(np.isnan(cells), hole_m, cells), dtype=np.float64)


def build_pyramid(nodes_m: FloatArray, hole_m: float) -> tuple[FloatArray, IntArray]:
    """Build all levels in one array, with the index at which each begins.

    Args:
        nodes_m: (rows, columns) heights, NaN where missing.
        hole_m: height that bounds the ground of a cell with a missing corner.

    Returns:
        The maxima of all levels, and for each level L its (first index, blocks per row). Level 0, the cells
        themselves, is not stored, since a cell's corners are read anyway: its entry is empty.
    """
    maxima: list[FloatArray] = [np.empty(0)]
    levels = [(0, 0)]
    if nodes_m.size > 4:
        blocks = _blocks_of_four(nodes_m, hole_m)
        while True:
            levels.append((sum(level.size for level in maxima), blocks.shape[1]))
            maxima.append(blocks.ravel())
            if blocks.size == 1:
                break
            blocks = _halved(blocks)
    return np.concatenate(maxima), np.array(levels, dtype=np.int64)


def _blocks_of_four(nodes_m: FloatArray, hole_m: float) -> FloatArray:
    """Level 1, computed a few rows at a time: the maxima of all cells would take as much memory as the samples."""
    firsts = range(0, len(nodes_m) - 1, _ROWS_AT_ONCE)
    return np.concatenate(
        [_halved(cell_maxima(nodes_m[first : first + _ROWS_AT_ONCE + 1], hole_m)) for first in firsts]
    )


def _halved(blocks: FloatArray) -> FloatArray:
    rows, columns = blocks.shape
    even = np.pad(blocks, ((0, rows % 2), (0, columns % 2)), constant_values=-np.inf)
    pairs = np.maximum(even[0::2], even[1::2])
    return np.maximum(pairs[:, 0::2], pairs[:, 1::2])
