"""Triangles as files list them, by the indices of shared vertices."""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.numerics.arrays import FloatArray, IntArray


class IndexedMesh(NamedTuple):
    """Vertices and triangles of a file, in its own unit and order."""

    vertex: FloatArray
    """(n, 3) Coordinates."""
    face: IntArray
    """(m, 3) Vertices of each triangle, from 0."""
    material: IntArray | None = None
    """(m,) Material of each triangle, as an index into `materials`; None: the format has none."""
    materials: tuple[str, ...] = ()
    """Names of the materials; empty for triangles without one."""
