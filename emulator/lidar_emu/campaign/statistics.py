"""Errors and dropout rate of a campaign by altitude and incidence angle, with confidence intervals.

Shots of one run are not independent, since they share the drawn values. Runs are therefore assigned to groups in turn,
and the scatter between groups estimates the standard error. Errors are counted in narrow bins, so that memory does not
grow with the number of runs.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.files import whole_file
from lidar_emu.numerics.arrays import FloatArray, IntArray

if TYPE_CHECKING:
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


TALLIED = (
    *("run", "fired", "range_valid", *(axis.name for axis in AXES)),
    *(name for error in ERRORS for name in (error.quantity, f"true_{error.quantity}")),
)
"""Columns of the table `beams` that `tally_beams` needs."""
_SIZES = {"runs": 1, "expected": 1, "dropped": 1} | {error.name: _BINS for error in ERRORS}
"""Cells of a group and band, by what is counted."""


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


Tally = dict[tuple[str, str], tuple[NDArray[np.int32], NDArray[np.int32]]]
"""Counts of some runs, by axis and what is counted: cells of an array of `CampaignCounts`, and the count in each."""


def tally_beams(beams: Mapping[str, NDArray[Any]], beams_every: int) -> Tally:
    """Count beams by band and group of runs, and their errors also by bin.

    Args:
        beams: columns of the table `beams`, of whole runs; NaN where a value is missing.
        beams_every: beams are stored for every nth run.
    """
    expected = beams["fired"] & np.isfinite(beams["true_range_m"])
    run, valid = beams["run"][expected] // beams_every, beams["range_valid"][expected]
    bins = {error.name: _bins(error, beams)[expected] for error in ERRORS}
    cells: dict[tuple[str, str], IntArray] = {}
    for axis in AXES:
        value, bands = beams[axis.name][expected], len(axis.edges) - 1
        band = np.searchsorted(axis.edges, value, side="right") - 1
        # The last band includes its upper edge: incidence may be exactly 90 degrees.
        band[value == axis.edges[-1]] -= 1
        inside = (band >= 0) & (band < bands)
        run_and_band = run * bands + band
        cell = run_and_band % (_GROUPS * bands)
        cells[axis.name, "runs"] = np.unique(run_and_band[inside]) % (_GROUPS * bands)
        cells[axis.name, "expected"] = cell[inside]
        cells[axis.name, "dropped"] = cell[inside & ~valid]
        for name, place in bins.items():
            known = inside & (place >= 0)
            cells[axis.name, name] = cell[known] * _BINS + place[known]
    return {key: _counted(those.astype(np.int32)) for key, those in cells.items()}


def _counted(cells: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    which, counts = np.unique(cells, return_counts=True)
    return which, counts.astype(np.int32)


def _bins(error: Error, beams: Mapping[str, NDArray[Any]]) -> IntArray:
    """Bin of each error, -1 where it is unknown."""
    value = beams[error.quantity] - beams[f"true_{error.quantity}"]
    place = np.clip(np.floor((np.arcsinh(value / error.scale) + _REACH) / _STEP), 0, _BINS - 1)
    return np.where(np.isfinite(value), place, -1).astype(np.int64)


class CampaignCounts:
    """Counts of all runs of a campaign, whatever the order in which they are added."""

    def __init__(self) -> None:
        self.reasons = Counter[str]()
        """Number of failed runs by reason."""
        self._counts = {
            (axis.name, counted): np.zeros((_GROUPS, len(axis.edges) - 1, size), dtype=np.int32)
            for axis in AXES
            for counted, size in _SIZES.items()
        }

    def add(self, reasons: Iterable[str], tally: Tally) -> None:
        """Add runs that were not added before: the reasons of failed ones, and the counts of the others."""
        self.reasons.update(reasons)
        for key, (cells, counts) in tally.items():
            self._counts[key].reshape(-1)[cells] += counts

    def statistics(self) -> list[BandStatistics]:
        """Compute the statistics of all bands that beams hit, altitudes first."""
        return [
            self._band(axis, k)
            for axis in AXES
            for k in np.flatnonzero(self._counts[axis.name, "runs"].any(axis=(0, 2))).tolist()
        ]

    def _band(self, axis: Axis, k: int) -> BandStatistics:
        counts = {counted: self._counts[axis.name, counted][:, k].astype(np.int64) for counted in _SIZES}
        runs, expected, dropped = (counts[counted][:, 0] for counted in ("runs", "expected", "dropped"))
        return BandStatistics(
            axis.name,
            float(axis.edges[k]),
            float(axis.edges[k + 1]),
            int(runs.sum()),
            int(expected.sum()),
            share(dropped, expected, int(runs.sum())),
            {error.name: _quantiles(counts[error.name], error.scale) for error in ERRORS},
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
    from scipy.special import stdtrit

    groups = int((whole > 0).sum())
    if groups < 2:
        return 0.0, math.inf
    apart = part - part.sum() / whole.sum() * whole
    variance = float((apart**2).sum()) * groups / (groups - 1)
    return math.sqrt(variance) / float(whole.sum()), float(stdtrit(groups - 1, (1 + CONFIDENCE) / 2))


def _quantiles(counts: IntArray, scale: float) -> list[IntervalEstimate]:
    """Estimate the quantiles at `LEVELS` from counts (groups, bins) with Woodruff's interval.

    An end of the interval is NaN where the interval of the probability reaches 0 or 1.
    """
    used = np.flatnonzero(counts.any(axis=0))
    if not used.size:
        return [IntervalEstimate(math.nan, math.nan, math.nan)] * len(LEVELS)
    first, last = int(used[0]), int(used[-1])
    below = np.zeros((_GROUPS, last - first + 2))
    np.cumsum(counts[:, first : last + 1], axis=1, out=below[:, 1:])
    whole = counts.sum(axis=1)
    together = below.sum(axis=0) / whole.sum()

    def at(wanted: float) -> float:
        """Position, in bins, below which a share of all errors lies."""
        k = int(np.clip(np.searchsorted(together, wanted, side="left"), 1, len(together) - 1))
        step = together[k] - together[k - 1]
        return first + k - 1 + (float((wanted - together[k - 1]) / step) if step > 0 else 0.0)

    def estimate(level: float) -> IntervalEstimate:
        place = at(level)
        k = min(int(place), last)
        lower, upper = below[:, k - first], below[:, k - first + 1]
        spread, factor = _scatter(lower + (place - k) * (upper - lower), whole)
        half = spread * factor if math.isfinite(factor) else 1.0
        ends = (at(wanted) if 0.0 < wanted < 1.0 else math.nan for wanted in (level - half, level + half))
        return IntervalEstimate(*(float(scale * np.sinh(end * _STEP - _REACH)) for end in (place, *ends)))

    return [estimate(level) for level in LEVELS]


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
    row: dict[str, float | int | str] = dict(zip(band._fields[:5], band[:5], strict=True))
    row |= ended("dropout", band.dropout)
    for error in ERRORS:
        for level, estimate in zip(LEVELS, band.quantiles[error.name], strict=True):
            row |= ended(f"{error.name}_p{100 * level:02.0f}", estimate)
    return row


def ended(name: str, estimate: IntervalEstimate) -> dict[str, float]:
    """Three columns: an estimate and the ends of its interval."""
    return {name + end: value for end, value in zip(_ENDS, estimate, strict=True)}


def write_rows(table: Sequence[Mapping[str, object]], path: Path) -> None:
    """Write a CSV file; unknown values are empty cells.

    Raises:
        RunError: writing failed.
    """
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
    """Build the columns for `report.statistics_plots.plot_campaign`, of bands that enough runs reach."""
    from lidar_emu.report.statistics_plots import LEAST_SHARE

    least = LEAST_SHARE * max((band.runs for band in bands), default=0)
    reached = [band for band in bands if band.runs >= least]
    return [_column(axis.name, [band for band in reached if band.axis == axis.name]) for axis in AXES]


def _column(axis: str, bands: Sequence[BandStatistics]) -> CampaignColumn:
    from lidar_emu.report.statistics_plots import CampaignColumn

    logarithmic = axis == "altitude_m"
    low, high = (np.array([getattr(band, name) for band in bands]) for name in ("low", "high"))
    return CampaignColumn(
        label=_LABELS[axis],
        logarithmic=logarithmic,
        middle=np.sqrt(low * high) if logarithmic else (low + high) / 2,
        counts={"flights": [band.runs for band in bands], "beam shots": [band.expected for band in bands]},
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
