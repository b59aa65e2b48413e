"""Rays onto an elevation grid and the ground beyond it, in the order along each ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.grid.bundle import clear_way_m
from lidar_emu.scene.grid.bundle_cell import cast_onto_cell
from lidar_emu.scene.grid.cell import cell_of, corners, slopes, surface
from lidar_emu.scene.grid.numbers import (
    CEILING_M,
    CELLS_PER_M_EAST,
    CELLS_PER_M_NORTH,
    FLOOR_M,
    RADIUS_M,
    in_cells,
)
from lidar_emu.scene.grid.traverse import BEYOND, CLEAR, FACE, SURFACE, clip, meet_beyond, traverse
from lidar_emu.scene.hits import GROUND
from lidar_emu.scene.hits import NOTHING as NO_THING
from lidar_emu.scene.plane import plane_stretch
from lidar_emu.scene.sphere import sphere_stretch

NOTHING, PLANE, SPHERE = 0, 1, 2
"""What lies beyond the grid."""

_MOST_PASSES = 6
"""Facets tried for a bundle: more than meet at a vertex, fewer than take longer than the rays one by one."""
_AHEAD_CELLS = 1e-9
"""So far beyond an edge a ray is in the cell that it enters there, whatever the rounding."""

MISS = (np.nan, np.nan, np.nan, np.nan, False)
INSIDE = (np.nan, np.nan, np.nan, np.nan, True)


@kernel(forceinline=True)
def _stretch_beyond(
    beyond: int, x: float, y: float, z: float, dx: float, dy: float, dz: float, radius: float
) -> tuple[float, float]:
    """Where the ray's line is in the ground beyond the grid."""
    if beyond == PLANE:
        return plane_stretch(z, dz)
    if beyond == SPHERE:
        return sphere_stretch(x, y, z, dx, dy, dz, radius)
    return np.inf, -np.inf


@kernel(forceinline=True)
def _cast_one(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    grid: FloatArray,
    nodes: FloatArray,
    interpolation: int,
    maxima: FloatArray,
    levels: IntArray,
    beyond: int,
    t_clear: float,
) -> tuple[float, float, float, float, bool]:
    """Range, normal and whether the ray starts inside."""
    if not (np.isfinite(x + y + z) and 0.0 < dx * dx + dy * dy + dz * dz < np.inf):
        return MISS
    u, v = in_cells(grid, x, y)
    du, dv = dx * grid[CELLS_PER_M_EAST], dy * grid[CELLS_PER_M_NORTH]
    enter, leave = _stretch_beyond(beyond, x, y, z, dx, dy, dz, grid[RADIUS_M])
    u_in, u_out = clip(u, du, nodes.shape[1] - 1)
    v_in, v_out = clip(v, dv, nodes.shape[0] - 1)
    t_in, t_out = max(u_in, v_in, 0.0), min(u_out, v_out)
    over_grid = t_in <= t_out

    if z <= grid[CEILING_M]:
        ground = surface(nodes, interpolation, u, v) if over_grid and t_in == 0.0 else np.nan
        if z < ground or (ground != ground and enter < 0.0 < leave):
            return INSIDE

    met, t, i, j, face = CLEAR, np.nan, 0, 0, 0
    if not over_grid or t_in > 0.0:
        met, t = meet_beyond(0.0, t_in if over_grid else np.inf, enter, leave)
    if met == CLEAR and over_grid:
        t_first, t_last = max(t_in, t_clear), t_out
        if dz < 0.0:
            t_first = max(t_first, (grid[CEILING_M] - z) / dz)
            t_last = min(t_out, (grid[FLOOR_M] - z) / dz)
        elif dz > 0.0:
            t_last = min(t_out, (grid[CEILING_M] - z) / dz)
        elif z > grid[CEILING_M]:
            t_last = -np.inf
        if t_first <= t_last:
            face = 0 if u_in >= v_in else 1
            met, t, i, j, face = traverse(
                nodes,
                interpolation,
                maxima,
                levels,
                u,
                v,
                z,
                du,
                dv,
                dz,
                t_first,
                t_last,
                t_clear > 0.0,
                face,
                enter,
                leave,
            )
        if met == CLEAR:
            face = 0 if u_out <= v_out else 1
            met, t = meet_beyond(t_out, np.inf, enter, leave)

    if met == SURFACE:
        rise_u, rise_v = slopes(nodes, interpolation, i, j, (u - i) + t * du, (v - j) + t * dv)
        east, north = rise_u * grid[CELLS_PER_M_EAST], rise_v * grid[CELLS_PER_M_NORTH]
        up = 1.0 / np.sqrt(1.0 + east * east + north * north)
        return t, -east * up, -north * up, up, False
    if met == BEYOND and beyond == PLANE:
        return t, 0.0, 0.0, 1.0, False
    if met == BEYOND:
        radius = grid[RADIUS_M]
        return t, (x + t * dx) / radius, (y + t * dy) / radius, 1.0 + (z + t * dz) / radius, False
    # With nothing beyond there is no ground for a face to belong to: what the ray met there is unknown.
    if met == FACE and beyond != NOTHING:
        return (t, -np.sign(dx), 0.0, 0.0, False) if face == 0 else (t, 0.0, -np.sign(dy), 0.0, False)
    return MISS


@kernel(outermost=True)
def cast_rays(
    origin: FloatArray,
    direction: FloatArray,
    bundle: int,
    grid: FloatArray,
    nodes: FloatArray,
    interpolation: int,
    maxima: FloatArray,
    levels: IntArray,
    beyond: int,
    albedo: float,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    thing: NDArray[np.int16],
) -> None:
    """Fill the arrays of `Hits` for n rays in the site frame.

    Args:
        origin, direction: (n, 3) the rays.
        bundle: that many consecutive rays are expected to be close together.
        grid: numbers of the grid, see `numbers`.
        nodes: (rows, columns) heights of the samples.
        interpolation: what spans a cell, see `cell`.
        maxima, levels: pyramid over the samples, see `build_pyramid`.
        beyond, albedo: what lies beyond the grid, and what share of the light all of the ground reflects.
        range_m, normal, inside, reflectance, thing: of `Hits`.
    """
    flat_origin, flat_direction, flat_normal = (
        origin.reshape(origin.size),
        direction.reshape(direction.size),
        normal.reshape(normal.size),
    )
    size = bundle if bundle > 1 else max(range_m.size, 1)
    for first in range(0, range_m.size, size):
        end = min(first + size, range_m.size)
        _cast_bundle(
            flat_origin[3 * first : 3 * end],
            flat_direction[3 * first : 3 * end],
            bundle > 1,
            grid,
            nodes,
            interpolation,
            maxima,
            levels,
            beyond,
            range_m[first:end],
            flat_normal[3 * first : 3 * end],
            inside[first:end],
        )
    for k in range(range_m.size):
        hit = range_m[k] >= 0.0
        reflectance[k] = albedo if hit else np.nan
        thing[k] = GROUND if hit else NO_THING


@kernel
def _cast_bundle(
    origin: FloatArray,
    direction: FloatArray,
    close: bool,
    grid: FloatArray,
    nodes: FloatArray,
    interpolation: int,
    maxima: FloatArray,
    levels: IntArray,
    beyond: int,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
) -> None:
    """Fill range_m (n,), normal (3n,) and inside (n,) for n rays, (3n,) each.

    Rays close together go the clear part of their way as one, and then onto one cell after another all at once. What
    is left, at the edges of cells, goes ray by ray.
    """
    clear_m = 0.0
    if close:
        clear_m = clear_way_m(origin, direction, grid, nodes, interpolation, maxima, levels)
    inside[:] = False
    range_m[:] = -clear_m
    passes = 0
    for k in range(range_m.size):
        x, y, z = origin[3 * k], origin[3 * k + 1], origin[3 * k + 2]
        dx, dy, dz = direction[3 * k], direction[3 * k + 1], direction[3 * k + 2]
        while range_m[k] < 0.0 and passes < _MOST_PASSES:
            so_far_m = -range_m[k]
            u, v = in_cells(grid, x + so_far_m * dx, y + so_far_m * dy)
            i = cell_of(u + np.copysign(_AHEAD_CELLS, dx), nodes.shape[1] - 1)
            j = cell_of(v + np.copysign(_AHEAD_CELLS, dy), nodes.shape[0] - 1)
            rays = origin[3 * k :], direction[3 * k :]
            cast_onto_cell(
                *rays, grid, interpolation, i, j, corners(nodes, i, j), range_m[k:], normal[3 * k :]
            )
            passes += 1
            if -range_m[k] == so_far_m:
                break
        if not range_m[k] > 0.0:
            range_m[k], normal[3 * k], normal[3 * k + 1], normal[3 * k + 2], inside[k] = _cast_one(
                x, y, z, dx, dy, dz, grid, nodes, interpolation, maxima, levels, beyond, clear_m
            )


@kernel(outermost=True)
def surface_heights(
    grid: FloatArray,
    nodes: FloatArray,
    interpolation: int,
    east: FloatArray,
    north: FloatArray,
    height: FloatArray,
) -> None:
    """Fill height (n,) of the grid's surface; NaN outside it and where samples are missing."""
    for k in range(east.shape[0]):
        height[k] = np.nan
        u, v = in_cells(grid, east[k], north[k])
        if 0.0 <= u <= nodes.shape[1] - 1 and 0.0 <= v <= nodes.shape[0] - 1:
            height[k] = surface(nodes, interpolation, u, v)
