"""Shapes in DSK, SPICE's format, with segments of type 2: plates.

Read here, because CSPICE ends the process, or never returns, on a damaged file. The layout is that of NAIF's "DAS
Required Reading", "DSK Required Reading" and of its files dla.inc and dsk02.inc.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.mesh.formats import IndexedMesh

_INTACT = "use an intact DSK with segments of type 2, plates"
_ORDERS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}
_RECORD_BYTES = 1024
_DOUBLES, _INTEGERS = 2, 3
"""Codes of the types of records; 1 is text."""
_PLATES = 2
_DESCRIPTOR = 8
"""Integers that describe a segment: the ones before and after it, and first place and size of its numbers."""
_FIRST_PLATE, _FIRST_VERTEX = 10, 34
"""Places among the integers and the doubles of a segment."""


def read_dsk(path: Path) -> IndexedMesh:
    """Read the plates of all segments, in kilometres.

    Raises:
        InputError: the file is damaged, or has segments of another type.
    """
    vertex, face, count = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    for integers, doubles in _segments(path):
        if len(integers) < _FIRST_PLATE or len(doubles) < _FIRST_VERTEX:
            _refuse(path, "damaged, a segment is too short")
        if doubles[3] != _PLATES:
            _refuse(path, "a segment of another type")
        vertices, plates = integers[:2].tolist()
        last_vertex, last_plate = _FIRST_VERTEX + 3 * vertices, _FIRST_PLATE + 3 * plates
        if not (
            vertices >= 0 and last_vertex <= len(doubles) and plates >= 0 and last_plate <= len(integers)
        ):
            _refuse(path, f"damaged, a segment of {vertices} vertices and {plates} plates")
        plate = integers[_FIRST_PLATE:last_plate].reshape(-1, 3)
        if ((plate < 1) | (plate > vertices)).any():
            _refuse(path, f"damaged, a plate with a vertex that is none of {vertices}")
        vertex.append(doubles[_FIRST_VERTEX:last_vertex].reshape(-1, 3))
        face.append(plate.astype(np.int64) - 1 + count)
        count += vertices
    return IndexedMesh(np.concatenate(vertex), np.concatenate(face))


def _refuse(path: Path, found: str) -> NoReturn:
    raise InputError(str(path), None, Finding(found), _INTACT)


def _segments(path: Path) -> Iterator[tuple[npt.NDArray[np.int32], FloatArray]]:
    integers, doubles = _numbers(path)
    place = int(integers[1]) if len(integers) > 1 else 0
    # A damaged file may name a segment, or numbers, repeatedly.
    integers_left, doubles_left = len(integers), len(doubles)
    while place != -1:
        if not 0 < place <= len(integers) - _DESCRIPTOR + 1:
            _refuse(path, "damaged, no segment where one is stated")
        words = integers[place - 1 :][:_DESCRIPTOR].tolist()
        _, place, first_integer, integer_count, first_double, double_count, _, _ = words
        integers_left -= max(integer_count, _DESCRIPTOR)
        doubles_left -= double_count
        if min(first_integer, first_double, integer_count, double_count, integers_left, doubles_left) < 0:
            _refuse(path, "damaged, segments that are larger than the file")
        yield (
            integers[first_integer : first_integer + integer_count],
            doubles[first_double : first_double + double_count],
        )


def _numbers(path: Path) -> tuple[npt.NDArray[np.int32], FloatArray]:
    """All integers and all doubles of the file, each in the order of their addresses."""
    content = memoryview(path.read_bytes())
    order = _ORDERS.get(bytes(content[84:92]))
    if bytes(content[:7]) != b"DAS/DSK" or order is None:
        _refuse(path, "no DSK")
    found: dict[int, list[memoryview]] = {_DOUBLES: [], _INTEGERS: []}
    for code, records in _clusters(path, content, order):
        if code in found:
            found[code].append(records)
    integers = np.frombuffer(b"".join(found[_INTEGERS]), f"{order}i4").astype(np.int32, copy=False)
    doubles = np.frombuffer(b"".join(found[_DOUBLES]), f"{order}f8").astype(np.float64, copy=False)
    return integers, doubles


def _clusters(path: Path, content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """The runs of records of one type, with its code, in the order of the file."""
    reserved, _, comments = np.frombuffer(content, f"{order}i4", 3, 68).tolist()
    left = len(content) // _RECORD_BYTES
    record = 1 + reserved + comments
    # Each directory states the next one, by a number from 1; 0 ends them. A damaged one may state itself.
    while record >= 0:
        if left <= 0 or not 0 < record < len(content) // _RECORD_BYTES:
            _refuse(path, "damaged, no directory where one is stated")
        directory = np.frombuffer(content, f"{order}i4", 256, record * _RECORD_BYTES).tolist()
        code, following = directory[8], record + 1
        left -= 1
        for number, signed in enumerate(directory[9:]):
            if signed == 0:
                break
            # The types follow each other in a circle, forwards or backwards.
            code = code if number == 0 else (code % 3 + 1 if signed > 0 else (code - 2) % 3 + 1)
            count = abs(signed)
            left -= count
            if left < 0 or (following + count) * _RECORD_BYTES > len(content):
                _refuse(path, "damaged or truncated, fewer records than it states")
            yield code, content[following * _RECORD_BYTES : (following + count) * _RECORD_BYTES]
            following += count
        record = directory[1] - 1
