"""Triangles prepared for ray casting."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import with_fields
from lidar_emu.scene.mesh.cast import BUNDLE, DEFERRED, cast_rays
from lidar_emu.scene.mesh.ray import RAY, TRIANGLE
from lidar_emu.scene.mesh.tree import WIDTH, build_tree
from lidar_emu.scene.ray_hits import GROUND, Hits, contiguous


class Triangles(NamedTuple):
    """n triangles of one or several objects."""

    corner_m: FloatArray
    """(n, 3, 3) Corners, counter-clockwise as seen from outside."""
    sheet: BoolArray
    """(n,) Whether the triangle belongs to a sheet, seen from both sides; others bound a solid."""
    reflectance: FloatArray
    """(n,) Albedo."""
    object_id: NDArray[np.int16]
    """(n,) Object, see `Hits.object_id`."""

    @classmethod
    def alike(
        cls,
        corner_m: FloatArray,
        reflectance: float | FloatArray,
        sheet: bool = False,
        object_id: int = GROUND,
    ) -> Self:
        """Triangles that share all attributes but the corners, and the albedo if it is a single one."""
        count = len(corner_m)
        return cls(
            corner_m,
            np.full(count, sheet),
            np.full(count, reflectance),
            np.full(count, object_id, dtype=np.int16),
        )

    def chosen(self, which: IntArray) -> Self:
        """Selected triangles; an index may repeat."""
        return type(self)(
            np.ascontiguousarray(self.corner_m[which]),
            self.sheet[which],
            self.reflectance[which],
            self.object_id[which],
        )

    @classmethod
    def joined(cls, parts: list[Self]) -> Self:
        """Concatenate several sets of triangles."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class TriangleMesh:
    """Triangles in a tree of boxes, in the same frame as the rays."""

    def __init__(self, triangles: Triangles) -> None:
        self._tree = build_tree(triangles.corner_m.min(axis=1), triangles.corner_m.max(axis=1))
        # Neighbours in space become neighbours in memory.
        self._triangles = _records(triangles, self._tree.order)
        self._rays = with_fields(np.empty(BUNDLE, dtype=RAY))
        self._deferred = with_fields(np.empty(WIDTH * self._tree.depth, dtype=DEFERRED))
        self._reached = np.empty((2, WIDTH))

    @property
    def low_m(self) -> FloatArray:
        """Minimum coordinates (3,)."""
        return self._tree.low_m

    @property
    def high_m(self) -> FloatArray:
        """Maximum coordinates (3,)."""
        return self._tree.high_m

    def cast(self, origin_m: FloatArray, direction: FloatArray, hits: Hits | None = None) -> Hits:
        """First contact of rays with the triangles; see `Scene.cast`."""
        origin, way = contiguous(origin_m, direction)
        hits = hits or Hits.empty(len(origin))
        cast_rays(
            origin,
            way,
            self._tree.nodes,
            self._triangles,
            self._rays,
            self._deferred,
            self._reached,
            *hits.on_static_ground,
        )
        return hits

    def top_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """Highest z straight above or below each point, (n,), with z upward; NaN beside the triangles."""
        east, north = np.broadcast_arrays(east_m, north_m)
        above_m = float(self.high_m[2]) + 1.0
        start_m = np.stack([east, north, np.full(east.shape, above_m)], axis=-1)
        down = np.broadcast_to([0.0, 0.0, -1.0], start_m.shape)
        return above_m - self.cast(start_m, down).range_m


def _records(triangles: Triangles, order: IntArray) -> Any:
    records = np.empty(len(order), dtype=TRIANGLE)
    records["corner_m"], records["sheet"] = triangles.corner_m[order], triangles.sheet[order]
    records["albedo"], records["object_id"] = triangles.reflectance[order], triangles.object_id[order]
    return with_fields(records)
