"""Formats of meshes: OBJ, STL and shape tables.

Read here, because trimesh takes a face index of 0 for the last vertex and counts relative indices from the end of the
file, so that every face of a file that counts from 0 is wrong without a word.

Either rows `v x y z` and `f i j k`, or the number of vertices, a row for each (x, y, z, after a running number in most
files), the number of plates, and a row for each. Plates count vertices from 0 in some files and from 1 in others.
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
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


LARGEST_M = 1e8
"""Larger than any planet."""
KINDS = "use an OBJ, PLY or STL file, a shape table (.tab) or a DSK (.bds) with triangles"


def check_vertices(path: Path, vertex: FloatArray, unit_m: float = 1.0) -> None:
    """Refuse coordinates that are no numbers, or beyond any planet, before they are multiplied."""
    if not (np.abs(vertex) <= LARGEST_M / unit_m).all():
        found = Finding(f"vertices that are infinite, not a number, or beyond {LARGEST_M:g} m")
        raise InputError(str(path), None, found, KINDS)


def check_indices(path: Path, index: IntArray, count: int) -> None:
    """Refuse faces with a vertex that the file does not have."""
    wrong = index[(index < 0) | (index >= count)]
    if wrong.size:
        found = Finding(f"a face with vertex {wrong[0]} of {count}, counted from 0")
        raise InputError(str(path), None, found, KINDS)


class _Lines:
    def __init__(self) -> None:
        self.words: list[list[str]] = []
        self.number: list[int] = []

    def add(self, number: int, words: list[str]) -> None:
        self.number.append(number)
        self.words.append(words)


def read_obj(path: Path) -> IndexedMesh:
    """Read vertices and triangles; a polygon becomes a fan of triangles, see `fans`."""
    vertices, faces = _Lines(), _Lines()
    material: list[int] = []
    names = {"": 0}
    current = 0
    text = re.sub(r"\\\r?\n", " ", path.read_bytes().decode("latin-1"))
    for number, line in enumerate(text.split("\n"), start=1):
        key, *words = line.partition("#")[0].split() or [""]
        if key == "v":
            if len(words) == 4 and words[3].rstrip("0") not in ("1", "1."):
                found = Finding(f"a vertex of weight {words[3]}")
                raise InputError(str(path), f"line {number}", found, "write x/w y/w z/w, without a weight")
            vertices.add(number, words[:3])
        elif key == "f":
            faces.add(number, words)
            material.append(current)
        elif key == "usemtl":
            current = names.setdefault(" ".join(words), len(names))
    vertex = _numbers(path, vertices)
    check_vertices(path, vertex)
    counts = np.array([len(words) for words in faces.words], dtype=np.int64)
    face, row, bad = fans(_indices(path, faces, vertices), counts, vertex)
    if bad is not None:
        _refuse_face(path, faces, bad, NO_FAN)
    return IndexedMesh(vertex, face, np.array(material, dtype=np.int64)[row], tuple(names))


def _numbers(path: Path, rows: _Lines, key: str = "v") -> FloatArray:
    try:
        return np.array(rows.words, dtype=np.float64).reshape(len(rows.words), 3)
    except ValueError:
        for number, words in zip(rows.number, rows.words, strict=True):
            try:
                np.array(words, dtype=np.float64).reshape(3)
            except ValueError:
                found = Finding(" ".join([key, *words]))
                raise InputError(
                    str(path), f"line {number}", found, f"write {key} and three numbers"
                ) from None
        raise


def _indices(path: Path, faces: _Lines, vertices: _Lines) -> IntArray:
    """Vertex indices from 0, of all faces one after the other."""
    counts = [len(words) for words in faces.words]
    if counts and min(counts) < 3:
        _refuse_face(path, faces, counts.index(min(counts)), "write f and three or more vertex numbers")
    line = np.repeat(np.array(faces.number, dtype=np.int64), counts)
    words = [word.partition("/")[0] for word in chain.from_iterable(faces.words)]
    count = len(vertices.words)
    # Checked first: an array of text gives every word the room of the longest, and long numbers overflow.
    if not all(map(_is_index, words)):
        bad = next(k for k, word in enumerate(words) if not _is_index(word))
        _refuse_face(path, faces, faces.number.index(line[bad]), "use whole vertex numbers")
    stated = np.array(words, dtype=np.str_).astype(np.int64) if words else np.empty(0, dtype=np.int64)
    # Negative indices count back from the last vertex above the face.
    index = np.where(stated > 0, stated - 1, np.searchsorted(vertices.number, line) + stated)
    wrong = (stated == 0) | (index < 0) | (index >= count)
    if wrong.any():
        remedy = f"use vertex numbers from 1 to {count}, or negative ones that count back from the face"
        if (stated == 0).any():
            remedy += "; add 1 to all indices of a file that counts from 0"
        _refuse_face(path, faces, faces.number.index(line[wrong.argmax()]), remedy)
    return index


_is_index = re.compile(r"[+-]?[0-9]{1,18}").fullmatch


def _refuse_face(path: Path, faces: _Lines, row: int, remedy: str) -> None:
    found = Finding(f"face {' '.join(faces.words[row])}")
    raise InputError(str(path), f"line {faces.number[row]}", found, remedy)


NO_FAN = "use triangles, or polygons of which one corner sees all others"
_TURNED = 1e-3
"""Share of a polygon's area that a triangle of its fan may face the other way: corners at a pole differ by rounding."""
_TURNED_QUADRILATERAL = 0.25
"""The same with four corners, which have a fan in any plane: one that has none is bent."""


def fans(index: IntArray, counts: IntArray, vertex: FloatArray) -> tuple[IntArray, IntArray, int | None]:
    """Triangles (m, 3) of polygons with the given numbers of corners, the polygon (m,) of each, and a polygon that has
    none; None: each has some.

    The fan of a concave polygon covers ground outside it, unless it starts at a corner that sees all others.
    """
    face, row = _fan(index, counts)
    divided = np.flatnonzero(counts[row] > 3)  # a triangle faces its own way
    turned = _turned_share(face[divided], row[divided], vertex) > _TURNED
    for polygon in np.unique(row[divided[turned]]).tolist():
        # A polygon has two triangles fewer than corners.
        first = int(np.searchsorted(row, polygon))
        count = int(counts[polygon])
        corners = index[first + 2 * polygon :][:count]
        tried = [_fan(np.roll(corners, -start), counts[polygon : polygon + 1]) for start in range(count)]
        shares = [_turned_share(*fan, vertex).max() for fan in tried]
        best = int(np.argmin(shares))
        if shares[best] > (_TURNED_QUADRILATERAL if count == 4 else _TURNED):
            return face, row, polygon
        face[first : first + count - 2] = tried[best][0]
    return face, row, None


def _fan(index: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    first = np.cumsum(counts) - counts
    row = np.repeat(np.arange(len(counts)), counts - 2)
    # The k-th triangle of a fan joins the first corner with corners k + 1 and k + 2.
    k = np.arange(len(row)) - np.repeat(np.cumsum(counts - 2) - (counts - 2), counts - 2)
    corners = np.stack([first[row], first[row] + k + 1, first[row] + k + 2], axis=1)
    return index[corners], row


def _turned_share(face: IntArray, row: IntArray, vertex: FloatArray) -> FloatArray:
    """Area of each triangle of a fan over its polygon's, where it faces the other way; else below 0."""
    a, b, c = (vertex[face[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    polygons = row.max(initial=-1) + 1
    whole = np.stack([np.bincount(row, area[:, k], polygons) for k in range(3)], axis=1)[row]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -(area * whole).sum(axis=1) / (whole * whole).sum(axis=1)
    # Triangles that cancel out face both ways.
    return np.where(np.isnan(share), np.where(area.any(axis=1), np.inf, 0.0), share)


_TABLE = "use rows v x y z and f i j k, or counts of vertices and of plates, each followed by its rows"

_Rows = list[list[str]]


def read_shape_table(path: Path) -> IndexedMesh:
    """Read vertices and plates."""
    rows = [line.replace(",", " ").split() for line in path.read_text("latin-1").splitlines()]
    rows = [row for row in rows if row]
    keys = {row[0].lower() for row in rows}
    if keys == {"v", "f"}:
        vertices, plates = ([row[1:] for row in rows if row[0].lower() == key] for key in "vf")
    else:
        vertices, plates = _counted(path, rows)
    vertex, plate = _triples(path, vertices, "vertices"), _triples(path, plates, "plates")
    if not ((plate == np.floor(plate)) & (np.abs(plate) < 2**31)).all():
        raise InputError(
            str(path), None, Finding("plates with fractions of a vertex number, or too large"), _TABLE
        )
    return IndexedMesh(vertex, plate.astype(np.int64) - _first_index(path, plate, len(vertex)))


def _counted(path: Path, rows: _Rows) -> tuple[_Rows, _Rows]:
    """Rows of vertices and of plates without their running numbers, by the counts above them."""
    try:
        counts = [int(word) for word in rows[0]]
        below = rows[1:]
        vertices, below = below[: counts[0]], below[counts[0] :]
        if len(counts) == 1:
            counts.append(int(below[0][0]) if len(below[0]) == 1 else -1)
            below = below[1:]
    except (IndexError, ValueError):
        raise InputError(str(path), None, Finding("no shape table"), _TABLE) from None
    if len(counts) != 2 or len(vertices) != counts[0] or len(below) != counts[1]:
        found = f"{len(vertices)} rows of vertices and {len(below)} of plates for counts of {counts}"
        raise InputError(str(path), None, Finding(found), _TABLE)
    return [row[-3:] for row in vertices], [row[-3:] for row in below]


def _triples(path: Path, rows: _Rows, what: str) -> FloatArray:
    try:
        return np.array(rows, dtype=np.float64).reshape(len(rows), 3)
    except ValueError:
        raise InputError(str(path), None, Finding(f"{what} that are not three numbers"), _TABLE) from None


def _first_index(path: Path, plate: FloatArray, count: int) -> int:
    if not plate.size:
        return 0
    low, high = int(plate.min()), int(plate.max())
    possible = [first for first in (0, 1) if first <= low and high < first + count]
    if len(possible) == 1:
        return possible[0]
    found = Finding(f"plates that count {count} vertices from {low} to {high}")
    raise InputError(str(path), None, found, "count from 0 or from 1, and use the first or the last vertex")


_FACET = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD_BYTES = 84
"""Of a binary file: a text that means nothing, and the number of facets."""
_AFTER = {
    "": ("solid",),
    "solid": ("facet", "endsolid"),
    "facet": ("outer",),
    "outer": ("vertex",),
    "vertex": ("vertex", "endloop"),
    "endloop": ("endfacet",),
    "endfacet": ("facet", "endsolid"),
    "endsolid": ("solid",),
}
"""Words that may begin the line of a text after one that another word begins."""
_STL = "use an intact STL file"


def read_stl(path: Path) -> IndexedMesh:
    """Read the facets of a binary file, or of all solids of a text; the order of their corners is their outside.

    Raises:
        InputError: the file is damaged.
    """
    content = path.read_bytes()
    count = int.from_bytes(content[_HEAD_BYTES - 4 : _HEAD_BYTES], "little")
    if len(content) == _HEAD_BYTES + count * _FACET.itemsize:
        corner = np.frombuffer(content, _FACET, count, _HEAD_BYTES)["corner"].astype(np.float64)
    elif b"\0" in content or not content.lstrip().lower().startswith(b"solid"):
        raise InputError(str(path), None, Finding("neither text nor as long as its facets"), _STL)
    else:
        corner = _corners(path, content.decode("latin-1"))
    return IndexedMesh(corner.reshape(-1, 3), np.arange(corner.size // 3).reshape(-1, 3))


def _corners(path: Path, text: str) -> FloatArray:
    vertices, before = _Lines(), ""
    for number, line in enumerate(text.split("\n"), start=1):
        key, *words = line.split() or [""]
        key = key.lower()
        if not key:
            continue
        is_whole = key != "endloop" or len(vertices.words) % 3 == 0
        if key not in _AFTER[before] or not is_whole:
            found = Finding(line[:60] if is_whole else "a facet of other than three vertices")
            raise InputError(str(path), f"line {number}", found, _STL)
        if key == "vertex":
            vertices.add(number, words)
        before = key
    if before != "endsolid":
        raise InputError(str(path), None, Finding("ends within a solid"), _STL)
    return _numbers(path, vertices, "vertex")
