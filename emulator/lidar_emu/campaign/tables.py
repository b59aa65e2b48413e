"""The two tables of a campaign: a row per run, and a row per beam of every shot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_file, whole_file
from lidar_emu.measurement import TABLE, Measurement
from lidar_emu.numerics.arrays import FloatArray, Group
from lidar_emu.scenario.campaign import Campaign, Choice, Integer

if TYPE_CHECKING:
    import pyarrow as pa

_SHARES = {"p50": 0.5, "p95": 0.95}


class RunResult(NamedTuple):
    """The measurement of a run, or the reason of its failure."""

    run: int
    values: dict[str, Any]
    measurement: Measurement | None
    reason: str | None


def column_kinds(campaign: Campaign) -> dict[str, str]:
    """Kind of each drawn key's column: `number`, `whole` number, `text`, or `json` for values of mixed types."""
    return {key: _kind(campaign.dispersions.get(key)) for key in campaign.drawn_keys}


def _kind(distribution: object) -> str:
    if isinstance(distribution, Integer):
        return "whole"
    if not isinstance(distribution, Choice):
        return "number"
    if all(isinstance(value, str) for value in distribution.of):
        return "text"
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in distribution.of)
    return "number" if numbers else "json"


def runs_table(flown: Sequence[RunResult], kinds: dict[str, str]) -> pa.Table:
    """Build a table with a row per run: drawn values, reason of failure, and statistics."""
    import pyarrow as pa

    types = {"number": pa.float64(), "whole": pa.int64(), "text": pa.string(), "json": pa.string()}
    columns = {
        "run": pa.array([one.run for one in flown], pa.int64()),
        "seed": pa.array([one.values["seed"] for one in flown], pa.int64()),
        "failed": pa.array([one.reason for one in flown], pa.string()),
    }
    for key, kind in kinds.items():
        drawn = [one.values[key] for one in flown]
        columns[key] = pa.array(
            [json.dumps(value) for value in drawn] if kind == "json" else drawn, types[kind]
        )
    outcomes = [{} if one.measurement is None else _outcome(one.measurement) for one in flown]
    for name in _OUTCOMES:
        kind = pa.int64() if name in _COUNTS else pa.float64()
        columns[name] = pa.array([outcome.get(name) for outcome in outcomes], kind, from_pandas=True)
    return pa.table(columns)


_COUNTS = ("shots", "expected", "range_valid", "speed_valid")
_ERRORS = {"range_error_m": "range_m", "speed_error_mps": "closing_speed_mps"}
_OUTCOMES = (*_COUNTS, *(f"{error}_abs_{share}" for error in _ERRORS for share in _SHARES))


def _outcome(measurement: Measurement) -> dict[str, float]:
    # A valid range is expected of a beam that fired at the ground.
    at_ground = measurement.fired & np.isfinite(measurement.true_range_m)
    outcome: dict[str, float] = {
        "shots": len(measurement),
        "expected": int(at_ground.sum()),
        "range_valid": int((at_ground & measurement.range_valid).sum()),
        "speed_valid": int((at_ground & measurement.speed_valid).sum()),
    }
    for error, name in _ERRORS.items():
        difference = np.abs(getattr(measurement, name) - getattr(measurement, f"true_{name}"))
        known = difference[at_ground & np.isfinite(difference)]
        for share, level in _SHARES.items():
            outcome[f"{error}_abs_{share}"] = float(np.quantile(known, level)) if known.size else np.nan
    return outcome


def beams_table(flown: Sequence[RunResult]) -> pa.Table:
    """Build a table with a row per shot and beam: `Measurement.table()`, run, and altitude above the site's origin.

    Left out are the true beam axes, a sixth of the table, which sensor and hit point give.
    """
    import pyarrow as pa

    return pa.concat_tables(
        [_beams(one.run, one.measurement) for one in flown if one.measurement is not None]
    )


def _beams(run: int, measurement: Measurement) -> pa.Table:
    import pyarrow as pa

    altitude_m: FloatArray = np.repeat(measurement.position_site_m[:, 2], measurement.beam_count)
    table = measurement.table(name for name in TABLE if not name.startswith("true_beam_axis"))
    columns = {"run": np.full(altitude_m.size, run), "altitude_m": altitude_m, **table}
    return pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table atomically; equal tables have equal bytes.

    Raises:
        InputError: the folder is missing.
        RunError: writing failed.
    """
    import pyarrow.parquet as parquet

    with whole_file(path) as file:
        # Measured values rarely repeat: their dictionary would take half of the time and save nothing.
        repeating = [name for name in table.column_names if name in _REPEATING]
        parquet.write_table(table, file, compression="zstd", use_dictionary=repeating)


def read_table(path: Path, columns: Sequence[str]) -> pa.Table:
    """Read columns of a table of a campaign's folder.

    Raises:
        InputError: the file is damaged, has other columns, or is no regular file.
    """
    import pyarrow as pa
    import pyarrow.parquet as parquet

    flown = path.parent.parent / "runs" / path.name
    remedy = f"name a file that lidar-emu campaign wrote; it flies these runs again once {flown} is deleted"
    check_file(path, remedy)
    try:
        # One thread: the files are small, and a pool of threads for each costs more than it saves.
        table = parquet.read_table(path, columns=list(columns), use_threads=False)
    except (pa.ArrowException, OSError):
        raise InputError(str(path), None, Finding("a damaged file"), remedy) from None
    missing = [name for name in columns if name not in table.column_names]
    if missing:
        raise InputError(str(path), missing[0], Finding("a missing column"), remedy)
    return table


_REPEATING = {
    *("run", "beam", "reason", "segments", "returns", "second_reason", "pattern", "beam_angle_deg"),
    *("true_object", "true_peak_source"),
    *("beam_axis_body_x", "beam_axis_body_y", "beam_axis_body_z"),
    *(name for name, column in TABLE.items() if column.group is Group.VEHICLE),
}
