"""The results of a campaign as table rows, CSV and plot columns."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lidar_emu.campaign.statistics import AXES, ERRORS, LEVELS, BandStatistics, IntervalEstimate
from lidar_emu.campaign.tables import read_table
from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.report.campaign_plot import CampaignColumn

_LABELS = {
    "altitude_m": "altitude (m)",
    "true_incidence_deg": "incidence angle (°)",
    "range_error_m": "range error (m)",
    "speed_error_mps": "closing speed error (mm/s)",
}
_SCALES = {"speed_error_mps": 1e3}
"""Shown value of one SI unit, by the name of the error."""
_ENDS = ("", "_low", "_high")


def rows(bands: Sequence[BandStatistics]) -> list[dict[str, float | int | str]]:
    """Build a row per band, with a column per estimate and two more for its confidence interval."""
    return [_row(band) for band in bands]


def _row(band: BandStatistics) -> dict[str, float | int | str]:
    row: dict[str, float | int | str] = {
        "axis": band.axis,
        "low": band.low,
        "high": band.high,
        "runs": band.runs,
        "expected": band.expected,
        **_ended("dropout", band.dropout),
    }
    for error in ERRORS:
        for level, estimate in zip(LEVELS, band.quantiles[error.name], strict=True):
            row |= _ended(f"{error.name}_p{100 * level:02.0f}", estimate)
    return row


def _ended(name: str, estimate: IntervalEstimate) -> dict[str, float]:
    return {name + end: value for end, value in zip(_ENDS, estimate, strict=True)}


def write_statistics(bands: Sequence[BandStatistics], path: Path) -> None:
    """Write a CSV file; unknown values are empty cells.

    Raises:
        RunError: writing failed.
    """
    table = rows(bands)
    text = io.StringIO(newline="")
    if table:
        writer = csv.DictWriter(text, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(
            {key: "" if value != value else value for key, value in row.items()} for row in table
        )
    with whole_file(path) as file:
        file.write(text.getvalue().encode())


def plot_columns(bands: Sequence[BandStatistics]) -> list[CampaignColumn]:
    """Build the columns for `report.campaign_plot`."""
    return [_column(axis.name, [band for band in bands if band.axis == axis.name]) for axis in AXES]


def _column(axis: str, bands: Sequence[BandStatistics]) -> CampaignColumn:
    return CampaignColumn(
        label=_LABELS[axis],
        logarithmic=axis == "altitude_m",
        edge=np.array([(band.low, band.high) for band in bands]).reshape(-1, 2),
        dropout=_estimates([band.dropout for band in bands]),
        quantiles={
            _LABELS[error.name]: _SCALES.get(error.name, 1.0)
            * np.stack(
                [_estimates([band.quantiles[error.name][i] for band in bands]) for i in range(len(LEVELS))]
            )
            for error in ERRORS
        },
    )


def _estimates(estimates: Sequence[IntervalEstimate]) -> FloatArray:
    return np.array(estimates, dtype=np.float64).reshape(-1, len(_ENDS))


def failures(folder: Path) -> dict[str, int]:
    """Count failed runs by reason, the most frequent first.

    Raises:
        InputError: a file of the folder is damaged.
    """
    reasons = Counter[str]()
    for path in sorted((folder / "runs").glob("part-*.parquet")):
        failed = read_table(path, ["failed"])["failed"].to_pylist()
        reasons.update(reason for reason in failed if reason is not None)
    return dict(reasons.most_common())
