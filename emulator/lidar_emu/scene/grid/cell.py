"""The ground of a single cell: the surface between four samples, and a ray's first hit on it.

Grid coordinates u and v count cells to the east and to the north from the south-west sample. All functions are inlined
on purpose: as calls, these few operations would make a ray half as slow again.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.grid.structures import BILINEAR

Corners = tuple[float, float, float, float]
"""Heights of a cell's samples: south-west, south-east, north-west, north-east."""

Facet = tuple[float, float, float, float]
"""corner, east, north, twist: the height at (a, b), in the cell's own coordinates from 0 to 1, is ``corner + a east + b
north + a b twist``. The twist is NaN where one of the four samples is missing."""


Point = tuple[float, float, float]


@kernel(forceinline=True)
def cell_of(position: float, cells: int) -> int:
    """Index of the cell at a grid coordinate; the last cell includes its far edge."""
    return min(max(int(position), 0), cells - 1)


@kernel(forceinline=True)
def corners(nodes: FloatArray, i: int, j: int) -> Corners:
    """Heights of the samples of cell (i, j)."""
    return nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]


@kernel(forceinline=True)
def facet(samples: Corners, interpolation: int, southeast: bool) -> Facet:
    """The surface of a cell, or of its half on one side of the diagonal, continued beyond it."""
    z00, z10, z01, z11 = samples
    south, west, north, east = z10 - z00, z01 - z00, z11 - z01, z11 - z10
    twist = north - south
    if interpolation == BILINEAR:
        return z00, south, west, twist
    return (z00, south, east, 0.0 * twist) if southeast else (z00, north, west, 0.0 * twist)


@kernel(forceinline=True)
def surface(nodes: FloatArray, interpolation: int, u: float, v: float) -> float:
    """Height at a point of the grid; NaN where a corner of its cell is missing."""
    i = cell_of(u, nodes.shape[1] - 1)
    j = cell_of(v, nodes.shape[0] - 1)
    a, b = u - i, v - j
    corner, east, north, twist = facet(corners(nodes, i, j), interpolation, a >= b)
    height: float = corner + a * east + b * north + a * b * twist
    return height


@kernel(forceinline=True)
def slopes(nodes: FloatArray, interpolation: int, i: int, j: int, a: float, b: float) -> tuple[float, float]:
    """Slopes to the east and to the north, per cell, at the point (a, b) of cell (i, j)."""
    _, east, north, twist = facet(corners(nodes, i, j), interpolation, a >= b)
    return east + b * twist, north + a * twist


@kernel(forceinline=True)
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
