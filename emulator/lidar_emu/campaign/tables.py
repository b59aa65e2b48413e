"""The two tables of a campaign: a row per run, and a row per beam of every shot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.files import check_file, whole_file
from lidar_emu.measurement import TABLE, Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.exports import TableColumn, arrow_table
from lidar_emu.scenario.campaign import Campaign, Choice, Integer

if TYPE_CHECKING:
    import pyarrow as pa

SHARES = {"p50": 0.5, "p95": 0.95}
"""Reported quantiles of the absolute errors of a run."""


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


def write_runs(flown: Sequence[RunResult], kinds: dict[str, str], path: Path) -> None:
    """Write a table with a row per run: drawn values, reason of failure, and statistics; see `_write`."""
    columns: dict[str, TableColumn] = {
        "run": np.array([one.run for one in flown], dtype=np.int64),
        "seed": np.array([one.values["seed"] for one in flown], dtype=np.int64),
        "failed": [one.reason for one in flown],
    }
    for key, kind in kinds.items():
        drawn = [one.values[key] for one in flown]
        if kind in _NUMBERS:
            columns[key] = np.array(drawn, dtype=_NUMBERS[kind])
        else:
            columns[key] = [json.dumps(value) for value in drawn] if kind == "json" else drawn
    outcomes = [{} if one.measurement is None else _outcome(one.measurement) for one in flown]
    for name in OUTCOMES:
        columns[name] = np.array([outcome.get(name, np.nan) for outcome in outcomes])
    _write(arrow_table(columns, _COUNTS), path)


_NUMBERS = {"number": np.float64, "whole": np.int64}
_COUNTS = ("shots", "expected", "range_valid", "speed_valid")
_ERRORS = {"range_error_m": "range_m", "speed_error_mps": "closing_speed_mps"}
OUTCOMES = (*_COUNTS, *(f"{error}_abs_{share}" for error in _ERRORS for share in SHARES))
"""Columns of the table `runs` that a flight fills."""
BEAM_COLUMNS = tuple(name for name in TABLE if not name.startswith("true_beam_axis"))
"""Columns of the table `beams` beside run and altitude."""


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
        for share, level in SHARES.items():
            outcome[f"{error}_abs_{share}"] = float(np.quantile(known, level)) if known.size else np.nan
    return outcome


_BITS = {"m": 16, "m/s": 22, "m/s²": 22, "deg": 16, "dB": 10, "": 30, "rad/s": 30}
"""Binary places that values of a unit are rounded to: the digits beyond are random, and would be two thirds of a file.
A stated sigma, the yardstick of errors, has eight more."""
_BITS_OF_SIGMA = 8


def write_beams(flown: Sequence[RunResult], path: Path) -> dict[str, NDArray[Any]]:
    """Write a table with a row per shot and beam, see `_write`, and return its columns.

    They are `Measurement.table()`, run, and altitude above the site's origin, rounded. Left out are the true beam axes,
    a sixth of the table, which sensor and hit point give.
    """
    runs = [_beams(one.run, one.measurement) for one in flown if one.measurement is not None]
    columns = {name: _rounded(name, np.concatenate([run[name] for run in runs])) for name in runs[0]}
    _write(arrow_table(columns), path)
    return columns


def _beams(run: int, measurement: Measurement) -> dict[str, NDArray[Any]]:
    altitude_m: FloatArray = np.repeat(measurement.position_site_m[:, 2], measurement.beam_count)
    table = measurement.table(BEAM_COLUMNS)
    return {"run": np.full(altitude_m.size, run), "altitude_m": altitude_m, **table}


def _rounded(name: str, values: NDArray[Any]) -> NDArray[Any]:
    unit = TABLE[name].unit if name in TABLE else "m"
    if values.dtype.kind != "f" or unit not in _BITS:
        return values
    scale = 2.0 ** (_BITS[unit] + _BITS_OF_SIGMA * ("sigma" in name))
    return np.asarray(np.rint(values * scale) / scale)


def _write(table: pa.Table, path: Path) -> None:
    """Write a table atomically, with checksums; equal tables have equal bytes.

    Raises:
        InputError: the folder is missing.
        RunError: writing failed.
    """
    import pyarrow.parquet as parquet

    doubles = [field.name for field in table.schema if field.type == "double"]
    # A dictionary takes longer and saves nothing, even of values that repeat; more compression saves little.
    encoding = {"use_dictionary": False, "use_byte_stream_split": doubles}
    with whole_file(path) as file:
        parquet.write_table(
            table, file, compression="zstd", compression_level=4, write_page_checksum=True, **encoding
        )


def read_columns(path: Path, columns: Sequence[str]) -> dict[str, NDArray[Any]]:
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
        table = parquet.ParquetFile(path, page_checksum_verification=True).read(
            list(columns), use_threads=False
        )
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        raise InputError(str(path), None, Finding("a damaged file"), remedy) from None
    # Pages have checksums, the footer has none: damaged, it can give another type, or no row.
    if not len(table) or any(pa.types.is_null(of) or pa.types.is_binary(of) for of in table.schema.types):
        raise InputError(str(path), None, Finding("a damaged file"), remedy)
    missing = [name for name in columns if name not in table.column_names]
    if missing:
        raise InputError(str(path), missing[0], Finding("a missing column"), remedy)
    return {name: table[name].to_numpy() for name in columns}
