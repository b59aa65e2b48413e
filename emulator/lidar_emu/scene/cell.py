"""The ground of a single cell: the bilinear surface between four samples, and a ray's first contact with it.

Grid coordinates u and v count cells to the east and to the north from the south-west sample. All is inlined by
request: as calls, these few operations each would take a ray half as long again.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.kernels import kernel


@kernel(forceinline=True)
def cell_of(position: float, cells: int) -> int:
    """Index of the cell at a grid coordinate; the last cell includes its far edge."""
    return min(max(int(position), 0), cells - 1)


@kernel(forceinline=True)
def surface(nodes: FloatArray, u: float, v: float) -> float:
    """Height at a point of the grid; NaN where a corner of its cell is missing."""
    i = cell_of(u, nodes.shape[1] - 1)
    j = cell_of(v, nodes.shape[0] - 1)
    a, b = u - i, v - j
    z00, z10, z01, z11 = nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]
    height: float = z00 + a * (z10 - z00) + b * (z01 - z00) + a * b * ((z11 - z01) - (z10 - z00))
    return height


@kernel(forceinline=True)
def slopes(nodes: FloatArray, i: int, j: int, u: float, v: float) -> tuple[float, float]:
    """Rise per cell to the east and to the north, at a point of cell (i, j)."""
    z00, z10, z01, z11 = nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]
    twist = (z11 - z01) - (z10 - z00)
    return (z10 - z00) + (v - j) * twist, (z01 - z00) + (u - i) * twist


@kernel(forceinline=True)
def height_along(
    nodes: FloatArray, i: int, j: int, a: float, b: float, z: float, du: float, dv: float, dz: float
) -> tuple[float, float, float]:
    """Height of a ray above the surface of cell (i, j) as c0 + c1 s + c2 s².

    The ray passes at s = 0 through (a, b) in the cell's own coordinates, at height ``z``. Where a corner is
    missing, c0 is NaN.
    """
    z00, z10, z01, z11 = nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]
    p, q = z10 - z00, z01 - z00
    twist = (z11 - z01) - p
    c0 = z - (z00 + a * p + b * q + a * b * twist)
    c1 = dz - (p + b * twist) * du - (q + a * twist) * dv
    return c0, c1, -twist * du * dv


@kernel(forceinline=True)
def first_descent(c0: float, c1: float, c2: float, length: float) -> float:
    """Smallest s in [0, length] with ``c0 + c1 s + c2 s² <= 0``, or NaN.

    The sign at the far end decides wherever it can, not the root: the next cell starts from the same point,
    so that a ray through an edge or a vertex is taken by one of its cells whatever the rounding.
    """
    if c0 <= 0.0:
        return 0.0
    square = c1 * c1 - 4.0 * c2 * c0
    if c0 + length * (c1 + length * c2) > 0.0:
        dips = c2 > 0.0 and c1 < 0.0 and -c1 < 2.0 * c2 * length and square >= 0.0
        return 2.0 * c0 / (np.sqrt(square) - c1) if dips else np.nan
    root = np.sqrt(max(square, 0.0))
    s = 2.0 * c0 / (root - c1) if c1 < 0.0 else (c1 + root) / (-2.0 * c2)
    return s if s < length else length
