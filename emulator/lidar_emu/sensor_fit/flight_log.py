"""A log of a lidar: time, range and closing speed of each shot and beam, from a CSV file or a recording."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError, listed, nearest
from lidar_emu.files import read_bytes
from lidar_emu.numerics.arrays import FloatArray

MOST_BYTES = 1_000_000_000
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

    @property
    def period_s(self) -> float:
        return float(np.median(np.diff(self.time_s[:, 0])))


def read_log(path: Path, named: Mapping[str, str]) -> FlightLog:
    """Read a log.

    Args:
        path: a CSV file with a line of names, or a recording (`.mcap`).
        named: the file's own names of `COLUMNS`; `*` stands for the beam where each beam has a column.

    Raises:
        InputError: it cannot be read, lacks time or range, its time does not ascend, or it is too short.
    """
    if path.suffix == ".mcap":
        columns = _recorded(path)
    else:
        table = _table(path)
        found = _matches(path, table, named)
        columns = _by_row(path, table, found) if "beam" in found else _by_column(path, table, found)
    return _checked(path, columns)


def _recorded(path: Path) -> dict[str, FloatArray]:
    from lidar_emu.recording.read import read_recording

    flown = read_recording(path).measurement()
    table = flown.table((*MOTION, "pattern"))
    motion = {
        key: np.asarray(each, dtype=np.float64).reshape(flown.time_s.shape) for key, each in table.items()
    }
    return {"time_s": flown.time_s, **{key: getattr(flown, key) for key in (*VALUES, *VALIDITY)}, **motion}


def _table(path: Path) -> dict[str, list[str]]:
    text = read_bytes(path, MOST_BYTES, "use a CSV file with a line of names, or a recording")
    try:
        rows = [row for row in csv.reader(text.decode("utf-8-sig").splitlines(), strict=True) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), None, Finding(f"not CSV ({error})"), "use a CSV file") from None
    widths = {len(row) for row in rows}
    if len(rows) < 2 or len(widths) > 1:
        found = Finding("no rows" if len(rows) < 2 else f"rows of {min(widths)} to {max(widths)} cells")
        raise InputError(str(path), None, found, "use a CSV file with a line of names and rows as long as it")
    return {name.strip(): list(cells) for name, *cells in zip(*rows, strict=True)}


def _matches(path: Path, table: Mapping[str, list[str]], named: Mapping[str, str]) -> dict[str, list[str]]:
    """The file's columns for each of `COLUMNS` that it has, one or one a beam."""
    found: dict[str, list[str]] = {}
    for key in COLUMNS:
        patterns = [named[key]] if key in named else [key, f"{key}_*"]
        for pattern in patterns:
            expression = re.escape(pattern).replace(r"\*", ".+")
            if names := [name for name in table if re.fullmatch(expression, name)]:
                found[key] = names
                break
        else:
            if key in named:
                near = nearest(named[key], table)
                remedy = f"did you mean {near}?" if near else f"the file has {listed(table)}"
                raise InputError(str(path), key, Finding(f"no column {named[key]}"), remedy)
    for wanted in (TIMES, ("range_m",)):
        if not any(key in found for key in wanted):
            name = " or ".join(wanted)
            remedy = f"name it with --column {next(iter(wanted))}=NAME; the file has {listed(table)}"
            raise InputError(str(path), None, Finding(f"no column {name}"), remedy)
    return found


def _numbers(path: Path, name: str, cells: Sequence[str]) -> FloatArray:
    known = {"": np.nan, "true": 1.0, "false": 0.0}
    try:
        return np.array(
            [known[cell] if (cell := each.strip().lower()) in known else float(cell) for each in cells]
        )
    except ValueError as error:
        raise InputError(str(path), name, Finding(str(error)), "cells must be numbers, or empty") from None


def _by_row(
    path: Path, table: Mapping[str, list[str]], found: Mapping[str, list[str]]
) -> dict[str, FloatArray]:
    """Columns of a table with a row per shot and beam."""
    read = {key: _numbers(path, names[0], table[names[0]]) for key, names in found.items()}
    time_key = next(key for key in TIMES if key in read)
    shots, row = np.unique(read.get("shot", read[time_key]), return_inverse=True)
    beams, column = np.unique(read["beam"], return_inverse=True)
    if len(shots) * len(beams) > 4 * len(row):
        remedy = "rows of one shot must share its number in `shot`, or its time"
        raise InputError(str(path), None, Finding(f"{len(shots)} shots of {len(beams)} beams"), remedy)

    def pivot(values: FloatArray) -> FloatArray:
        laid = np.full((len(shots), len(beams)), np.nan)
        laid[row, column] = values
        return laid

    return _in_seconds({key: pivot(values) for key, values in read.items() if key not in ("shot", "beam")})


def _by_column(
    path: Path, table: Mapping[str, list[str]], found: Mapping[str, list[str]]
) -> dict[str, FloatArray]:
    """Columns of a table with a row per shot, and columns for each beam."""
    beams = len(found["range_m"])
    read = {}
    for key, names in found.items():
        if len(names) not in (1, beams):
            remedy = f"there must be one, or one for each of the {beams} beams"
            raise InputError(str(path), key, Finding(f"{len(names)} columns"), remedy)
        laid = np.stack([_numbers(path, name, table[name]) for name in names], axis=1)
        read[key] = np.broadcast_to(laid, (len(laid), beams))
    return _in_seconds(read)


def _in_seconds(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
    key = next(key for key in TIMES if key in columns)
    # Nanoseconds since 1970 leave 0.2 µs in a float; the difference loses nothing more.
    first = columns[key].min(where=np.isfinite(columns[key]), initial=np.inf)
    columns["time_s"] = (columns[key] - first) * TIMES[key]
    return columns


def _checked(path: Path, columns: Mapping[str, FloatArray]) -> FlightLog:
    # A beam that did not fire has no time of its own.
    fired = np.isfinite(columns["time_s"]).any(axis=1)
    if not fired.any():
        raise InputError(str(path), None, Finding("no time in any row"), "use a log with times")
    shot_s = np.nanmean(columns["time_s"][fired], axis=1, keepdims=True)
    time_s = np.where(np.isfinite(columns["time_s"][fired]), columns["time_s"][fired], shot_s)
    if len(time_s) < LEAST_SHOTS:
        raise InputError(
            str(path), None, Finding(f"{len(time_s)} shots"), f"a fit needs {LEAST_SHOTS} or more"
        )
    if (back := np.flatnonzero((np.diff(time_s, axis=0) <= 0).any(axis=1))).size:
        found = Finding(f"time does not ascend after shot {back[0]}")
        raise InputError(str(path), None, found, "sort the log by time, without repeated rows")
    missing = np.full(time_s.shape, np.nan)
    values = {key: np.array(columns[key][fired]) if key in columns else missing for key in VALUES}
    for flag, key in VALIDITY.items():
        # Logs without flags write 0 where there is no value.
        valid = columns[flag][fired] == 1 if flag in columns else values[key] != 0
        values[key] = np.where(valid & np.isfinite(values[key]), values[key], np.nan)
    if not np.isfinite(values["range_m"]).any():
        raise InputError(str(path), "range_m", Finding("no valid range"), "use a log with valid ranges")
    has_motion = all(key in columns for key in MOTION)
    motion = {key: columns[key][fired] for key in (*MOTION, "pattern") if has_motion and key in columns}
    return FlightLog(path.name, time_s - time_s.min(), **values, motion=motion)
