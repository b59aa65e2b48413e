"""What kernels know of a grid besides its samples, in one array: the place of each number in it."""

from __future__ import annotations

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

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
    COUNT,
) = range(10)
"""The whole grid's south-west sample, its scale, bounds of its heights and of those of what fills its holes, the radius
of the sphere beyond, and which of its samples is the first that is here."""


@kernel(forceinline=True)
def in_cells(grid: FloatArray, x: float, y: float) -> tuple[float, float]:
    """A place in cells from the first sample that is here.

    The subtraction of whole cells is exact unless the place is far off: a part of a grid has the bits of the whole.
    """
    u, v = (x - grid[WEST_M]) * grid[CELLS_PER_M_EAST], (y - grid[SOUTH_M]) * grid[CELLS_PER_M_NORTH]
    return u - grid[FIRST_COLUMN], v - grid[FIRST_ROW]
