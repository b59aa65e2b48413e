"""Rays onto an elevation grid and the ground beyond it, in the order along each ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.kernels import kernel
from lidar_emu.scene.cell import slopes, surface
from lidar_emu.scene.hits import GROUND
from lidar_emu.scene.hits import NOTHING as NO_THING
from lidar_emu.scene.plane import plane_stretch
from lidar_emu.scene.sphere import sphere_stretch
from lidar_emu.scene.traverse import BEYOND, CLEAR, FACE, SURFACE, clip, meet_beyond, traverse

NOTHING, PLANE, SPHERE = 0, 1, 2
"""What lies beyond the grid."""

(
    WEST_M,
    SOUTH_M,
    CELLS_PER_M_EAST,
    CELLS_PER_M_NORTH,
    CEILING_M,
    FLOOR_M,
    RADIUS_M,
    FIRST_COLUMN,
    FIRST_ROW,
) = range(9)
"""Places in the array of a grid's numbers: its south-west sample, its scale, bounds of its heights and of
those of what fills its holes, the radius of the sphere beyond, and the first of its samples that are here."""

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
def _grid_coordinates(grid: FloatArray, x: float, y: float) -> tuple[float, float]:
    """A place in cells from the first sample. The subtraction of whole cells is exact, unless the place is far off:
    a part of a grid has the bits of the whole."""
    u, v = (x - grid[WEST_M]) * grid[CELLS_PER_M_EAST], (y - grid[SOUTH_M]) * grid[CELLS_PER_M_NORTH]
    return u - grid[FIRST_COLUMN], v - grid[FIRST_ROW]


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
    maxima: FloatArray,
    levels: IntArray,
    beyond: int,
) -> tuple[float, float, float, float, bool]:
    """Range, normal and whether the ray starts inside."""
    if not (np.isfinite(x + y + z) and 0.0 < dx * dx + dy * dy + dz * dz < np.inf):
        return MISS
    u, v = _grid_coordinates(grid, x, y)
    du, dv = dx * grid[CELLS_PER_M_EAST], dy * grid[CELLS_PER_M_NORTH]
    enter, leave = _stretch_beyond(beyond, x, y, z, dx, dy, dz, grid[RADIUS_M])
    u_in, u_out = clip(u, du, nodes.shape[1] - 1)
    v_in, v_out = clip(v, dv, nodes.shape[0] - 1)
    t_in, t_out = max(u_in, v_in, 0.0), min(u_out, v_out)
    over_grid = t_in <= t_out

    if z <= grid[CEILING_M]:
        ground = surface(nodes, u, v) if over_grid and t_in == 0.0 else np.nan
        if z < ground or (ground != ground and enter < 0.0 < leave):
            return INSIDE

    met, t, i, j, face = CLEAR, np.nan, 0, 0, 0
    if not over_grid or t_in > 0.0:
        met, t = meet_beyond(0.0, t_in if over_grid else np.inf, enter, leave)
    if met == CLEAR and over_grid:
        t_first, t_last = t_in, t_out
        if dz < 0.0:
            t_first = max(t_in, (grid[CEILING_M] - z) / dz)
            t_last = min(t_out, (grid[FLOOR_M] - z) / dz)
        elif dz > 0.0:
            t_last = min(t_out, (grid[CEILING_M] - z) / dz)
        elif z > grid[CEILING_M]:
            t_last = -np.inf
        if t_first <= t_last:
            face = 0 if u_in >= v_in else 1
            met, t, i, j, face = traverse(
                nodes, maxima, levels, u, v, z, du, dv, dz, t_first, t_last, face, enter, leave
            )
        if met == CLEAR:
            face = 0 if u_out <= v_out else 1
            met, t = meet_beyond(t_out, np.inf, enter, leave)

    if met == SURFACE:
        rise_u, rise_v = slopes(nodes, i, j, u + t * du, v + t * dv)
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
    grid: FloatArray,
    nodes: FloatArray,
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
    """Fill the arrays of `Hits` for n rays in the site frame."""
    for k in range(origin.shape[0]):
        range_m[k], normal[k, 0], normal[k, 1], normal[k, 2], inside[k] = _cast_one(
            origin[k, 0],
            origin[k, 1],
            origin[k, 2],
            direction[k, 0],
            direction[k, 1],
            direction[k, 2],
            grid,
            nodes,
            maxima,
            levels,
            beyond,
        )
        hit = range_m[k] == range_m[k]
        reflectance[k] = albedo if hit else np.nan
        thing[k] = GROUND if hit else NO_THING


@kernel(outermost=True)
def surface_heights(
    grid: FloatArray, nodes: FloatArray, east: FloatArray, north: FloatArray, height: FloatArray
) -> None:
    """Fill height (n,) of the grid's surface; NaN outside it and where samples are missing."""
    for k in range(east.shape[0]):
        height[k] = np.nan
        u, v = _grid_coordinates(grid, east[k], north[k])
        if 0.0 <= u <= nodes.shape[1] - 1 and 0.0 <= v <= nodes.shape[0] - 1:
            height[k] = surface(nodes, u, v)
