"""Columns: arrays with a row per shot and an entry per beam, each declared once with type, unit and meaning.

A dataclass declares its arrays as `Annotated[FloatArray, Column("f8", "m", "Measured range.")]`; `columns` reads the
declarations back. Allocation, tables, the schema of recordings and documents derive from them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from enum import Enum, auto
from functools import cached_property
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray


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
    """Point at the end of the measured range."""
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
