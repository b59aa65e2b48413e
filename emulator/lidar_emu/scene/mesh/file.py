"""Reading of triangle meshes, with their topology."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray, IntArray

MAXIMUM_TRIANGLES = 20_000_000
_METRES = {"m": 1.0, "km": 1000.0}
_SUFFIXES = (".obj", ".ply", ".stl")
_KINDS = "allowed: an OBJ, PLY or STL file with triangles"


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

    @property
    def size_m(self) -> FloatArray:
        """Extent (3,) along the file's axes."""
        points_m = self.corner_m.reshape(-1, 3)
        return np.asarray(points_m.max(axis=0) - points_m.min(axis=0))

    @property
    def description(self) -> str:
        """One line for plans."""
        x_m, y_m, z_m = self.size_m.tolist()
        words = [
            f"mesh {Path(self.source).name}, {len(self.corner_m)} triangles, {x_m:.4g} x {y_m:.4g} x {z_m:.4g} m"
        ]
        words.append("closed" if self.is_closed else "open")
        if not self.faces_one_way:
            words.append("inconsistent face orientation: treated as a sheet")
        if self.turned:
            words.append("faced inward: inverted")
        if self.flat:
            words.append(f"{self.flat} triangles without area left out")
        return ", ".join(words)


def read_mesh(file: str, unit: str) -> MeshFile:
    """Read a mesh in metres; a closed mesh is made to face outward.

    Raises:
        InputError: the file is missing, damaged, of another format, without triangles or too large, or trimesh is not
            installed.
    """
    path = Path(file)
    if not path.is_file():
        raise InputError(file, None, Finding("no such file"), _KINDS)
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(file, None, path.suffix or path.name, _KINDS)
    mesh = _load(path)
    vertex_m = np.asarray(mesh.vertices, dtype=np.float64) * _METRES[unit]
    if not np.isfinite(vertex_m).all():
        raise InputError(file, None, Finding("vertices that are infinite or not a number"), _KINDS)
    corner_m = vertex_m[np.asarray(mesh.faces)]
    is_closed, faces_one_way = _topology(vertex_m, np.asarray(mesh.faces))
    turned = is_closed and faces_one_way and enclosed_m3(corner_m) < 0
    if turned:
        corner_m = turned_over(corner_m)
    edges = corner_m[:, 1:] - corner_m[:, :1]
    has_area = np.cross(edges[:, 0], edges[:, 1]).any(axis=1)
    if not has_area.any():
        raise InputError(file, None, Finding("no triangle has an area"), _KINDS)
    return MeshFile(file, corner_m[has_area], is_closed, faces_one_way, turned, int((~has_area).sum()))


def enclosed_m3(corner_m: FloatArray) -> float:
    """Volume enclosed by triangles around the origin, positive if they face outward."""
    a, b, c = np.moveaxis(corner_m, 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def turned_over(corner_m: FloatArray) -> FloatArray:
    """The same triangles with opposite orientation."""
    return np.ascontiguousarray(corner_m[:, ::-1])


def _topology(vertex_m: FloatArray, faces: IntArray) -> tuple[bool, bool]:
    """Whether every edge joins two triangles, and whether neighbours have consistent orientation.

    Vertices at the same position are merged: an STL file repeats the corners for each triangle.
    """
    _, place = np.unique(vertex_m + 0.0, axis=0, return_inverse=True)
    corners = place.reshape(-1)[faces]
    start, end = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    # Sorted rather than by np.unique, which takes ten times as long for a million triangles.
    ways = np.sort(np.minimum(start, end) * len(place) + np.maximum(start, end))
    by_twos = len(ways) % 2 == 0 and bool((ways[::2] == ways[1::2]).all())
    is_closed = by_twos and bool((ways[1:-1:2] != ways[2::2]).all())
    runs = np.sort(start * len(place) + end)
    return is_closed, bool((runs[1:] != runs[:-1]).all())


def _load(path: Path) -> Any:
    try:
        import trimesh
    except ImportError:
        allowed = "allowed: an installation with pip install 'lidar-emu[mesh]'"
        raise InputError(str(path), None, Finding("meshes need trimesh"), allowed) from None
    try:
        mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
    except MemoryError:
        raise
    except Exception as error:  # Parsers raise exceptions of many types.
        raise InputError(str(path), None, Finding("unreadable"), f"{_reason(error)}; {_KINDS}") from None
    if isinstance(mesh, trimesh.Scene):
        mesh = mesh.to_mesh() if mesh.geometry else None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(str(path), None, Finding("no triangles"), _KINDS)
    if len(mesh.faces) > MAXIMUM_TRIANGLES:
        allowed = f"allowed: at most {MAXIMUM_TRIANGLES} triangles; cut out the site's area"
        raise InputError(str(path), None, f"{len(mesh.faces)} triangles", allowed)
    return mesh


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
