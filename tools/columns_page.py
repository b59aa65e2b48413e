"""The page docs/columns.md: every column of a measurement with its type, unit, place and meaning."""

from __future__ import annotations

from collections.abc import Iterator

from lidar_emu.measurement import COLUMNS, IN_TABLE, TABLE
from lidar_emu.numerics.arrays import Column, Group

_INTRODUCTION = """\
# The columns of a measurement

`lidar_emu.simulate` and `recording.measurement()` return a `Measurement`, whose arrays are listed here. The same names
are the columns of `simulate --out`, of a report's export and of a campaign's `beams` (without `true_beam_axis_*`), and
the keys of `listen --json` and of a recording's `/measurement` and `/truth`. They are declared in
`lidar_emu/measurement.py` and `lidar_emu/receiver/returns.py`; `make docs` writes this page.

Missing values are NaN in arrays and `.npz`, empty cells in CSV, and null in Parquet, JSON and recordings. A closing
speed is positive toward the ground. The site frame has its axes east, north and up, in metres from the site's origin;
the body frame is x forward, y right, z down. In a table each beam repeats the vehicle's columns, which apply at the
first beam's time of validity.

| column | type | shape | unit | table | recording | packet | meaning |
|---|---|---|---|---|---|---|---|
"""

_TYPES = {"f8": "float64", "i8": "int64", "?": "bool", "i1": "int8", "i2": "int16", "u1": "uint8"}

_NOT_SENT = {"range_degrees_of_freedom"}
"""What the default interface has no field for."""


def markdown() -> str:
    """Write the page as Markdown."""
    return _INTRODUCTION + "".join(f"| {' | '.join(cells)} |\n" for cells in _rows())


def _rows() -> Iterator[tuple[str, ...]]:
    for name, column in {**TABLE, **COLUMNS}.items():
        yield (
            f"`{name}`",
            _TYPES[column.dtype],
            _shape(name, column),
            column.unit,
            "yes" if name in TABLE else "",
            _recorded(name, column),
            "yes" if column.group in (Group.POINTING, Group.REPORT) and name not in _NOT_SENT else "",
            column.meaning,
        )


def _recorded(name: str, column: Column) -> str:
    """Topic of a recording that has the column, or the form in which it has it."""
    if column.group not in (Group.TRUTH, Group.VEHICLE):
        return f"as `{column.in_table.format('*')}`" if column.components else "`/measurement`"
    array, component = IN_TABLE.get(name, (name, None))
    return "`/truth`" if component is None else f"in `{array}`"


def _shape(name: str, column: Column) -> str:
    if name not in COLUMNS and name != "time_s":
        return "(rows,)"
    axes = ("shots",) if column.per_shot else ("shots", "beams")
    shape = ", ".join((*axes, *map(str, column.components)))
    return f"({shape},)" if len(axes) + len(column.components) == 1 else f"({shape})"


if __name__ == "__main__":
    print(markdown(), end="")
