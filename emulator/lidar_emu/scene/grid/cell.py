"""The ground of a single cell: the surface between four samples, and a ray's first hit on it.

Grid coordinates u and v count cells to the east and to the north from the south-west sample. All functions are inlined
on purpose: as calls, these few operations would make a ray half as slow again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scenario.ground import Interpolation
from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround
from lidar_emu.scene.ray_reach import Rectangle

BILINEAR, TRIANGLES = 0, 1
"""Surface of a cell: one bilinear patch, or two triangles that share its diagonal from south-west to north-east."""

NO_GROUND, PLANE, SPHERE = 0, 1, 2
"""Ground beyond the grid."""


class GridConstants(NamedTuple):
    """Constants of a grid; kernels take them as a record."""

    west_m: float
    """East coordinate of the whole grid's first column."""
    south_m: float
    """North coordinate of the whole grid's first row."""
    cells_per_m_east: float
    cells_per_m_north: float
    ceiling_m: float
    """Highest of the grid and of the ground that fills its holes."""
    floor_m: float
    """A height below the whole grid and the ground that fills its holes."""
    first_column: float
    """Index in the whole grid of the first column held."""
    first_row: float
    """Index in the whole grid of the first row held."""
    interpolation: int
    """Interpolation: BILINEAR or TRIANGLES."""
    beyond: int
    """Ground beyond: NO_GROUND, PLANE or SPHERE."""
    beyond_radius_m: float
    """Radius of the sphere beyond."""
    albedo: float
    """Albedo of the whole ground."""


class Grid(NamedTuple):
    """A grid for kernels."""

    constants: GridConstants
    nodes: FloatArray
    """(rows, columns) Heights of the samples."""
    maxima: FloatArray
    """Maxima of blocks, see `build_pyramid`."""
    levels: IntArray
    """(levels, 2) Index at which each level of the maxima begins, and its blocks per row."""


class CellRay(NamedTuple):
    """A ray, horizontally in cells and vertically in metres; its parameter t is in metres along it."""

    u: float
    v: float
    z: float
    du: float
    dv: float
    dz: float


Interval = tuple[float, float]
"""First and last t of an interval of a ray."""


@kernel
def in_cells(constants: GridConstants, x: float, y: float) -> tuple[float, float]:
    """Position in cells from the first sample held.

    The subtraction of whole cells is exact unless the position is far away, so that a part of a grid gives the bits of
    the whole.
    """
    u = (x - constants.west_m) * constants.cells_per_m_east
    v = (y - constants.south_m) * constants.cells_per_m_north
    return u - constants.first_column, v - constants.first_row


Corners = tuple[float, float, float, float]
"""Heights of a cell's samples: south-west, south-east, north-west, north-east."""

Facet = tuple[float, float, float, float]
"""corner, east, north, twist: the height at (a, b), in the cell's own coordinates from 0 to 1, is ``corner + a east + b
north + a b twist``. The twist is NaN where one of the four samples is missing."""


Point = tuple[float, float, float]


@kernel
def cell_of(position: float, cells: int) -> int:
    """Index of the cell at a grid coordinate; the last cell includes its far edge."""
    return min(max(int(position), 0), cells - 1)


@kernel
def corners(nodes: FloatArray, i: int, j: int) -> Corners:
    """Heights of the samples of cell (i, j)."""
    return nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]


@kernel
def facet(samples: Corners, interpolation: int, southeast: bool) -> Facet:
    """The surface of a cell, or of its half on one side of the diagonal, continued beyond it."""
    z00, z10, z01, z11 = samples
    south, west, north, east = z10 - z00, z01 - z00, z11 - z01, z11 - z10
    twist = north - south
    if interpolation == BILINEAR:
        return z00, south, west, twist
    return (z00, south, east, 0.0 * twist) if southeast else (z00, north, west, 0.0 * twist)


@kernel
def surface(nodes: FloatArray, interpolation: int, u: float, v: float) -> float:
    """Height at a point of the grid; NaN where a corner of its cell is missing."""
    i = cell_of(u, nodes.shape[1] - 1)
    j = cell_of(v, nodes.shape[0] - 1)
    a, b = u - i, v - j
    corner, east, north, twist = facet(corners(nodes, i, j), interpolation, a >= b)
    height: float = corner + a * east + b * north + a * b * twist
    return height


@kernel
def slopes(nodes: FloatArray, interpolation: int, i: int, j: int, a: float, b: float) -> tuple[float, float]:
    """Slopes to the east and to the north, per cell, at the point (a, b) of cell (i, j)."""
    _, east, north, twist = facet(corners(nodes, i, j), interpolation, a >= b)
    return east + b * twist, north + a * twist


@kernel
def descent(plane: Facet, at: Point, rate: Point, before: float) -> float:
    """Parameter s in [-before, 0] at which a ray descends through a facet; NaN where it stays above it.

    Args:
        plane: the facet.
        at: (a, b, z) position of the ray at s = 0 in the cell's own coordinates, and its height.
        rate: derivatives of `at` with respect to s.
        before: length before s = 0 over which the ray is over the facet.
    """
    corner, east, north, twist = plane
    a, b, z = at
    du, dv, dz = rate
    # Its height above the facet is c0 + c1 s + c2 s².
    c0 = z - (corner + a * east + b * north + a * b * twist)
    c1 = dz - (east + b * twist) * du - (north + a * twist) * dv
    c2 = -twist * du * dv
    square = c1 * c1 - 4.0 * c2 * c0
    dips = (c1 > 0.0) & (c1 < 2.0 * c2 * before) & (square >= 0.0)
    # The root at which the height falls, without cancellation.
    twice = np.sqrt(max(square, 0.0)) + abs(c1)
    s = (2.0 * c0 if c1 < 0.0 else -twice) / (twice if c1 < 0.0 else 2.0 * c2)
    return max(s, -before) if (c0 <= 0.0) | dips else np.nan


@dataclass(frozen=True)
class Samples:
    """Samples of a grid in the site frame, or of a part of it, with at least four neighbouring samples. Coordinates of
    a part count from the whole grid's first sample: rays hit it with the same bits."""

    height_m: FloatArray
    """(rows, columns) site z, rows from south to north, columns from west to east; NaN where missing."""
    west_m: float
    """East coordinate of the whole grid's first column."""
    south_m: float
    """North coordinate of the whole grid's first row."""
    pixel_east_m: float
    """Distance between columns."""
    pixel_north_m: float
    """Distance between rows."""
    interpolation: Interpolation = "bilinear"
    """Surface of a cell, see `scenario.site.ElevationGrid`."""
    first_column: int = 0
    """Index in the whole grid of the first column held."""
    first_row: int = 0
    """Index in the whole grid of the first row held."""
    bounds_m: tuple[float, float] | None = None
    """Lowest and highest height of the whole grid and of the ground that fills its holes, where known; equal for all
    parts."""

    @property
    def east_m(self) -> FloatArray:
        """East coordinates (columns,)."""
        columns = np.arange(self.first_column, self.first_column + self.height_m.shape[1], dtype=np.float64)
        return self.west_m + self.pixel_east_m * columns

    @property
    def north_m(self) -> FloatArray:
        """North coordinates (rows,)."""
        rows = np.arange(self.first_row, self.first_row + self.height_m.shape[0], dtype=np.float64)
        return self.south_m + self.pixel_north_m * rows

    def within(self, area: Rectangle, margin: int) -> tuple[range, range]:
        """Rows and columns of a whole grid in an area, extended on each side by `margin` where the grid reaches."""
        rows, columns = self.height_m.shape
        return (
            _between(area.south_m, area.north_m, self.south_m, self.pixel_north_m, rows, margin),
            _between(area.west_m, area.east_m, self.west_m, self.pixel_east_m, columns, margin),
        )

    def bounds_with(self, beyond: PlaneGround | SphereGround | None) -> tuple[float, float]:
        """Lowest and highest height of the samples, and of the ground beyond where it fills holes."""
        if self.bounds_m is not None:
            return self.bounds_m
        lowest_m, highest_m = float(np.nanmin(self.height_m)), float(np.nanmax(self.height_m))
        if beyond is None:
            return lowest_m, highest_m
        radius_m = beyond.radius_m if isinstance(beyond, SphereGround) else np.inf
        # A sphere falls by less than the square of the distance divided by its radius.
        square_m2 = max(np.square(self.east_m)) + max(np.square(self.north_m))
        return min(lowest_m, -float(square_m2) / radius_m), max(highest_m, 0.0)


def _between(low_m: float, high_m: float, first_m: float, pixel_m: float, count: int, margin: int) -> range:
    first = min(max(math.floor((low_m - first_m) / pixel_m) - margin, 0), count - 2)
    end = min(max(math.ceil((high_m - first_m) / pixel_m) + margin + 1, first + 2), count)
    return range(first, end)
