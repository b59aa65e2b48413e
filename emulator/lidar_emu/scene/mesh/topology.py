"""Topology of a mesh: whether it is closed and its triangles agree on what is outside; welding of nearly equal
vertices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray

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
