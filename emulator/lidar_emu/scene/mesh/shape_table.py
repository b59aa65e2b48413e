"""Shape tables of small bodies, as the Planetary Data System archives them (`.tab`).

Either rows `v x y z` and `f i j k`, or the number of vertices, a row for each (x, y, z, after a running number in most
files), the number of plates, and a row for each. Plates count vertices from 0 in some files and from 1 in others.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.mesh.indexed import IndexedMesh

_TABLE = "use rows v x y z and f i j k, or counts of vertices and of plates, each followed by its rows"

_Rows = list[list[str]]


def read_shape_table(path: Path) -> IndexedMesh:
    """Read vertices and plates."""
    rows = [line.replace(",", " ").split() for line in path.read_text("latin-1").splitlines()]
    rows = [row for row in rows if row]
    keys = {row[0].lower() for row in rows}
    vertices, plates = _lettered(rows) if keys == {"v", "f"} else _counted(path, rows)
    vertex, plate = _numbers(path, vertices, "vertices"), _numbers(path, plates, "plates")
    if (plate != np.floor(plate)).any():
        raise InputError(str(path), None, Finding("plates with fractions of a vertex number"), _TABLE)
    return IndexedMesh(vertex, plate.astype(np.int64) - _first_index(path, plate, len(vertex)))


def _lettered(rows: _Rows) -> tuple[_Rows, _Rows]:
    return [row[1:] for row in rows if row[0] in "vV"], [row[1:] for row in rows if row[0] in "fF"]


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


def _numbers(path: Path, rows: _Rows, what: str) -> FloatArray:
    try:
        return np.array(rows, dtype=np.float64).reshape(-1, 3)
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
