"""Arrays: their types, columns of shots and beams, growing tables, and records for kernels.

A dataclass declares its arrays as `Annotated[FloatArray, Column("f8", "m", "Measured range.")]`; `columns` reads the
declarations back. Allocation, tables, the schema of recordings and documents derive from them.

Passing a record (a structured array of one element) to a kernel costs as much as passing an array. Between kernels a
named tuple of arrays costs nothing; from Python it costs up to 5 µs more per call than its arrays, longer than many
kernels take. The outermost kernel of a model therefore takes such arrays as a plain tuple, which costs about 0.2 µs
more than separate arguments, and builds the named tuple in its first line. Kernels that cast a few rays within 1 or 2
µs take the arrays of `Hits` as separate arguments, nine to twelve in all: for a plane and four rays a call takes
0.66 µs, with a record of the plane's constants 0.80 µs, with a tuple of the arrays 0.84 µs. A table of constants, such
as the legs of a path, is one record array.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from enum import Enum, auto
from functools import cache, cached_property, lru_cache
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.kernels import with_fields

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


class Group(Enum):
    """Subject of a column, which decides in which outputs it appears."""

    TIMING = auto()
    """Number and instants of the shot."""
    POINTING = auto()
    """Which beams fire, and their directions."""
    REPORT = auto()
    """Measurements of a beam, as the instrument reports them."""
    TRUTH = auto()
    """Ground truth of a beam."""
    POINT = auto()
    """Published beam axis, and the point at the end of the measured range along it; packets have neither."""
    VEHICLE = auto()
    """Ground truth of the vehicle."""


@dataclass(frozen=True)
class Column:
    """The declaration of an array shaped (shots, beams, *components), or (shots, *components)."""

    dtype: str
    """Type as numpy writes it, e.g. `f8`."""
    unit: str
    """Unit; empty for a flag, a code or a count."""
    meaning: str
    """Meaning, in one sentence."""
    group: Group = Group.REPORT
    components: tuple[int, ...] = ()
    """Shape of an entry."""
    per_shot: bool = False
    """Whether there is one entry per shot instead of one per beam."""
    missing: float | None = None
    """Entry for an unknown value; None: NaN, or 0 for integers and flags."""
    in_table: str = ""
    """Name of a component's column in a table, with `{}` for its axis."""
    axes: tuple[str, ...] = ()
    """Axes of the components."""

    @property
    def is_float(self) -> bool:
        """Whether entries are floating-point numbers, which can be NaN."""
        return self.dtype.startswith("f")

    @cached_property
    def missing_value(self) -> float:
        """Entry for an unknown value."""
        if self.missing is not None:
            return self.missing
        return np.nan if self.is_float else 0

    def in_rows(self, name: str) -> dict[str, Column]:
        """Columns of a table that hold this column, by name: itself, or one per component."""
        row = replace(self, per_shot=False, components=(), in_table="", axes=())
        if not self.components:
            return {name: row}
        meaning = self.meaning.removesuffix(".")
        return {self.in_table.format(axis): replace(row, meaning=f"{meaning}: {axis}.") for axis in self.axes}


def columns(declared: type) -> dict[str, Column]:
    """Columns of a dataclass by name, in the order of its fields.

    Raises:
        TypeError: a field does not have exactly one `Column`.
    """
    hints = get_type_hints(declared, include_extras=True)
    found: dict[str, Column] = {}
    for field in fields(declared):
        notes = [note for note in get_args(hints[field.name]) if isinstance(note, Column)]
        if len(notes) != 1:
            raise TypeError(f"{declared.__name__}.{field.name} needs one Column, has {len(notes)}")
        found[field.name] = notes[0]
    return found


def missing_columns(
    declared: Mapping[str, Column], known: Iterable[str], shape: tuple[int, ...]
) -> dict[str, NDArray[Any]]:
    """Arrays of missing values for the columns that are not known.

    Args:
        declared: all columns.
        known: names of columns to leave out.
        shape: (shots, beams), or whatever stands for them; columns per shot take the first axis.

    Returns:
        By name; columns of one type, shape and missing value share an array.
    """
    arrays: dict[tuple[Any, ...], NDArray[Any]] = {}
    missing: dict[str, NDArray[Any]] = {}
    for name in declared.keys() - known:
        column = declared[name]
        kind = column.dtype, column.components, column.per_shot, column.missing
        if kind not in arrays:
            leading = shape[:1] if column.per_shot else shape
            arrays[kind] = np.empty((*leading, *column.components), dtype=column.dtype)
            arrays[kind].fill(column.missing_value)  # np.full takes twice as long
        missing[name] = arrays[kind]
    return missing


def in_groups(of: Mapping[str, Column], *groups: Group) -> dict[str, Column]:
    """Columns of these groups, group by group."""
    return {name: column for group in groups for name, column in of.items() if column.group is group}


class GrowingColumns:
    """Arrays that grow in place, block by block: joining blocks at the end would need twice the memory."""

    def __init__(self) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        """Columns by name; views of them must not outlive the next `add`."""

    def add(self, block: Mapping[str, NDArray[Any]]) -> None:
        """Append rows.

        Args:
            block: the same columns in each call; shapes agree but for the first axis.
        """
        for name, rows in block.items():
            if (column := self.arrays.get(name)) is None:
                self.arrays[name] = rows.copy()
                continue
            first = len(column)
            column.resize((first + len(rows), *rows.shape[1:]), refcheck=False)
            column[first:] = rows


@lru_cache(maxsize=64)
def as_record(fields: Any) -> Any:
    """Convert a named tuple of numbers, possibly nested, to a structured array of one element."""
    return with_fields(np.array([fields], dtype=_record_type(fields)))


def _record_type(fields: Any) -> np.dtype[Any]:
    return _dtype(
        tuple((name, _field_type(value)) for name, value in zip(fields._fields, fields, strict=True))
    )


@cache
def _dtype(fields: tuple[tuple[str, np.dtype[Any]], ...]) -> np.dtype[Any]:
    """The single dtype object of all records with these fields.

    numba looks up the type of an argument by its dtype: the same object is found at once, an equal one only after a
    comparison field by field, which takes 0.7 µs in each call from Python.
    """
    return np.dtype(list(fields), align=True)


def _field_type(value: Any) -> np.dtype[Any]:
    if not isinstance(value, tuple):
        return np.dtype(type(value))
    return _record_type(value) if hasattr(value, "_fields") else np.dtype((float, len(value)))
