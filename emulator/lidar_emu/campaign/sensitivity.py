"""Sobol indices of a campaign: which drawn keys the scatter of errors, dropouts and other columns comes from.

The runs are Saltelli's design: each sample is a run A, a run per factor that differs from A in this factor alone, and a
run B that differs from A in all. The receiver's noise is a factor too, the key `seed`. SALib has design and estimators:
Saltelli et al., "Variance based sensitivity analysis of model output", Comput. Phys. Commun. 181 (2010).
"""

from __future__ import annotations

import math
import warnings
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.campaign.description import LEAST_SAMPLES, sensitivity_problem
from lidar_emu.campaign.statistics import AXES, CONFIDENCE, ERRORS, IntervalEstimate, ended
from lidar_emu.campaign.tables import BEAM_COLUMNS, OUTCOMES, SHARES, read_columns
from lidar_emu.errors import Finding, InputError, did_you_mean, nearest
from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.scenario.campaign import Campaign
from lidar_emu.scenario.section import LIMITS

if TYPE_CHECKING:
    from lidar_emu.report.statistics_plots import SensitivityPanel

_RESAMPLES = 200
"""Bootstrap samples: they give the half width of an interval within 5 %."""
_EDGES_M = AXES[0].edges
_BANDS = len(_EDGES_M) - 1
_DROPOUT = "dropout"
_USUAL = (_DROPOUT, *(f"{error.name}_abs_{share}" for error in ERRORS for share in SHARES))
_OUTPUT_LABELS = {_DROPOUT: "share of dropouts"} | {
    f"{error.name}_abs_{share}": f"{100 * level:g} % quantile of the absolute {_quantity} error"
    for error, _quantity in zip(ERRORS, ("range", "closing speed"), strict=True)
    for share, level in SHARES.items()
}
_COUNTS = ("shots", "expected")
"""Columns of the table `runs` alone; `range_valid` and `speed_valid` are shares of the beams."""
_MEASURED = ("run", "fired", "true_range_m", "range_valid", "altitude_m")
_QUANTITIES = tuple(name for error in ERRORS for name in (error.quantity, f"true_{error.quantity}"))


class Output(NamedTuple):
    """A number of each run, over the whole flight or within a band of altitude."""

    name: str
    low_m: float
    high_m: float
    """Edges of the band; NaN: the whole flight."""
    values: FloatArray
    """(runs,) NaN where a run has none."""


class FactorIndices(NamedTuple):
    """Share of an output's variance that comes from one factor."""

    output: str
    low_m: float
    high_m: float
    """Band of altitude; NaN: the whole flight."""
    factor: str
    """A drawn key, or several that are drawn jointly."""
    samples: int
    """Samples of the design of which every run has the output."""
    sigma: float
    """Standard deviation of the output over independent runs."""
    first: IntervalEstimate
    """Share from this factor alone; NaN where the output does not vary, or too few samples have it."""
    total: IntervalEstimate
    """The same with all interactions of this factor."""


def check_columns(where: str, campaign: Campaign, columns: Iterable[str]) -> None:
    """Check further columns, before the flight.

    Raises:
        InputError: names `where`: the tables will have no such column, or not of every run.
    """
    known = (*BEAM_COLUMNS, *_COUNTS)
    for name in columns:
        if name not in known:
            remedy = f"{did_you_mean(nearest(name, known))}name a column of docs/columns.md, {' or '.join(_COUNTS)}"
            raise InputError(where, name, Finding("no such column"), remedy)
        if name in BEAM_COLUMNS and campaign.beams_every > 1:
            raise InputError(where, name, Finding("not stored for every run"), "set beams_every: 1")


def sensitivity_indices(folder: Path, campaign: Campaign, columns: Sequence[str] = ()) -> list[FactorIndices]:
    """Compute the indices of dropout, of errors, and of further columns, from the tables of a flown campaign.

    Args:
        folder: folder of the campaign.
        campaign: the campaign as it was flown, of sampling `saltelli`.
        columns: further columns of the tables `runs` and `beams`; of the latter, means over beams that fired at ground.

    Raises:
        InputError: a table is damaged.
    """
    order = {name: place for place, name in enumerate(dict.fromkeys((*_USUAL, *columns)))}
    found = list(_whole_flight(folder, campaign, [name for name in _COUNTS if name in order]))
    if campaign.beams_every == 1:
        found += _by_altitude(folder, campaign, [name for name in order if name in BEAM_COLUMNS])
    return [
        index
        for output in sorted(found, key=lambda one: order[one.name])
        for index in _indices(output, campaign)
    ]


def _indices(output: Output, campaign: Campaign) -> Iterator[FactorIndices]:
    names = campaign.factor_names
    runs = output.values.reshape(-1, len(names) + 2)
    runs = runs[np.isfinite(runs).all(axis=1)]
    independent = runs[:, [0, -1]]
    first = total = [IntervalEstimate(math.nan, math.nan, math.nan)] * len(names)
    if len(runs) >= LEAST_SAMPLES and np.ptp(independent) > 0.0:
        found = _analyse(runs.ravel(), campaign)
        first, total = (_with_interval(found[name], found[f"{name}_conf"]) for name in ("S1", "ST"))
    sigma = float(independent.std()) if runs.size else math.nan
    for k, name in enumerate(names):
        yield FactorIndices(*output[:3], name, len(runs), sigma, first[k], total[k])


def _analyse(values: FloatArray, campaign: Campaign) -> dict[str, Any]:
    from SALib.analyze import sobol

    with warnings.catch_warnings():
        # Of a rare event, some bootstrap samples have none.
        warnings.simplefilter("ignore")
        found: dict[str, Any] = sobol.analyze(
            sensitivity_problem(campaign),
            values,
            calc_second_order=False,
            num_resamples=_RESAMPLES,
            conf_level=CONFIDENCE,
            seed=1 + campaign.seed,  # SALib takes 0 for none
        )
    return found


def _with_interval(value: FloatArray, half: FloatArray) -> list[IntervalEstimate]:
    return [
        IntervalEstimate(*map(float, ends)) for ends in zip(value, value - half, value + half, strict=True)
    ]


def _parts(folder: Path, table: str) -> list[Path]:
    return sorted((folder / table).glob("part-*.parquet"))


def _whole_flight(folder: Path, campaign: Campaign, columns: Iterable[str]) -> Iterator[Output]:
    outcomes = {name: np.full(campaign.runs, np.nan) for name in OUTCOMES}
    for path in _parts(folder, "runs"):
        part = read_columns(path, ("run", *OUTCOMES))
        for name, values in outcomes.items():
            values[part["run"]] = part[name]
    with np.errstate(invalid="ignore"):
        outcomes[_DROPOUT] = 1.0 - outcomes["range_valid"] / outcomes["expected"]
    for name in (*_USUAL, *columns):
        yield Output(name, math.nan, math.nan, outcomes[name])


def _by_altitude(folder: Path, campaign: Campaign, columns: Sequence[str]) -> Iterator[Output]:
    """Yield the outputs of all bands that beams hit, and the means of columns over the whole flight."""
    bands = {name: np.full((_BANDS, campaign.runs), np.nan) for name in (*_USUAL, *columns)}
    whole = {name: np.full(campaign.runs, np.nan) for name in columns}
    for path in _parts(folder, "beams"):
        beams = read_columns(path, tuple(dict.fromkeys((*_MEASURED, *_QUANTITIES, *columns))))
        expected = beams["fired"] & np.isfinite(beams["true_range_m"])
        beams = {name: values[expected] for name, values in beams.items()}
        run, place = np.unique(beams["run"], return_inverse=True)
        for name in columns:
            whole[name][run] = _means(place, beams[name], len(run))
        band = np.searchsorted(_EDGES_M, beams["altitude_m"], side="right") - 1
        inside = (band >= 0) & (band < _BANDS)
        cell = (place * _BANDS + band)[inside]
        beams = {name: values[inside] for name, values in beams.items()}
        for name, values in _of_cells(beams, cell, len(run) * _BANDS, columns):
            bands[name][:, run] = values.reshape(-1, _BANDS).T
    for name, mean in whole.items():
        yield Output(name, math.nan, math.nan, mean)
    for name, values in bands.items():
        for k in np.flatnonzero(np.isfinite(values).any(axis=1)).tolist():
            yield Output(name, float(_EDGES_M[k]), float(_EDGES_M[k + 1]), values[k])


def _of_cells(
    beams: dict[str, NDArray[Any]], cell: IntArray, cells: int, columns: Iterable[str]
) -> Iterator[tuple[str, FloatArray]]:
    """Yield each output (cells,) of beams that are assigned to cells."""
    yield _DROPOUT, _means(cell, ~beams["range_valid"], cells)
    for error in ERRORS:
        size = np.abs(beams[error.quantity] - beams[f"true_{error.quantity}"])
        for share, level in SHARES.items():
            yield f"{error.name}_abs_{share}", _quantiles(cell, size, cells, level)
    for name in columns:
        yield name, _means(cell, beams[name], cells)


def _means(cell: IntArray, values: NDArray[Any], cells: int) -> FloatArray:
    """(cells,) Mean of the finite values in each cell, NaN where there is none."""
    known = np.isfinite(values)
    count = np.bincount(cell[known], minlength=cells)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(cell[known], values[known], minlength=cells) / count)


def _quantiles(cell: IntArray, values: FloatArray, cells: int, level: float) -> FloatArray:
    """(cells,) As `np.quantile` of the finite values in each cell, NaN where there is none."""
    known = np.isfinite(values)
    cell, values = cell[known], values[known]
    values = values[np.lexsort((values, cell))]
    count = np.bincount(cell, minlength=cells)
    some = np.flatnonzero(count)
    place = (np.cumsum(count) - count)[some] + level * (count[some] - 1)
    below = np.floor(place).astype(np.int64)
    above = np.minimum(below + 1, np.cumsum(count)[some] - 1)
    found = np.full(cells, np.nan)
    found[some] = values[below] + (place - below) * (values[above] - values[below])
    return found


def index_rows(indices: Iterable[FactorIndices]) -> list[dict[str, str | float | None]]:
    """Build a row per output, band and factor; what is unknown is None."""
    rows: Iterator[dict[str, Any]] = (
        {
            **dict(zip(one._fields[:6], one[:6], strict=True)),
            **ended("first", one.first),
            **ended("total", one.total),
        }
        for one in indices
    )
    return [{name: None if value != value else value for name, value in row.items()} for row in rows]


def sensitivity_panels(indices: Sequence[FactorIndices]) -> list[SensitivityPanel]:
    """Build a panel per output for `report.statistics_plots.plot_sensitivity`, without bands that have no index."""
    from lidar_emu.report.statistics_plots import SensitivityPanel

    factors = len({one.factor for one in indices})
    most = max(one.samples for one in indices)
    panels = []
    for name in dict.fromkeys(one.output for one in indices):
        shown = [one for one in indices if one.output == name and math.isfinite(one.total.value)]
        labels = [_band_label(one, most) for one in shown[::factors]]
        shape = (len(labels), factors, 3)
        first, total = (
            np.array([getattr(one, kind) for one in shown], dtype=np.float64).reshape(shape)
            for kind in ("first", "total")
        )
        panels.append(SensitivityPanel(_OUTPUT_LABELS.get(name) or _with_unit(name), labels, first, total))
    return panels


def _band_label(one: FactorIndices, most_samples: int) -> str:
    band = "whole\nflight" if math.isnan(one.low_m) else f"{one.low_m:g}-\n{one.high_m:g}"
    return band if one.samples == most_samples else f"{band}\n({one.samples})"


def factor_label(factor: str) -> str:
    """Name the drawn keys of a factor by quantity and unit, and the part of the scenario that they are in."""
    parts: dict[str, list[str]] = defaultdict(list)
    for key in factor.split(" + "):
        part, _, name = key.rpartition(".")
        parts[part].append("noise (seed)" if key == "seed" else _with_unit(name))
    return " + ".join(" + ".join(names) + (f" of {part}" if part else "") for part, names in parts.items())


def _with_unit(name: str) -> str:
    """`laser_power_w` as `laser power (W)`."""
    quantity, _, unit = name.rpartition("_")
    if not quantity or unit not in LIMITS:
        return name.replace("_", " ")
    return f"{quantity.replace('_', ' ')} ({LIMITS[unit].unit.replace('deg', '°')})"
