"""Measurements as one row of numbers a shot for each type of column, for kernels and for copies at little cost."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from math import prod
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.measurement import COLUMNS, Measurement
from lidar_emu.numerics.kernels import kernel

GROUPS = tuple(dict.fromkeys(column.dtype for column in COLUMNS.values()))
"""Types of columns."""

Rows = tuple[NDArray[Any], ...]
"""For each of `GROUPS` an array (shots, n): the columns of this type, one after another."""

columns_of = attrgetter(*COLUMNS)
"""All columns of a measurement, in order."""


class Place(NamedTuple):
    """Where a column is."""

    group: int
    first: int
    end: int
    shape: tuple[int, ...]
    """Shape of a shot's entry."""


@cache
def places(beams: int) -> dict[str, Place]:
    """Places of all columns in the rows of shots of `beams` beams."""
    found, sizes = {}, [0] * len(GROUPS)
    for name, column in COLUMNS.items():
        group = GROUPS.index(column.dtype)
        shape = column.components if column.per_shot else (beams, *column.components)
        first = sizes[group]
        sizes[group] += prod(shape)
        found[name] = Place(group, first, sizes[group], shape)
    return found


@cache
def _sizes(beams: int) -> tuple[int, ...]:
    return tuple(
        max(place.end for place in places(beams).values() if place.group == k) for k in range(len(GROUPS))
    )


def empty_rows(shots: int, beams: int) -> Rows:
    """Rows for `pack` to fill."""
    return tuple([np.empty((shots, n), dtype) for n, dtype in zip(_sizes(beams), GROUPS, strict=True)])


def _packing() -> Any:
    """A kernel (columns, rows) that fills the rows. Columns have several types, so that no loop can run over them."""
    ends = [f"a{g}" for g in range(len(GROUPS))]
    lines = ["def pack(columns, rows):", " for s in range(rows[0].shape[0]):", f"  {' = '.join(ends)} = 0"]
    for k, column in enumerate(COLUMNS.values()):
        end, index, indent = ends[GROUPS.index(column.dtype)], "s", "  "
        if not column.per_shot:
            lines.append(f"{indent}for b in range(columns[{k}].shape[1]):")
            index, indent = f"{index}, b", f"{indent} "
        if column.components:
            lines.append(f"{indent}for j in range({column.components[0]}):")
            index, indent = f"{index}, j", f"{indent} "
        lines.append(f"{indent}rows[{end[1:]}][s, {end}] = columns[{k}][{index}]")
        lines.append(f"{indent}{end} += 1")
    scope: dict[str, Any] = {"__name__": __name__}
    exec("\n".join(lines), scope)
    return kernel(outermost=True)(scope["pack"])


pack: Any = _packing()


class PackedMeasurement(Measurement):
    """Shots whose columns are views of rows, made when they are first read."""

    rows: Rows | None = None
    """None where columns were replaced."""
    _places: Mapping[str, Place] = MappingProxyType({})

    @classmethod
    def of(cls, rows: Rows, beams: int) -> Self:
        """Shots of `beams` beams in these rows."""
        packed = cls.__new__(cls)
        vars(packed).update(rows=rows, _places=places(beams))
        return packed

    def __len__(self) -> int:
        return super().__len__() if self.rows is None else len(self.rows[0])

    def __getattr__(self, name: str) -> Any:
        place = self._places.get(name)
        if place is None or self.rows is None:
            raise AttributeError(name)
        rows = self.rows[place.group]
        column = rows[:, place.first : place.end].reshape(len(rows), *place.shape)
        vars(self)[name] = column
        return column


def packed(measurement: Measurement) -> Rows:
    """The rows of a measurement."""
    if isinstance(measurement, PackedMeasurement) and measurement.rows is not None:
        return measurement.rows
    rows = empty_rows(*measurement.fired.shape)
    columns = columns_of(measurement)
    # In the layout for which kernels are built.
    pack(tuple([column if column.flags.carray else column.copy() for column in columns]), rows)
    return rows
