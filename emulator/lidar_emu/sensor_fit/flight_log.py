"""A log of a lidar: time, range and closing speed of each shot and beam, from a CSV file or a recording."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError, listed, nearest
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.trajectory.table import CsvRows, read_csv

LEAST_SHOTS = 100
VALUES = ("range_m", "closing_speed_mps", "snr_db", "true_range_m", "true_closing_speed_mps")
VALIDITY = {"range_valid": "range_m", "speed_valid": "closing_speed_mps"}
TIMES = {"time_s": 1.0, "time_ns": 1e-9}
MOTION = (
    *(f"velocity_{axis}_mps" for axis in ("east", "north", "up")),
    *(f"site_from_body_{part}" for part in "wxyz"),
    *(f"body_rate_{axis}_radps" for axis in "xyz"),
)
COLUMNS = (*TIMES, "shot", "beam", *VALUES, *VALIDITY, *MOTION, "pattern")
"""What a column of a CSV file can be, by the names of the project's own tables."""


class FlightLog(NamedTuple):
    """A log, arrays of (shots, beams); NaN where there is no value, and in columns that the log does not have."""

    name: str
    time_s: FloatArray
    """From the first shot; ascending along each beam, never NaN."""
    range_m: FloatArray
    closing_speed_mps: FloatArray
    snr_db: FloatArray
    true_range_m: FloatArray
    true_closing_speed_mps: FloatArray
    motion: Mapping[str, FloatArray] = {}
    """`MOTION` of the vehicle, and `pattern` if the log has it; empty where the log does not have all of `MOTION`."""

    @property
    def has_truth(self) -> bool:
        return bool(np.isfinite(self.true_range_m).any())


def read_log(path: Path, named: Mapping[str, str]) -> FlightLog:
    """Read a log.

    Args:
        path: a CSV file with a line of names, or a recording (`.mcap`).
        named: the file's own names of `COLUMNS`; `*` stands for the beam where each beam has a column.

    Raises:
        InputError: it cannot be read, lacks time or range, its time does not ascend, or it is too short.
    """
    if path.suffix != ".mcap":
        return _checked(path, _tabled(path, named))
    from lidar_emu.recording.read import read_recording

    flown = read_recording(path).measurement()
    table = flown.table((*MOTION, "pattern"))
    motion = {
        key: np.asarray(each, dtype=np.float64).reshape(flown.time_s.shape) for key, each in table.items()
    }
    columns = {key: getattr(flown, key) for key in ("time_s", *VALUES, *VALIDITY)}
    return _checked(path, columns | motion)


def _tabled(path: Path, named: Mapping[str, str]) -> dict[str, FloatArray]:
    """Columns (shots, beams) of a table with a row per shot and beam, or with columns for each beam."""
    table = read_csv(str(path))
    found = _matches(path, table.header, named)
    beams = len(found["range_m"])
    for key, names in found.items():
        if len(names) not in (1, beams):
            remedy = f"there must be one, or one for each of the {beams} beams"
            raise InputError(str(path), key, Finding(f"{len(names)} columns"), remedy)
    read = {key: np.stack([_numbers(table, name) for name in names], axis=1) for key, names in found.items()}
    if "beam" in read:
        return _by_shot(path, read)
    return {key: np.broadcast_to(values, (len(table.rows), beams)) for key, values in read.items()}


def _matches(path: Path, header: list[str], named: Mapping[str, str]) -> dict[str, list[str]]:
    """The file's columns for each of `COLUMNS` that it has, one or one a beam."""
    found: dict[str, list[str]] = {}
    for key in COLUMNS:
        pattern = named.get(key, key if key in header else f"{key}_*")
        expression = re.escape(pattern).replace(r"\*", ".+")
        if names := [name for name in header if re.fullmatch(expression, name)]:
            found[key] = names
        elif key in named:
            near = nearest(pattern, header)
            remedy = f"did you mean {near}?" if near else f"the file has {listed(header)}"
            raise InputError(str(path), key, Finding(f"no column {pattern}"), remedy)
    for wanted in (TIMES, ("range_m",)):
        if not any(key in found for key in wanted):
            name = " or ".join(wanted)
            remedy = f"name it with --column {next(iter(wanted))}=NAME; the file has {listed(header)}"
            raise InputError(str(path), None, Finding(f"no column {name}"), remedy)
    return found


def _numbers(table: CsvRows, name: str) -> FloatArray:
    if table.header.count(name) > 1:
        raise InputError(table.file, name, Finding("two columns of that name"), "name each column once")
    # As pandas writes validity.
    known = {"": "nan", "true": "1", "false": "0"}
    cells = [cell.lower() for cell in table.cells(table.header.index(name))]
    try:
        values = np.array([float(known.get(cell, cell)) for cell in cells])
    except ValueError as error:
        raise InputError(table.file, name, Finding(str(error)), "cells must be numbers, or empty") from None
    return np.where(np.isfinite(values), values, np.nan)


def _by_shot(path: Path, read: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Columns (shots, beams) from those (rows, 1) of a table with a row per shot and beam."""
    time = next(read[key] for key in TIMES if key in read)
    shots, row = np.unique(read.get("shot", time)[:, 0], return_inverse=True)
    beams, column = np.unique(read["beam"][:, 0], return_inverse=True)
    if len(shots) * len(beams) > 4 * len(row):
        remedy = "rows of one shot must share its number in `shot`, or its time"
        raise InputError(str(path), None, Finding(f"{len(shots)} shots of {len(beams)} beams"), remedy)
    laid = {key: np.full((len(shots), len(beams)), np.nan) for key in read}
    for key, values in read.items():
        laid[key][row, column] = values[:, 0]
    return laid


def _checked(path: Path, columns: Mapping[str, FloatArray]) -> FlightLog:
    key = next(key for key in TIMES if key in columns)
    fired = np.isfinite(columns[key]).any(axis=1)
    if fired.sum() < LEAST_SHOTS:
        found = Finding(f"{fired.sum()} shots with a time")
        raise InputError(str(path), None, found, f"a fit needs {LEAST_SHOTS} or more")
    # Nanoseconds since 1970 leave 0.2 µs in a float; the difference loses nothing more.
    time_s = (columns[key][fired] - np.nanmin(columns[key])) * TIMES[key]
    # A beam that did not fire has no time of its own.
    time_s = np.where(np.isnan(time_s), np.nanmean(time_s, axis=1, keepdims=True), time_s)
    if (back := np.flatnonzero((np.diff(time_s, axis=0) <= 0).any(axis=1))).size:
        found = Finding(f"time does not ascend after shot {back[0]}")
        raise InputError(str(path), None, found, "sort the log by time, without repeated rows")
    missing = np.full(time_s.shape, np.nan)
    values = {key: columns[key][fired] if key in columns else missing for key in VALUES}
    for flag, key in VALIDITY.items():
        # Logs without flags write 0 where there is no value.
        valid = columns[flag][fired] == 1 if flag in columns else values[key] != 0
        values[key] = np.where(valid & np.isfinite(values[key]), values[key], np.nan)
    if not np.isfinite(values["range_m"]).any():
        raise InputError(str(path), "range_m", Finding("no valid range"), "use a log with valid ranges")
    has_motion = all(key in columns for key in MOTION)
    motion = {key: columns[key][fired] for key in (*MOTION, "pattern") if has_motion and key in columns}
    return FlightLog(path.name, time_s, **values, motion=motion)
