"""Casting of rays onto an elevation grid and the ground beyond it, in order along each ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import Vector, vector_at
from lidar_emu.scene.grid.bundle import clear_way_m
from lidar_emu.scene.grid.bundle_cell import cast_onto_cell
from lidar_emu.scene.grid.cell import cell_of, corners, slopes, surface
from lidar_emu.scene.grid.structures import (
    NO_GROUND,
    PLANE,
    SPHERE,
    CellRay,
    Grid,
    GridConstants,
    Interval,
    in_cells,
)
from lidar_emu.scene.grid.traverse import BEYOND, CLEAR, FACE, SURFACE, clip, meet_beyond, traverse
from lidar_emu.scene.plane import plane_stretch
from lidar_emu.scene.ray_hits import GROUND, NOTHING
from lidar_emu.scene.sphere import sphere_stretch

_MOST_PASSES = 6
"""Maximum number of facets tried for a bundle: more than join at a vertex, and fewer than would take longer than single
rays."""
_AHEAD_CELLS = 1e-9
"""Distance beyond an edge at which a ray is in the next cell, whatever the rounding."""

MISS = (np.nan, np.nan, np.nan, np.nan, False)
INSIDE = (np.nan, np.nan, np.nan, np.nan, True)


@kernel(forceinline=True)
def _stretch_beyond(constants: GridConstants, start: Vector, way: Vector) -> Interval:
    if constants.beyond == PLANE:
        return plane_stretch(start[2], way[2])
    if constants.beyond == SPHERE:
        return sphere_stretch(*start, *way, constants.beyond_radius_m)
    return np.inf, -np.inf


@kernel(forceinline=True)
def _cast_one(
    start: Vector, way: Vector, grid: Grid, t_clear: float
) -> tuple[float, float, float, float, bool]:
    """Range and normal of the first hit, and whether the ray starts inside."""
    constants, nodes = grid.constants, grid.nodes
    (x, y, z), (dx, dy, dz) = start, way
    if not (np.isfinite(x + y + z) and 0.0 < dx * dx + dy * dy + dz * dz < np.inf):
        return MISS
    u, v = in_cells(constants, x, y)
    du, dv = dx * constants.cells_per_m_east, dy * constants.cells_per_m_north
    in_beyond = _stretch_beyond(constants, start, way)
    u_in, u_out = clip(u, du, nodes.shape[1] - 1)
    v_in, v_out = clip(v, dv, nodes.shape[0] - 1)
    t_in, t_out = max(u_in, v_in, 0.0), min(u_out, v_out)
    over_grid = t_in <= t_out

    if z <= constants.ceiling_m:
        ground = surface(nodes, constants.interpolation, u, v) if over_grid and t_in == 0.0 else np.nan
        if z < ground or (ground != ground and in_beyond[0] < 0.0 < in_beyond[1]):
            return INSIDE

    met, t, i, j, face = CLEAR, np.nan, 0, 0, 0
    if not over_grid or t_in > 0.0:
        met, t = meet_beyond(0.0, t_in if over_grid else np.inf, in_beyond)
    if met == CLEAR and over_grid:
        t_first, t_last = max(t_in, t_clear), t_out
        if dz < 0.0:
            t_first = max(t_first, (constants.ceiling_m - z) / dz)
            t_last = min(t_out, (constants.floor_m - z) / dz)
        elif dz > 0.0:
            t_last = min(t_out, (constants.ceiling_m - z) / dz)
        elif z > constants.ceiling_m:
            t_last = -np.inf
        if t_first <= t_last:
            face = 0 if u_in >= v_in else 1
            ray = CellRay(u, v, z, du, dv, dz)
            met, t, i, j, face = traverse(grid, ray, t_first, t_last, t_clear > 0.0, face, in_beyond)
        if met == CLEAR:
            face = 0 if u_out <= v_out else 1
            met, t = meet_beyond(t_out, np.inf, in_beyond)

    if met == SURFACE:
        rise_u, rise_v = slopes(nodes, constants.interpolation, i, j, (u - i) + t * du, (v - j) + t * dv)
        east, north = rise_u * constants.cells_per_m_east, rise_v * constants.cells_per_m_north
        up = 1.0 / np.sqrt(1.0 + east * east + north * north)
        return t, -east * up, -north * up, up, False
    if met == BEYOND and constants.beyond == PLANE:
        return t, 0.0, 0.0, 1.0, False
    if met == BEYOND:
        radius = constants.beyond_radius_m
        return t, (x + t * dx) / radius, (y + t * dy) / radius, 1.0 + (z + t * dz) / radius, False
    # Without ground beyond, the hit on a face belongs to no surface: it counts as no hit.
    if met == FACE and constants.beyond != NO_GROUND:
        return (t, -np.sign(dx), 0.0, 0.0, False) if face == 0 else (t, 0.0, -np.sign(dy), 0.0, False)
    return MISS


@kernel(outermost=True)
def cast_rays(
    origin: FloatArray,
    direction: FloatArray,
    bundle: int,
    constants: NDArray[np.void],
    nodes: FloatArray,
    maxima: FloatArray,
    levels: IntArray,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    object_id: NDArray[np.int16],
) -> None:
    """Fill the arrays of `Hits` for n rays in the site frame.

    Args:
        origin, direction: (n, 3) rays.
        bundle: number of consecutive rays that are expected to be close together.
        constants: (1,) the record of `GridConstants`.
        nodes, maxima, levels: see `Grid`.
        range_m, normal, inside, reflectance, object_id: see `Hits`.
    """
    grid = Grid(constants[0], nodes, maxima, levels)
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
            range_m[first:end],
            flat_normal[3 * first : 3 * end],
            inside[first:end],
        )
    albedo = constants[0].albedo
    for k in range(range_m.size):
        hit = range_m[k] >= 0.0
        reflectance[k] = albedo if hit else np.nan
        object_id[k] = GROUND if hit else NOTHING


@kernel
def _cast_bundle(
    origin: FloatArray,
    direction: FloatArray,
    close: bool,
    grid: Grid,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
) -> None:
    """Fill range_m (n,), normal (3n,) and inside (n,) for n rays, (3n,) each.

    Close rays advance along the clear part of their path together, and then over one cell after another. Remaining
    rays, at the edges of cells, are cast one by one.
    """
    constants, nodes = grid.constants, grid.nodes
    clear_m = clear_way_m(origin, direction, grid) if close else 0.0
    inside[:] = False
    range_m[:] = -clear_m
    passes = 0
    for k in range(range_m.size):
        x, y, z = vector_at(origin, 3 * k)
        dx, dy, dz = vector_at(direction, 3 * k)
        while range_m[k] < 0.0 and passes < _MOST_PASSES:
            so_far_m = -range_m[k]
            u, v = in_cells(constants, x + so_far_m * dx, y + so_far_m * dy)
            i = cell_of(u + np.copysign(_AHEAD_CELLS, dx), nodes.shape[1] - 1)
            j = cell_of(v + np.copysign(_AHEAD_CELLS, dy), nodes.shape[0] - 1)
            cast_onto_cell(
                origin[3 * k :],
                direction[3 * k :],
                constants,
                i,
                j,
                corners(nodes, i, j),
                range_m[k:],
                normal[3 * k :],
            )
            passes += 1
            if -range_m[k] == so_far_m:
                break
        if not range_m[k] > 0.0:
            range_m[k], normal[3 * k], normal[3 * k + 1], normal[3 * k + 2], inside[k] = _cast_one(
                (x, y, z), (dx, dy, dz), grid, clear_m
            )


@kernel(outermost=True)
def surface_heights(
    constants: NDArray[np.void], nodes: FloatArray, east: FloatArray, north: FloatArray, height: FloatArray
) -> None:
    """Fill height (n,) of the grid's surface; NaN outside it and where samples are missing."""
    for k in range(east.shape[0]):
        height[k] = np.nan
        u, v = in_cells(constants[0], east[k], north[k])
        if 0.0 <= u <= nodes.shape[1] - 1 and 0.0 <= v <= nodes.shape[0] - 1:
            height[k] = surface(nodes, constants[0].interpolation, u, v)
