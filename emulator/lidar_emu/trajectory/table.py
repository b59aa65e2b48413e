"""A trajectory from a table: curves through its columns."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from itertools import islice
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError, reason_of
from lidar_emu.files import check_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.section import LIMITS, Limit
from lidar_emu.scenario.trajectory import AngleColumn, LengthColumn, QuaternionColumns, RateColumns, Table
from lidar_emu.trajectory.curves import (
    LEVEL,
    AttitudeCurve,
    Curve,
    Curves,
    EulerAttitude,
    QuaternionAttitude,
    hermite,
    through,
)
from lidar_emu.trajectory.profile import Gap, Trajectory, VehicleState

_READABLE = "use a readable CSV file"
_MOST_BYTES, _MOST_ROWS = 1_000_000_000, 10_000_000
"""Almost three hours at 1 kHz."""


@dataclass(frozen=True)
class CsvRows:
    """A file's header and rows, as text."""

    file: str
    header: list[str]
    lines: list[int]
    """Line number of each row in the file."""
    rows: list[list[str]]

    def column(self, name: str) -> FloatArray:
        """Numbers (n,) of a column; NaN where a cell is empty.

        Raises:
            InputError: the header has no such column or has it twice, or a cell is not a finite number.
        """
        if self.header.count(name) != 1:
            known = ", ".join(self.header)
            raise InputError(
                self.file, "column", name, f"must be a name that the header has once, of {known}"
            )
        cells = self.cells(self.header.index(name))
        return np.array([self._number(name, *cell) for cell in zip(self.lines, cells, strict=True)])

    def cells(self, place: int) -> list[str]:
        """Texts (n,) of a column; empty where a row is shorter."""
        return [row[place] if place < len(row) else "" for row in self.rows]

    def refusal(self, row: int, name: str, value: object, remedy: str) -> InputError:
        """Error for an unusable cell."""
        return InputError(self.file, f"line {self.lines[row]}, {name}", value, remedy)

    def _number(self, name: str, line: int, text: str) -> float:
        if not text:
            return np.nan
        try:
            # Python also reads 1_000.
            number = np.nan if "_" in text else float(text)
        except ValueError:
            number = np.nan
        if not isfinite(number):
            raise InputError(self.file, f"line {line}, {name}", text, "must be a finite number or empty")
        return number


def read_csv(file: str) -> CsvRows:
    """Read the header and rows of a file; blanks around cells are stripped and empty lines skipped.

    Raises:
        InputError: the file is unreadable, empty or not CSV text, or a row is longer than the header.
    """
    check_file(Path(file), _READABLE, _MOST_BYTES)
    try:
        with Path(file).open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            table = [
                (reader.line_num, [cell.strip() for cell in row]) for row in islice(reader, _MOST_ROWS + 1)
            ]
    except OSError as error:
        raise InputError(file, None, Finding(reason_of(error)), _READABLE) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(file, None, Finding(str(error)), "use CSV as UTF-8 text") from None
    if len(table) > _MOST_ROWS:
        raise InputError(file, None, Finding(f"more than {_MOST_ROWS} rows"), "split it")
    filled = [(line, row) for line, row in table if any(row)]
    if not filled:
        raise InputError(file, None, Finding("an empty file"), "write a header and at least 2 rows")
    (_, header), *body = filled
    for line, row in body:
        if any(row[len(header) :]):
            found = Finding(f"{len(row)} cells")
            raise InputError(file, f"line {line}", found, f"write {len(header)}, as in the header")
    return CsvRows(file, header, [line for line, _ in body], [row for _, row in body])


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
    unit_s = S_PER_UNIT[part.time.unit]
    _refuse_disordered(csv, part.time.column, file_time, unit_s)
    begin, end = _flown_times(part, file_time)
    return FlownRows(
        csv=csv,
        file_time=file_time,
        # Subtracted before scaling, so that a count of nanoseconds since 1970 loses no digits.
        time_s=(file_time - begin) * unit_s,
        duration_s=(end - begin) * unit_s,
        maximum_gap_s=part.maximum_gap_s,
        bridges=part.longer_gaps == "bridge",
    )


_LATEST = Limit(1e12, "s")
_LEAST_STEP_S = 1e-12
"""Rates from values that are closer in time may exceed float64."""


def _refuse_disordered(csv: CsvRows, name: str, file_time: FloatArray, unit_s: float) -> None:
    if len(file_time) < 2:
        raise InputError(csv.file, None, Finding(f"{len(file_time)} rows"), "use at least 2")
    empty = np.flatnonzero(np.isnan(file_time))
    if empty.size:
        raise csv.refusal(empty[0], name, Finding("an empty cell"), "state a time in every row")
    _refuse_beyond(csv, np.arange(len(file_time)), name, file_time, unit_s, _LATEST)
    falling = np.flatnonzero(np.diff(file_time) * unit_s < _LEAST_STEP_S)
    if falling.size:
        before, after = file_time[falling[0]], file_time[falling[0] + 1]
        remedy = f"must be above {before:.12g}, the time before, by at least {_LEAST_STEP_S:g} s"
        raise csv.refusal(falling[0] + 1, name, float(after), remedy)


def _flown_times(part: Table, file_time: FloatArray) -> tuple[float, float]:
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


M_PER_UNIT = {"m": 1.0, "km": 1e3, "ft": 0.3048}
MPS_PER_UNIT = {"m/s": 1.0, "km/s": 1e3, "km/h": 1 / 3.6, "ft/s": 0.3048}
RAD_PER_UNIT = {"deg": np.pi / 180, "rad": 1.0}
RADPS_PER_UNIT = {"deg/s": np.pi / 180, "rad/s": 1.0}
QUATERNION_TOLERANCE = 1e-3


class TableTrajectory(Trajectory):
    """Curves of position, attitude and, where the table has them, body rates."""

    def __init__(self, part: Table) -> None:
        rows = read_flown(part)
        self._coordinates = Curves(
            [_coordinate(rows, column) or LEVEL for column in (part.east, part.north, part.up)]
        )
        self._attitude = _attitude(rows, part)
        self._body_rates = None if part.body_rates is None else _body_rates(rows, part.body_rates)
        self.duration_s = rows.duration_s
        self.gaps = tuple(sorted(rows.gaps, key=lambda gap: -gap.length_s))
        self.bridged = tuple(sorted(rows.bridged, key=lambda gap: gap.start_s))

    def state(self, time_s: FloatArray) -> VehicleState:
        position_m, velocity_mps, acceleration_mps2 = self._coordinates.at(time_s)
        site_from_body, body_rate_radps, angular_acceleration_radps2 = self._attitude.at(time_s)
        if self._body_rates is not None:
            body_rate_radps, angular_acceleration_radps2, _ = self._body_rates.at(time_s)
        return VehicleState(
            time_s=time_s,
            position_site_m=position_m,
            velocity_site_mps=velocity_mps,
            acceleration_site_mps2=acceleration_mps2,
            site_from_body=site_from_body,
            body_rate_radps=body_rate_radps,
            angular_acceleration_body_radps2=angular_acceleration_radps2,
        )


def _coordinate(rows: FlownRows, column: LengthColumn | None) -> Curve | None:
    if column is None:
        return None
    unit_m = M_PER_UNIT[column.unit]
    if column.rate_column is None or column.rate_unit is None:
        row, knot_s, (length,) = rows.filled(column.column)
        _refuse_beyond(rows.csv, row, column.column, length, unit_m, LIMITS["m"])
        return through(knot_s, length * unit_m)
    row, knot_s, (length, rate) = rows.filled(column.column, column.rate_column)
    unit_mps = MPS_PER_UNIT[column.rate_unit]
    _refuse_beyond(rows.csv, row, column.column, length, unit_m, LIMITS["m"])
    _refuse_beyond(rows.csv, row, column.rate_column, rate, unit_mps, LIMITS["mps"])
    return hermite(knot_s, length * unit_m, rate * unit_mps)


def _refuse_beyond(
    csv: CsvRows, row: NDArray[np.intp], name: str, values: FloatArray, unit: float, limit: Limit
) -> None:
    """Refuse values beyond the limit of such a key in a scenario, in which one of the file is `unit`."""
    beyond = np.flatnonzero(np.abs(values) > limit.largest / unit)
    if beyond.size:
        remedy = f"must be at most {limit.largest:g} {limit.unit} in magnitude"
        raise csv.refusal(row[beyond[0]], name, float(values[beyond[0]]), remedy)


def _attitude(rows: FlownRows, part: Table) -> AttitudeCurve:
    if part.quaternion is not None:
        return _quaternions(rows, part.quaternion)
    return EulerAttitude(*(_angle(rows, column) for column in (part.yaw, part.pitch, part.roll)))


def _angle(rows: FlownRows, column: AngleColumn | None) -> Curve | None:
    """Angle in radians over time in seconds, unwrapped."""
    if column is None:
        return None
    row, knot_s, (angle,) = rows.filled(column.column)
    unit_rad = RAD_PER_UNIT[column.unit]
    _refuse_beyond(rows.csv, row, column.column, angle, np.degrees(unit_rad), LIMITS["deg"])
    return through(knot_s, np.unwrap(column.sign * unit_rad * angle))


def _quaternions(rows: FlownRows, part: QuaternionColumns) -> QuaternionAttitude:
    row, knot_s, components = rows.filled(*part.columns)
    with np.errstate(over="ignore"):
        length = np.sqrt(np.sum(components**2, axis=0))
    wrong = np.flatnonzero(np.abs(length - 1) > QUATERNION_TOLERANCE)
    if wrong.size:
        found = Finding(f"a quaternion of length {length[wrong[0]]:.6g}")
        remedy = f"state unit quaternions, within {QUATERNION_TOLERANCE:g}"
        raise rows.csv.refusal(row[wrong[0]], " ".join(part.columns), found, remedy)
    return QuaternionAttitude(knot_s, (components / length).T)


def _body_rates(rows: FlownRows, part: RateColumns) -> Curves:
    unit_radps = RADPS_PER_UNIT[part.unit]
    curves = []
    for name in part.columns:
        row, knot_s, (rate,) = rows.filled(name)
        _refuse_beyond(rows.csv, row, name, rate, np.degrees(unit_radps), LIMITS["degps"])
        curves.append(through(knot_s, unit_radps * rate))
    return Curves(curves)
