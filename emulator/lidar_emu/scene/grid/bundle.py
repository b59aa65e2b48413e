"""Clear distance of a bundle of nearly parallel, close rays, found once for all of them.

The bundle is followed as a box that encloses all its rays, so that the distance holds for each of them; it is short for
rays that diverge.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.grid.cell import (
    BILINEAR,
    TRIANGLES,
    Corners,
    Grid,
    GridConstants,
    corners,
    descent,
    facet,
    in_cells,
)
from lidar_emu.scene.grid.traverse import starting_level

_MARGIN_CELLS = 1e-6
"""Margin by which the box exceeds the rays, and distance within which it includes neighbouring blocks: whether rounding
takes the box out of a block or not, its rays are still within, and the next block is included."""
_MARGIN_M = 1e-6
"""Margin of a clear ray: rounding cannot make a single ray hit the ground within the clear distance."""


@kernel
def clear_way_m(origin: FloatArray, direction: FloatArray, grid: Grid) -> float:
    """Distance up to which all rays of a bundle are above the ground; 0 where none can be guaranteed.

    A block is skipped where the box stays above its maximum. Otherwise the box advances to that maximum, and smaller
    blocks are tested, down to the width of the box. In a cell the surface below the box's path is tested.

    Args:
        origin, direction: (3n,) rays, as x, y, z of one after another.
        grid: the ground.
    """
    (x, x_far), (y, y_far), (z, _) = _bounds(origin)
    (dx, dx_far), (dy, dy_far), (dz, _) = _bounds(direction)
    if not -np.inf < dz < 0.0:
        return 0.0
    constants, levels = grid.constants, grid.levels
    east, north = constants.cells_per_m_east, constants.cells_per_m_north
    (u, v), (u_far, v_far) = in_cells(constants, x, y), in_cells(constants, x_far, y_far)
    u, u_far, v, v_far = u - _MARGIN_CELLS, u_far + _MARGIN_CELLS, v - _MARGIN_CELLS, v_far + _MARGIN_CELLS
    du, du_far, dv, dv_far = dx * east, dx_far * east, dy * north, dy_far * north
    t: float = max((constants.ceiling_m + _MARGIN_M - z) / dz, 0.0)
    t_end: float = (constants.floor_m - z) / dz
    rows, columns, top_level = grid.nodes.shape[0] - 1, grid.nodes.shape[1] - 1, levels.shape[0] - 1
    width = max(u_far - u + t_end * (du_far - du), v_far - v + t_end * (dv_far - dv))
    if not width < 1 << top_level:
        return 0.0
    least_level = 0
    while (1 << least_level) < width:
        least_level += 1
    rate = max(-du, du_far, -dv, dv_far)
    level = max(starting_level(rate * (t_end - t), top_level), least_level)
    while t < t_end:
        west, south = u + t * du - _MARGIN_CELLS, v + t * dv - _MARGIN_CELLS
        east, north = u_far + t * du_far + _MARGIN_CELLS, v_far + t * dv_far + _MARGIN_CELLS
        if not (west >= 0.0 and south >= 0.0 and east < columns and north < rows):
            return t
        i_first, i_last = int(west) >> level, int(east) >> level
        j_first, j_last = int(south) >> level, int(north) >> level
        t_exit = min(
            _leaving(u, u_far, du, du_far, i_first << level, (i_last + 1) << level),
            _leaving(v, v_far, dv, dv_far, j_first << level, (j_last + 1) << level),
            t_end,
        )
        if level > 0:
            highest = _highest_block(grid.maxima, levels[level], (i_first, i_last), (j_first, j_last))
        else:
            west, south = min(west, u + t_exit * du), min(south, v + t_exit * dv)
            east, north = max(east, u_far + t_exit * du_far), max(north, v_far + t_exit * dv_far)
            highest = _highest_within(grid, (i_first, i_last), (j_first, j_last), (west, south, east, north))
            if highest != highest:
                return t
        highest += _MARGIN_M
        if z + t_exit * dz > highest:
            t, level = t_exit, min(level + 1, top_level)
            continue
        t = min(max(t, (highest - z) / dz), t_exit)
        if level == least_level:
            return t
        level -= 1
    return t


@kernel
def _bounds(vectors: FloatArray) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """Minimum and maximum of each component of vectors (3n,), ignoring NaN."""
    x, y, z = np.inf, np.inf, np.inf
    x_far, y_far, z_far = -np.inf, -np.inf, -np.inf
    for k in range(vectors.size // 3):
        a, b, c = vectors[3 * k], vectors[3 * k + 1], vectors[3 * k + 2]
        x, x_far = (a if a < x else x), (a if a > x_far else x_far)
        y, y_far = (b if b < y else y), (b if b > y_far else y_far)
        z, z_far = (c if c < z else z), (c if c > z_far else z_far)
    return (x, x_far), (y, y_far), (z, z_far)


@kernel
def _leaving(near: float, far: float, near_rate: float, far_rate: float, first: int, end: int) -> float:
    """Parameter t at which a moving, widening interval leaves the cells first ... end-1."""
    t = np.inf
    if far_rate > 0.0:
        t = (end - far) / far_rate
    if near_rate < 0.0:
        t = min(t, (first - near) / near_rate)
    return t


@kernel
def _highest_block(
    maxima: FloatArray, level: IntArray, columns: tuple[int, int], rows: tuple[int, int]
) -> float:
    """Greatest height of the blocks of a level between the first and the last column and row."""
    highest = -np.inf
    for j in range(rows[0], rows[1] + 1):
        for i in range(columns[0], columns[1] + 1):
            highest = max(highest, maxima[level[0] + j * level[1] + i])
    return highest


@kernel
def _highest_within(
    grid: Grid, columns: tuple[int, int], rows: tuple[int, int], box: tuple[float, float, float, float]
) -> float:
    """Greatest height of the cells within a box (west, south, east, north); NaN where a sample is missing.

    A facet, bilinear or plane, is highest in a corner of the box.
    """
    west, south, east, north = box
    interpolation = grid.constants.interpolation
    highest = -np.inf
    for j in range(rows[0], rows[1] + 1):
        for i in range(columns[0], columns[1] + 1):
            a_first, a_last = max(west - i, 0.0), min(east - i, 1.0)
            b_first, b_last = max(south - j, 0.0), min(north - j, 1.0)
            for southeast in (False, True):
                if interpolation == BILINEAR:
                    needed = southeast  # Both triangles have the same corner there.
                else:
                    needed = a_last >= b_first if southeast else a_first <= b_last
                if not needed:
                    continue
                corner, eastward, northward, twist = facet(
                    corners(grid.nodes, i, j), interpolation, southeast
                )
                for a in (a_first, a_last):
                    for b in (b_first, b_last):
                        height = corner + a * eastward + b * northward + a * b * twist
                        if not height <= highest:
                            highest = height
                        if highest != highest:
                            return highest
    return highest


_HALF_CELL = 0.5 + 1e-9
"""Tolerance at a cell's edge, where rounding may place a ray slightly outside both cells."""


@kernel
def cast_onto_cell(
    origin: FloatArray,
    direction: FloatArray,
    constants: GridConstants,
    i: int,
    j: int,
    samples: Corners,
    range_m: FloatArray,
    normal: FloatArray,
) -> int:
    """Advance rays by one facet: the rays whose path so far ends over cell (i, j).

    Returns the number of rays that have not hit yet.

    The loop has no branches, so that the compiler vectorises it. It computes the same expressions as `traverse` in the
    same order, with the same bits.

    Args:
        origin, direction: (3n,) rays, as x, y, z of one after another.
        constants: constants of the grid.
        samples: samples of the cell.
        range_m: (n,) negative: the ray is clear of all ground up to -range_m. Set to the range of rays that hit the
            facet, and to minus the clear distance of those that do not.
        normal: (3n,) normals of the rays that hit it.
    """
    east_scale, north_scale = constants.cells_per_m_east, constants.cells_per_m_north
    floor, interpolation = constants.floor_m, constants.interpolation
    west, south = float(i), float(j)  # In the loop they would be converted number by number.
    left = 0
    for k in range(range_m.size):
        u, v = in_cells(constants, origin[3 * k], origin[3 * k + 1])
        du, dv = direction[3 * k] * east_scale, direction[3 * k + 1] * north_scale
        z, dz = origin[3 * k + 2], direction[3 * k + 2]
        before = normal[3 * k], normal[3 * k + 1], normal[3 * k + 2]
        t_from, x, y = -range_m[k], u - west, v - south
        a, b = x + t_from * du, y + t_from * dv
        over = (t_from > 0.0) & (abs(a - 0.5) <= _HALF_CELL) & (abs(b - 0.5) <= _HALF_CELL)
        t_u = ((west + 1.0 if du > 0.0 else west) - u) / du
        t_v = ((south + 1.0 if dv > 0.0 else south) - v) / dv
        t_exit = (floor - z) / dz
        t_exit = t_u if (du != 0.0) & (t_u < t_exit) else t_exit
        t_exit = t_v if (dv != 0.0) & (t_v < t_exit) else t_exit
        southeast = x >= y
        if interpolation == TRIANGLES:
            t_diagonal = (y - x) / (du - dv)
            southeast = (t_from < t_diagonal) == (du < dv) if du != dv else southeast
            t_exit = t_diagonal if (t_from < t_diagonal) & (t_diagonal < t_exit) else t_exit
        plane = facet(samples, interpolation, southeast)
        a, b = x + t_exit * du, y + t_exit * dv
        s = descent(plane, (a, b, z + t_exit * dz), (du, dv, dz), t_exit - t_from)
        t = t_exit + s
        goes = over & (t_exit > t_from) & (plane[3] == plane[3])
        meets = goes & (s == s)
        a, b = x + t * du, y + t * dv
        _, east, north, twist = facet(samples, interpolation, a >= b)
        east, north = (east + b * twist) * east_scale, (north + a * twist) * north_scale
        up = 1.0 / np.sqrt(1.0 + east * east + north * north)
        range_m[k] = t if meets else -(t_exit if goes else t_from)
        normal[3 * k] = -east * up if meets else before[0]
        normal[3 * k + 1] = -north * up if meets else before[1]
        normal[3 * k + 2] = up if meets else before[2]
        left += not range_m[k] > 0.0
    return left
