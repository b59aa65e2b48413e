"""An elevation grid: the surface through its samples, and the ground beyond it."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray, as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import Vector, vector_at
from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround, plane_stretch, sphere_stretch
from lidar_emu.scene.grid.bundle import cast_onto_cell, clear_way_m
from lidar_emu.scene.grid.cell import (
    BILINEAR,
    NO_GROUND,
    PLANE,
    SPHERE,
    TRIANGLES,
    CellRay,
    Grid,
    GridConstants,
    Interval,
    Samples,
    cell_of,
    corners,
    in_cells,
    slopes,
    surface,
)
from lidar_emu.scene.grid.traverse import (
    BEYOND,
    CLEAR,
    FACE,
    SURFACE,
    build_pyramid,
    clip,
    meet_beyond,
    traverse,
)
from lidar_emu.scene.ray_hits import GROUND, NOTHING, Hits, RayCaster, contiguous


class GridGround(RayCaster):
    """An elevation grid over the site's horizontal plane; its heights include the curvature of the body.

    A cell is the bilinear surface between four samples, or two triangles; a cell with a missing sample counts as beyond
    the grid. Where the edge of the grid is higher or lower than the ground beyond it, a vertical face joins the two.
    Without ground beyond, a ray that reaches such an edge from below the surface hits nothing.

    Args:
        samples: heights in the site frame.
        beyond: ground around the grid and in its holes, through the origin; None if there is none.
        description: one line for plans.
        origin_altitude_m: height of the origin above the body's sphere.
        reflectance: albedo, also of the ground beyond.
    """

    by_kernels = True

    def __init__(
        self,
        samples: Samples,
        beyond: PlaneGround | SphereGround | None,
        description: str,
        origin_altitude_m: float,
        reflectance: float = 1.0,
    ) -> None:
        self.samples = samples
        self.reflectance = reflectance
        self.beyond = beyond
        self.description = description
        self.origin_altitude_m = origin_altitude_m
        # The ground beyond, a level plane or a sphere, is nowhere higher than the origin.
        hole_m = -np.inf if beyond is None else 0.0
        self._maxima, self._levels = build_pyramid(samples.height_m, hole_m)
        self._constants = self._record()

    def with_reflectance(self, reflectance: float) -> GridGround:
        """The same ground with another albedo; samples are shared."""
        twin = copy(self)
        twin.reflectance = reflectance
        twin._constants = twin._record()
        return twin

    def _record(self) -> Any:
        samples = self.samples
        lowest_m, highest_m = samples.bounds_with(self.beyond)
        around = PLANE if isinstance(self.beyond, PlaneGround) else SPHERE
        return as_record(
            GridConstants(
                west_m=float(samples.west_m),
                south_m=float(samples.south_m),
                cells_per_m_east=1 / samples.pixel_east_m,
                cells_per_m_north=1 / samples.pixel_north_m,
                ceiling_m=float(highest_m),
                floor_m=lowest_m - 1.0,
                first_column=float(samples.first_column),
                first_row=float(samples.first_row),
                interpolation=TRIANGLES if samples.interpolation == "triangles" else BILINEAR,
                beyond=NO_GROUND if self.beyond is None else around,
                beyond_radius_m=self.beyond.radius_m if isinstance(self.beyond, SphereGround) else np.inf,
                albedo=float(self.reflectance),
            )
        )

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, bundle: int) -> None:
        heights_m, maxima, levels = self.samples.height_m, self._maxima, self._levels
        static = hits.on_static_ground
        cast_rays(origin, direction, bundle, self._constants, heights_m, maxima, levels, *static)

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        east, north = contiguous(east_m, north_m)
        height = np.empty_like(east)
        surface_heights(self._constants, self.samples.height_m, east, north, height)
        if self.beyond is None:
            return height
        return np.where(np.isnan(height), self.beyond.height_m(east, north), height)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """True over the grid, holes included, and wherever there is ground beyond it."""
        if self.beyond is not None:
            return self.beyond.covers(east_m, north_m)
        east, north = self.samples.east_m, self.samples.north_m
        return np.asarray(
            (east[0] <= east_m) & (east_m <= east[-1]) & (north[0] <= north_m) & (north_m <= north[-1])
        )


_MOST_PASSES = 6
"""Maximum number of facets tried for a bundle: more than join at a vertex, and fewer than would take longer than single
rays."""
_AHEAD_CELLS = 1e-9
"""Distance beyond an edge at which a ray is in the next cell, whatever the rounding."""

MISS = (np.nan, np.nan, np.nan, np.nan, False)
INSIDE = (np.nan, np.nan, np.nan, np.nan, True)


@kernel
def _stretch_beyond(constants: GridConstants, start: Vector, way: Vector) -> Interval:
    if constants.beyond == PLANE:
        return plane_stretch(start[2], way[2])
    if constants.beyond == SPHERE:
        return sphere_stretch(*start, *way, constants.beyond_radius_m)
    return np.inf, -np.inf


@kernel
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
            passes += 1
            before_m = range_m[k]
            u, v = in_cells(constants, x - before_m * dx, y - before_m * dy)
            i = cell_of(u + np.copysign(_AHEAD_CELLS, dx), nodes.shape[1] - 1)
            j = cell_of(v + np.copysign(_AHEAD_CELLS, dy), nodes.shape[0] - 1)
            starts, ways, normals = origin[3 * k :], direction[3 * k :], normal[3 * k :]
            left = cast_onto_cell(starts, ways, constants, i, j, corners(nodes, i, j), range_m[k:], normals)
            if left == 0:
                return
            if range_m[k] == before_m:  # No facet is there, nor for most of the others.
                passes = _MOST_PASSES
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
