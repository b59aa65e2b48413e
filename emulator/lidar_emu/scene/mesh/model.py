"""Triangles prepared for ray casting."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import with_fields
from lidar_emu.scene.mesh.cast import BUNDLE, DEFERRED, RAY, TRIANGLE, cast_rays
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


_WELD_SHARE = 1e-5
"""Maximum distance of vertices that are welded, as a fraction of the mesh's extent. The triangles of a mesh of 20
million are twenty times as long."""


class Topology(NamedTuple):
    """How the triangles of a mesh join."""

    is_closed: bool
    """Whether every edge joins two triangles."""
    faces_one_way: bool
    """Whether neighbouring triangles agree on which side is outside."""


def topology(place: IntArray, face: IntArray) -> Topology:
    """Examine triangles (m, 3) of vertices whose positions are numbered by `place` (n,)."""
    start, end = _edges(place, face)
    # Sorted rather than by np.unique, which takes ten times as long for a million triangles.
    ways = np.sort(_names(place, start, end))
    by_twos = len(ways) % 2 == 0 and bool((ways[::2] == ways[1::2]).all())
    is_closed = by_twos and bool((ways[1:-1:2] != ways[2::2]).all())
    runs = np.sort(start * len(place) + end)
    return Topology(is_closed, bool((runs[1:] != runs[:-1]).all()))


def equal_places(vertex_m: FloatArray) -> IntArray:
    """Number (n,) of the position of each vertex: an STL file repeats the corners for each triangle."""
    _, place = np.unique(vertex_m + 0.0, axis=0, return_inverse=True)
    return place.reshape(-1)


def without_edges(place: IntArray, face: IntArray) -> tuple[IntArray, IntArray]:
    """The same without triangles that have shrunk to an edge or a point."""
    corner = place[face]
    return place, face[(corner != np.roll(corner, 1, axis=1)).all(axis=1)]


def weld(vertex_m: FloatArray, face: IntArray, place: IntArray) -> tuple[FloatArray, int] | None:
    """Move nearly equal vertices to one position, where that closes an open mesh.

    A shape model on a grid of latitudes and longitudes has a vertex for each longitude at its poles, which differ
    by rounding. Only vertices at open edges are welded.

    Returns:
        The vertices (n, 3) and how many of them have moved; None if the mesh would remain open.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    open_ = np.flatnonzero(_at_open_edges(place, face))
    reach_m = _WELD_SHARE * float(np.ptp(vertex_m, axis=0).max())
    pairs = KDTree(vertex_m[open_]).query_pairs(reach_m, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(open_), len(open_)))
    _, group = connected_components(links, directed=False)
    _, first = np.unique(group, return_index=True)
    welded_m = vertex_m.copy()
    welded_m[open_] = vertex_m[open_[first[group]]]
    if not topology(*without_edges(equal_places(welded_m), face)).is_closed:
        return None
    return welded_m, int((welded_m != vertex_m).any(axis=1).sum())


def _edges(place: IntArray, face: IntArray) -> tuple[IntArray, IntArray]:
    """Positions (3 m,) at the start and at the end of each edge of each triangle."""
    corner = place[face]
    return corner.ravel(), np.roll(corner, -1, axis=1).ravel()


def _names(place: IntArray, start: IntArray, end: IntArray) -> IntArray:
    """A number (3 m,) for each edge, the same in both directions."""
    return np.minimum(start, end) * len(place) + np.maximum(start, end)


def _at_open_edges(place: IntArray, face: IntArray) -> BoolArray:
    """Whether a vertex (n,) lies on an edge that does not join two triangles."""
    start, end = _edges(place, face)
    _, way, count = np.unique(_names(place, start, end), return_inverse=True, return_counts=True)
    loose = count[way] != 2
    positions = np.zeros(len(place), dtype=bool)
    positions[start[loose]] = positions[end[loose]] = True
    return np.asarray(positions[place])
