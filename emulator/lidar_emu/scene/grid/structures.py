"""Structures that the kernels of an elevation grid share."""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel

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


@kernel(forceinline=True)
def in_cells(constants: GridConstants, x: float, y: float) -> tuple[float, float]:
    """Position in cells from the first sample held.

    The subtraction of whole cells is exact unless the position is far away, so that a part of a grid gives the bits of
    the whole.
    """
    u = (x - constants.west_m) * constants.cells_per_m_east
    v = (y - constants.south_m) * constants.cells_per_m_north
    return u - constants.first_column, v - constants.first_row
