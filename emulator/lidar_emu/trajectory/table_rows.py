"""The part of a table that is flown: its times, and the filled cells of the columns in use."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.trajectory import Table
from lidar_emu.trajectory.csv_rows import CsvRows, read_csv
from lidar_emu.trajectory.state import Gap

S_PER_UNIT = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_ROUNDING = 1 + 1e-9
"""Tolerance for rounding: a gap of exactly the maximum length is allowed."""


class Filled(NamedTuple):
    """The k rows in which all of some columns have a value."""

    row: NDArray[np.intp]
    """(k,)"""
    knot_s: FloatArray
    """(k,) Scenario time."""
    values: FloatArray
    """(columns, k)"""


@dataclass(frozen=True)
class FlownRows:
    """Rows over scenario time, including rows outside the part flown, which shape the curves at its ends."""

    csv: CsvRows
    file_time: FloatArray
    """(n,) Time in the file's own unit and origin."""
    time_s: FloatArray
    """(n,) Time from the first instant flown."""
    duration_s: float
    maximum_gap_s: float
    bridges: bool
    """Whether longer gaps are bridged."""
    gaps: list[Gap] = field(default_factory=list)
    """Longest gap inside the part flown, for each group of columns read so far."""
    bridged: list[Gap] = field(default_factory=list)
    """All gaps longer than `maximum_gap_s`."""

    def filled(self, *names: str) -> Filled:
        """The rows in which all of `names` have a value.

        Raises:
            InputError: a column or cell cannot be used, fewer than 2 rows are filled, they do not cover the whole part
                flown, or they leave a gap of more than `maximum_gap_s` that must not be bridged.
        """
        values = np.stack([self.csv.column(name) for name in names])
        row = np.flatnonzero(~np.isnan(values).any(axis=0))
        label = " with ".join(dict.fromkeys(names))
        if len(row) < 2:
            raise InputError(self.csv.file, label, Finding(f"{len(row)} filled rows"), "fill at least 2")
        self._refuse_uncovered(label, row)
        self._note_gaps(label, row)
        return Filled(row, self.time_s[row], values[:, row])

    def _refuse_uncovered(self, label: str, row: NDArray[np.intp]) -> None:
        first, last = row[0], row[-1]
        if self.time_s[first] > 0:
            time = f"{self.file_time[first]:.12g}"
            found = Finding(f"no value before {time}")
            raise InputError(self.csv.file, label, found, f"state from_time: {time} or later")
        if self.time_s[last] < self.duration_s:
            time = f"{self.file_time[last]:.12g}"
            found = Finding(f"no value after {time}")
            raise InputError(self.csv.file, label, found, f"state to_time: {time} or earlier")

    def _note_gaps(self, label: str, row: NDArray[np.intp]) -> None:
        knot_s = self.time_s[row]
        flown = (knot_s[1:] > 0) & (knot_s[:-1] < self.duration_s)
        length_s = np.where(flown, np.diff(knot_s), 0.0)
        longest = int(np.argmax(length_s))
        too_long = np.flatnonzero(length_s > self.maximum_gap_s * _ROUNDING)
        if too_long.size and not self.bridges:
            time = f"{self.file_time[row[longest]]:.12g}"
            found = Finding(f"no value for {length_s[longest]:.6g} s after {time}")
            remedy = f"state a maximum_gap_s above {self.maximum_gap_s:g}, or longer_gaps: bridge"
            raise InputError(self.csv.file, label, found, remedy)
        self.gaps.append(Gap(label, float(knot_s[longest]), float(length_s[longest])))
        self.bridged.extend(Gap(label, float(knot_s[k]), float(length_s[k])) for k in too_long)


def read_flown(part: Table) -> FlownRows:
    """Read the file and place its rows in scenario time."""
    csv = read_csv(part.file)
    file_time = csv.column(part.time.column)
    _refuse_disordered(csv, part.time.column, file_time)
    begin, end = _flown_times(part, file_time)
    unit_s = S_PER_UNIT[part.time.unit]
    return FlownRows(
        csv=csv,
        file_time=file_time,
        # Subtracted before scaling, so that a count of nanoseconds since 1970 loses no digits.
        time_s=(file_time - begin) * unit_s,
        duration_s=(end - begin) * unit_s,
        maximum_gap_s=part.maximum_gap_s,
        bridges=part.longer_gaps == "bridge",
    )


def _refuse_disordered(csv: CsvRows, name: str, file_time: FloatArray) -> None:
    if len(file_time) < 2:
        raise InputError(csv.file, None, Finding(f"{len(file_time)} rows"), "use at least 2")
    empty = np.flatnonzero(np.isnan(file_time))
    if empty.size:
        raise csv.refusal(empty[0], name, Finding("an empty cell"), "state a time in every row")
    falling = np.flatnonzero(np.diff(file_time) <= 0)
    if falling.size:
        before, after = file_time[falling[0]], file_time[falling[0] + 1]
        raise csv.refusal(falling[0] + 1, name, float(after), f"must be above {before:.12g}, the time before")


def _flown_times(part: Table, file_time: FloatArray) -> tuple[float, float]:
    """First and last instant flown, in the file's own time."""
    first, last = float(file_time[0]), float(file_time[-1])
    for key, given in (("from_time", part.from_time), ("to_time", part.to_time)):
        if given is not None and not first <= given <= last:
            remedy = f"must be from {first:.12g} to {last:.12g}, the times of the file"
            raise InputError(part.file, key, given, remedy)
    begin = first if part.from_time is None else part.from_time
    end = last if part.to_time is None else part.to_time
    if end <= begin:
        raise InputError(part.file, "to_time", end, f"must be above {begin:.12g}, from_time")
    return begin, end
