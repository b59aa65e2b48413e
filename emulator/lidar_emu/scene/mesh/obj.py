"""Wavefront OBJ files: vertices, faces and the names of materials.

Read here, because trimesh takes a face index of 0 for the last vertex and counts relative indices from the end of the
file, so that every face of a file that counts from 0 is wrong without a word.
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.scene.mesh.indexed import IndexedMesh


class _Lines:
    """Rows of one key (`v` or `f`), each with the number of its line."""

    def __init__(self) -> None:
        self.words: list[list[str]] = []
        self.number: list[int] = []

    def add(self, number: int, words: list[str]) -> None:
        self.number.append(number)
        self.words.append(words)


def read_obj(path: Path) -> IndexedMesh:
    """Read vertices and triangles; a polygon becomes a fan of triangles."""
    vertices, faces = _Lines(), _Lines()
    material: list[int] = []
    names = {"": 0}
    current = 0
    text = re.sub(r"\\\r?\n", " ", path.read_bytes().decode("latin-1"))
    for number, line in enumerate(text.split("\n"), start=1):
        key, *words = line.partition("#")[0].split() or [""]
        if key == "v":
            vertices.add(number, words[:3])
        elif key == "f":
            faces.add(number, words)
            material.append(current)
        elif key == "usemtl":
            current = names.setdefault(" ".join(words), len(names))
    vertex = _numbers(path, vertices)
    face, row = _fans(
        _indices(path, faces, vertices), np.array([len(words) for words in faces.words], dtype=np.int64)
    )
    return IndexedMesh(vertex, face, np.array(material, dtype=np.int64)[row], tuple(names))


def _numbers(path: Path, rows: _Lines) -> FloatArray:
    """Coordinates (n, 3)."""
    try:
        return np.array(rows.words, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        for number, words in zip(rows.number, rows.words, strict=True):
            try:
                np.array(words, dtype=np.float64).reshape(3)
            except ValueError:
                found = Finding(" ".join(["v", *words]))
                raise InputError(str(path), f"line {number}", found, "write v and three numbers") from None
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


def _fans(index: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """Triangles (m, 3) of polygons with the given numbers of corners, and the polygon (m,) of each."""
    first = np.cumsum(counts) - counts
    row = np.repeat(np.arange(len(counts)), counts - 2)
    # The k-th triangle of a fan joins the first corner with corners k + 1 and k + 2.
    k = np.arange(len(row)) - np.repeat(np.cumsum(counts - 2) - (counts - 2), counts - 2)
    corners = np.stack([first[row], first[row] + k + 1, first[row] + k + 2], axis=1)
    return index[corners], row
