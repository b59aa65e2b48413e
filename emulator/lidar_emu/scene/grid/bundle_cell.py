"""Casting of a bundle onto one cell at once: most beamlets of a beam hit the same facet as its axis."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.grid.cell import Corners, descent, facet
from lidar_emu.scene.grid.structures import TRIANGLES, GridConstants, in_cells

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
) -> None:
    """Advance rays by one facet: the rays whose path so far ends over cell (i, j).

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
    for k in range(range_m.size):
        u, v = in_cells(constants, origin[3 * k], origin[3 * k + 1])
        du, dv = direction[3 * k] * east_scale, direction[3 * k + 1] * north_scale
        z, dz = origin[3 * k + 2], direction[3 * k + 2]
        before = normal[3 * k], normal[3 * k + 1], normal[3 * k + 2]
        t_from = -range_m[k]
        a, b = (u - i) + t_from * du, (v - j) + t_from * dv
        over = (t_from > 0.0) & (abs(a - 0.5) <= _HALF_CELL) & (abs(b - 0.5) <= _HALF_CELL)
        t_u = ((i + 1 if du > 0.0 else i) - u) / du
        t_v = ((j + 1 if dv > 0.0 else j) - v) / dv
        t_exit = (floor - z) / dz
        t_exit = t_u if (du != 0.0) & (t_u < t_exit) else t_exit
        t_exit = t_v if (dv != 0.0) & (t_v < t_exit) else t_exit
        southeast = u - i >= v - j
        if interpolation == TRIANGLES:
            t_diagonal = ((v - j) - (u - i)) / (du - dv)
            southeast = (t_from < t_diagonal) == (du < dv) if du != dv else southeast
            t_exit = t_diagonal if (t_from < t_diagonal) & (t_diagonal < t_exit) else t_exit
        plane = facet(samples, interpolation, southeast)
        a, b = (u - i) + t_exit * du, (v - j) + t_exit * dv
        s = descent(plane, (a, b, z + t_exit * dz), (du, dv, dz), t_exit - t_from)
        t = t_exit + s
        goes = over & (t_exit > t_from) & (plane[3] == plane[3])
        meets = goes & (s == s)
        a, b = (u - i) + t * du, (v - j) + t * dv
        _, east, north, twist = facet(samples, interpolation, a >= b)
        east, north = (east + b * twist) * east_scale, (north + a * twist) * north_scale
        up = 1.0 / np.sqrt(1.0 + east * east + north * north)
        range_m[k] = t if meets else (-t_exit if goes else range_m[k])
        normal[3 * k] = -east * up if meets else before[0]
        normal[3 * k + 1] = -north * up if meets else before[1]
        normal[3 * k + 2] = up if meets else before[2]
