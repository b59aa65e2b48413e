"""Triangle meshes from files of any format, and how their triangles join."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_file
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.scene.mesh.dsk import read_dsk
from lidar_emu.scene.mesh.formats import (
    KINDS,
    IndexedMesh,
    check_indices,
    check_vertices,
    read_obj,
    read_shape_table,
    read_stl,
)
from lidar_emu.scene.mesh.ply import read_ply

MAXIMUM_TRIANGLES = 20_000_000
_METRES = {"m": 1.0, "km": 1000.0}
SUFFIXES = (".obj", ".ply", ".stl", ".tab", ".bds", ".dsk")


@dataclass(frozen=True)
class MeshFile:
    """A mesh from its file, in metres."""

    source: str
    corner_m: FloatArray
    """Corners (triangles, 3, 3), counter-clockwise from outside as far as the orientation is known."""
    is_closed: bool
    """Whether every edge joins two triangles."""
    faces_one_way: bool
    """Whether neighbouring triangles agree on which side is outside."""
    turned: bool = False
    """Whether the triangles of a closed mesh faced inward in the file."""
    flat: int = 0
    """Number of triangles without area, which are left out."""
    welded: int = 0
    """Number of vertices that were moved to nearly equal ones, which closed the mesh."""
    material: IntArray | None = None
    """(triangles,) Material of each, as an index into `materials`; None: the format has none."""
    materials: tuple[str, ...] = ()
    """Names of the materials; empty for triangles without one."""

    @property
    def description(self) -> str:
        x_m, y_m, z_m = np.ptp(self.corner_m.reshape(-1, 3), axis=0).tolist()
        words = [
            f"mesh {Path(self.source).name}, {len(self.corner_m)} triangles, {x_m:.4g} x {y_m:.4g} x {z_m:.4g} m"
        ]
        words.append(self._enclosed if self.is_closed else "open")
        if not self.faces_one_way:
            words.append("inconsistent face orientation: treated as a sheet")
        if self.turned:
            words.append("faced inward: inverted")
        if self.flat:
            words.append(f"{self.flat} triangles without area left out")
        if self.welded:
            words.append(f"{self.welded} vertices welded to nearly equal ones")
        return ", ".join(words)

    @property
    def _enclosed(self) -> str:
        """Volume of a closed mesh, and distances of its vertices from the origin of the file."""
        if not self.faces_one_way:
            return "closed"
        from_zero_m = np.sqrt((self.corner_m.reshape(-1, 3) ** 2).sum(axis=1))
        unit, length_m = ("km", 1000.0) if from_zero_m.max() >= 1000.0 else ("m", 1.0)
        volume = abs(enclosed_m3(self.corner_m)) / length_m**3
        low, high = from_zero_m.min() / length_m, from_zero_m.max() / length_m
        return f"closed, volume {volume:.5g} {unit}³, radii {low:.4g} to {high:.4g} {unit}"

    def albedo(self, key: str, by_material: Mapping[str, float], other: float) -> FloatArray:
        """Albedo (triangles,) by the names of materials; `other` for those that are not named."""
        names = [name for name in self.materials if name]
        for name in by_material:
            if name not in names:
                nothing = "leave it out: the file names no materials"
                remedy = f"must be one of {', '.join(names)}" if names else nothing
                raise InputError(self.source, key, name, remedy)
        if self.material is None:
            return np.full(len(self.corner_m), other)
        return np.array([by_material.get(name, other) for name in self.materials])[self.material]


def read_mesh(file: str, unit: str) -> MeshFile:
    """Read a mesh in metres; a closed mesh is made to face outward.

    Args:
        file: path of the file.
        unit: unit of its coordinates, `m` or `km`.

    Raises:
        InputError: the file is missing, damaged, of another format, without triangles or too large.
    """
    path = Path(file)
    check_file(path, KINDS, MOST_BYTES_IN_MEMORY)
    mesh = _read(path, unit)
    if len(mesh.face) == 0:
        raise InputError(file, None, Finding("no triangles"), KINDS)
    if len(mesh.face) > MAXIMUM_TRIANGLES:
        found = Finding(f"{len(mesh.face)} triangles, more than {MAXIMUM_TRIANGLES}")
        raise InputError(file, None, found, "cut out the site's area")
    check_indices(path, mesh.face, len(mesh.vertex))
    check_vertices(path, mesh.vertex, _METRES[unit])
    return _examined(file, mesh, mesh.vertex * _METRES[unit])


def _examined(file: str, mesh: IndexedMesh, vertex_m: FloatArray) -> MeshFile:
    place, welded = equal_places(vertex_m), 0
    joined = topology(place, mesh.face)
    if not joined.is_closed and (closing := weld(vertex_m, mesh.face, place)) is not None:
        vertex_m, welded = closing
        joined = topology(*without_edges(equal_places(vertex_m), mesh.face))
    corner_m = vertex_m[mesh.face]
    turned = joined.is_closed and joined.faces_one_way and enclosed_m3(corner_m) < 0
    if turned:
        corner_m = turned_over(corner_m)
    edges = corner_m[:, 1:] - corner_m[:, :1]
    has_area = np.cross(edges[:, 0], edges[:, 1]).any(axis=1)
    if not has_area.any():
        raise InputError(file, None, Finding("no triangle has an area"), KINDS)
    return MeshFile(
        source=file,
        corner_m=corner_m[has_area],
        is_closed=joined.is_closed,
        faces_one_way=joined.faces_one_way,
        turned=turned,
        flat=int((~has_area).sum()),
        welded=welded,
        material=None if mesh.material is None else mesh.material[has_area],
        materials=mesh.materials,
    )


def _read(path: Path, unit: str) -> IndexedMesh:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(str(path), None, Finding("no known format"), KINDS)
    if suffix == ".obj":
        return read_obj(path)
    if suffix == ".tab":
        return read_shape_table(path)
    if suffix in (".bds", ".dsk"):
        if unit != "km":
            raise InputError(str(path), "unit", unit, "must be km, the unit of every DSK")
        return read_dsk(path)
    if suffix == ".ply":
        return read_ply(path)
    return read_stl(path)


def enclosed_m3(corner_m: FloatArray) -> float:
    """Volume enclosed by triangles around the origin, positive if they face outward."""
    a, b, c = np.moveaxis(corner_m, 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def turned_over(corner_m: FloatArray) -> FloatArray:
    """The same triangles with opposite orientation."""
    return np.ascontiguousarray(corner_m[:, ::-1])


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
