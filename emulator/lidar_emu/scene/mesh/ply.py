"""Meshes in PLY, as text or binary.

Read here, because trimesh reads a text that ends early, or states more corners than it lists, as a smaller mesh, fans
concave polygons across the ground outside them, and reads no binary file of triangles and quadrilaterals.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.scene.mesh.formats import NO_FAN, IndexedMesh, check_indices, check_vertices, fans

_INTACT = "use an intact PLY file with the elements vertex and face"
_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float": "f4",
    "double": "f8",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = re.compile(rb"^end_header[ \t]*(\r\n|\r|\n)", re.MULTILINE)
_INDICES = ("vertex_indices", "vertex_index")


class _Property(NamedTuple):
    name: str
    kind: str
    """Its type in numpy's notation."""
    counted_by: str | None
    """Type of the number of entries of a list; None: a single value."""


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


def read_ply(path: Path) -> IndexedMesh:
    """Read vertices and triangles; a polygon becomes a fan of triangles, see `fans`.

    Raises:
        InputError: the file is damaged, or has no faces.
    """
    content = path.read_bytes()
    end = _END.search(content)
    if not content.startswith(b"ply") or end is None:
        raise InputError(str(path), None, Finding("no PLY header"), _INTACT)
    elements, is_text = _header(path, content[: end.start()].decode("latin-1").splitlines())
    data = _words(path, content[end.end() :]) if is_text else content[end.end() :]
    tables: dict[str, list[Any]] = {}
    at = 0
    for element in elements:
        tables[element.name] = list(_tables(path, element, data, at))
        at += sum(table.nbytes for table in tables[element.name])
    if at < len(data):
        raise InputError(str(path), None, Finding("more numbers than the header states"), _INTACT)
    vertex = _vertices(path, tables.get("vertex", []))
    index, counts = _polygons(path, tables.get("face", []))
    check_vertices(path, vertex)
    check_indices(path, index, len(vertex))
    face, _, bad = fans(index, counts, vertex)
    if bad is not None:
        raise InputError(str(path), None, Finding(f"face {bad} of {len(counts)} is no fan"), NO_FAN)
    return IndexedMesh(vertex, face)


def _header(path: Path, lines: list[str]) -> tuple[list[_Element], bool]:
    """The elements in their order, and whether they are text, whose numbers are all read as 64-bit floats."""
    order: str | None = None
    elements: list[_Element] = []

    def typed(kind: str) -> str:
        return f"{order}{_TYPES[kind]}" if order else "f8"

    for number, line in enumerate(lines[1:], start=2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in _ORDERS and order is None:
                order = _ORDERS[name]
            case ["element", name, count] if re.fullmatch("[0-9]{1,15}", count) and order is not None:
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count, kind, name] if {count, kind} <= _TYPES.keys() and elements:
                elements[-1].properties.append(_Property(name, typed(kind), typed(count)))
            case ["property", kind, name] if kind in _TYPES and elements:
                elements[-1].properties.append(_Property(name, typed(kind), None))
            case _:
                raise InputError(str(path), f"line {number}", line, "must be a line of a PLY header")
    named = [[element.name for element in elements]]
    named += [[each.name for each in element.properties] for element in elements]
    for names in named:
        for name in names:
            if names.count(name) > 1:
                raise InputError(str(path), None, Finding(f"{name} twice in the header"), _INTACT)
    return elements, not order


def _words(path: Path, text: bytes) -> bytes:
    try:
        return np.array(text.split(), dtype=np.float64).tobytes()
    except ValueError as error:
        raise InputError(str(path), None, Finding(f"unreadable, {error}"), _INTACT) from None


def _tables(path: Path, element: _Element, data: bytes, at: int) -> Iterator[Any]:
    """The rows of an element that begin at a byte, as structured arrays of rows whose lists are equally long."""
    left = element.rows if element.properties else 0
    tried = left
    while left:
        kind = _row_type(path, element, data, at)
        count = min(tried, (len(data) - at) // kind.itemsize)
        table = np.frombuffer(data, kind, count, at)
        alike = np.ones(count, dtype=bool)
        for name in kind.names or ():
            if name.startswith(_COUNT):
                alike &= table[name] == table[name][:1]
        taken = count if alike.all() else int(alike.argmin())
        if not taken:
            raise _ends(path, element)
        yield table[:taken]
        at += taken * kind.itemsize
        left -= taken
        tried = min(left, 2 * taken)


_COUNT = "number of "
"""No name of a property has a blank."""


def _row_type(path: Path, element: _Element, data: bytes, at: int) -> np.dtype[Any]:
    """Type of the row that begins at a byte, with its lists as arrays, and the number of entries before each."""
    fields: list[tuple[Any, ...]] = []
    for name, kind, counted_by in element.properties:
        if counted_by is None:
            fields.append((name, kind))
            at += np.dtype(kind).itemsize
            continue
        size = np.dtype(counted_by).itemsize
        if at + size > len(data):
            raise _ends(path, element)
        count = float(np.frombuffer(data, counted_by, 1, at)[0])
        if not 0 <= count < len(data) or count % 1:
            found = Finding(f"a list of {count:g} in element {element.name}")
            raise InputError(str(path), None, found, _INTACT)
        fields += [(_COUNT + name, counted_by), (name, kind, (int(count),))]
        at += size + int(count) * np.dtype(kind).itemsize
        if at > len(data):
            raise _ends(path, element)
    return np.dtype(fields)


def _ends(path: Path, element: _Element) -> InputError:
    found = Finding(f"ends within the {element.rows} rows of element {element.name}")
    return InputError(str(path), None, found, _INTACT)


def _vertices(path: Path, tables: list[Any]) -> FloatArray:
    axes = {axis for table in tables for axis in "xyz" if axis in table.dtype.names and table[axis].ndim == 1}
    if len(axes) < 3:
        raise InputError(str(path), None, Finding("no vertices with x, y and z"), _INTACT)
    return np.concatenate([np.stack([table[axis] for axis in "xyz"], axis=-1) for table in tables]).astype(
        np.float64
    )


def _polygons(path: Path, tables: list[Any]) -> tuple[IntArray, IntArray]:
    """Vertices of all faces, one after the other, and the number (faces,) of each face's."""
    corner = [table[name] for table in tables for name in _INDICES if name in table.dtype.names]
    if not corner or any(each.ndim < 2 or each.shape[1] < 3 for each in corner):
        raise InputError(str(path), None, Finding("faces of fewer than three vertices, or none"), _INTACT)
    index = np.concatenate([each.ravel() for each in corner])
    if not (np.isfinite(index) & (np.abs(index) < 2**31) & (index == np.floor(index))).all():
        raise InputError(
            str(path), None, Finding("faces with numbers that are no numbers of vertices"), _INTACT
        )
    return index.astype(np.int64), np.concatenate([np.full(len(each), each.shape[1]) for each in corner])
