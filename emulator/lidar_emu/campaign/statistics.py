"""Errors and dropout rate of a campaign by altitude and incidence angle, with confidence intervals.

Shots of one run are not independent, since they share the drawn values. Runs are therefore assigned to groups in turn,
and the scatter between groups estimates the standard error. Errors are counted in narrow bins, so that memory does not
grow with the number of runs.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lidar_emu.campaign.tables import read_table
from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.report.statistics_plots import CampaignColumn

LEVELS = (0.05, 0.5, 0.95)
"""Reported quantiles."""
CONFIDENCE = 0.95
_GROUPS = 50
_STEP = 0.01
"""Width of a bin in the inverse hyperbolic sine of the error: one per cent of the error."""
_REACH = 20.0
_BINS = 2 * round(_REACH / _STEP)


class Axis(NamedTuple):
    """A quantity with bands, by which errors are sorted."""

    name: str
    edges: FloatArray


class Error(NamedTuple):
    """An error of a measured quantity."""

    name: str
    quantity: str
    scale: float
    """Bins below this error are equally wide, a hundredth of it; above, one per cent of the error."""


AXES = (
    Axis("altitude_m", np.array([m * 10.0**k for k in range(-1, 7) for m in (1, 1.5, 2, 3, 5, 7)])),
    Axis("true_incidence_deg", np.arange(0.0, 91.0, 5.0)),
)
ERRORS = (Error("range_error_m", "range_m", 1e-3), Error("speed_error_mps", "closing_speed_mps", 1e-5))


class IntervalEstimate(NamedTuple):
    """A value with its confidence interval; NaN where it is unknown."""

    value: float
    low: float
    high: float


class BandStatistics(NamedTuple):
    """Measurements within a band of altitude or incidence."""

    axis: str
    low: float
    high: float
    runs: int
    expected: int
    """Number of beams that fired at the ground."""
    dropout: IntervalEstimate
    """Share of expected beams without a valid range."""
    quantiles: dict[str, list[IntervalEstimate]]
    """Quantiles of valid measurements at `LEVELS`, by the name of the error."""


def campaign_statistics(folder: Path) -> list[BandStatistics]:
    """Compute the statistics of all beams in a campaign's folder, band by band, altitudes first."""
    counts = defaultdict[tuple[str, int], _Counts](_Counts)
    for beams in _files(folder):
        for axis in AXES:
            band = np.searchsorted(axis.edges, beams[axis.name], side="right") - 1
            # The last band includes its upper edge: incidence may be exactly 90 degrees.
            band[beams[axis.name] == axis.edges[-1]] -= 1
            for k in np.unique(band[(band >= 0) & (band < len(axis.edges) - 1)]).tolist():
                counts[axis.name, k].add({name: column[band == k] for name, column in beams.items()})
    return [
        counts[axis.name, k].statistics(axis.name, float(axis.edges[k]), float(axis.edges[k + 1]))
        for axis in AXES
        for k in range(len(axis.edges) - 1)
        if (axis.name, k) in counts
    ]


def _files(folder: Path) -> Iterator[dict[str, FloatArray]]:
    """Yield the expected beams of each file: band quantities, errors (NaN where invalid), and an index of the run.

    The index counts stored runs, since a campaign may store the beams of every fiftieth run only.
    """
    truths = [f"true_{error.quantity}" for error in ERRORS]
    names = ["run", "fired", "range_valid", *(axis.name for axis in AXES)]
    names += [*(error.quantity for error in ERRORS), *truths]
    before = 0
    for path in sorted((folder / "beams").glob("part-*.parquet")):
        table = read_table(path, names)
        columns = {name: np.asarray(table[name].to_numpy(), dtype=np.float64) for name in names}
        runs, place = np.unique(columns["run"], return_inverse=True)
        columns["run"] = (before + place).astype(np.float64)
        before += len(runs)
        expected = (columns["fired"] == 1.0) & np.isfinite(columns["true_range_m"])
        for error, truth in zip(ERRORS, truths, strict=True):
            columns[error.name] = columns[error.quantity] - columns[truth]
        yield {name: column[expected] for name, column in columns.items()}


class _Counts:
    """Counts of beams and errors in one band, per group of runs."""

    def __init__(self) -> None:
        self.runs = 0
        self.expected = np.zeros(_GROUPS, dtype=np.int64)
        self.dropped = np.zeros(_GROUPS, dtype=np.int64)
        self.errors = {error.name: np.zeros((_GROUPS, _BINS), dtype=np.int64) for error in ERRORS}

    def add(self, beams: dict[str, FloatArray]) -> None:
        """Count the beams of runs that were not counted before."""
        run = beams["run"].astype(np.int64)
        self.runs += len(np.unique(run))
        group = run % _GROUPS
        self.expected += np.bincount(group, minlength=_GROUPS)
        self.dropped += np.bincount(group[beams["range_valid"] == 0.0], minlength=_GROUPS)
        for error in ERRORS:
            value = beams[error.name]
            known = np.isfinite(value)
            place = np.floor((np.arcsinh(value[known] / error.scale) + _REACH) / _STEP).astype(np.int64)
            np.add.at(self.errors[error.name], (group[known], np.clip(place, 0, _BINS - 1)), 1)

    def statistics(self, axis: str, low: float, high: float) -> BandStatistics:
        """Compute the statistics of the band from `low` to `high`."""
        return BandStatistics(
            axis,
            low,
            high,
            self.runs,
            int(self.expected.sum()),
            share(self.dropped, self.expected, self.runs),
            {e.name: [_quantile(self.errors[e.name], level, e.scale) for level in LEVELS] for e in ERRORS},
        )


def share(part: IntArray, whole: IntArray, runs: int) -> IntervalEstimate:
    """Estimate the ratio of two counts (groups,) with Wilson's interval, its trials from the scatter between groups.

    A ratio of 0 or 1 has no scatter; then each run counts as one trial.
    """
    count = int(whole.sum())
    if count == 0:
        return IntervalEstimate(math.nan, math.nan, math.nan)
    value = float(part.sum() / count)
    spread, factor = _scatter(part.astype(np.float64), whole)
    if not math.isfinite(factor):
        return IntervalEstimate(value, 0.0, 1.0)
    trials = min(count, value * (1 - value) / spread**2) if spread > 0 else float(runs)
    square = factor**2 / trials
    middle = (value + square / 2) / (1 + square)
    half = math.sqrt(value * (1 - value) * square + square**2 / 4) / (1 + square)
    return IntervalEstimate(value, max(0.0, middle - half), min(1.0, middle + half))


def _scatter(part: FloatArray, whole: IntArray) -> tuple[float, float]:
    """Compute the standard error of the ratio of two sums over groups, and Student's factor for its interval."""
    from scipy.stats import t

    groups = int((whole > 0).sum())
    if groups < 2:
        return 0.0, math.inf
    apart = part - part.sum() / whole.sum() * whole
    variance = float((apart**2).sum()) * groups / (groups - 1)
    return math.sqrt(variance) / float(whole.sum()), float(t.ppf((1 + CONFIDENCE) / 2, groups - 1))


def _quantile(counts: IntArray, level: float, scale: float) -> IntervalEstimate:
    """Estimate a quantile from counts (groups, bins) with Woodruff's interval.

    An end of the interval is NaN where the interval of the probability reaches 0 or 1.
    """
    below = np.concatenate([np.zeros((_GROUPS, 1)), np.cumsum(counts, axis=1)], axis=1)
    whole = counts.sum(axis=1)
    if not whole.any():
        return IntervalEstimate(math.nan, math.nan, math.nan)
    together = below.sum(axis=0) / whole.sum()

    def at(wanted: float) -> float:
        """Position, in bins, below which a share of all errors lies."""
        k = int(np.clip(np.searchsorted(together, wanted, side="left"), 1, _BINS))
        step = together[k] - together[k - 1]
        return k - 1 + (float((wanted - together[k - 1]) / step) if step > 0 else 0.0)

    place = at(level)
    k = min(int(place), _BINS - 1)
    spread, factor = _scatter(below[:, k] + (place - k) * (below[:, k + 1] - below[:, k]), whole)
    half = spread * factor if math.isfinite(factor) else 1.0
    ends = (at(wanted) if 0.0 < wanted < 1.0 else math.nan for wanted in (level - half, level + half))
    return IntervalEstimate(*(float(scale * np.sinh(end * _STEP - _REACH)) for end in (place, *ends)))


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
    """Build the columns for `report.statistics_plots.plot_campaign`."""
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
