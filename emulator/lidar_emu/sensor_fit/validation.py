"""A sensor fitted on every second block of a log, and the verdict on the blocks between."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.sensor_fit.beam_axes import axis_rows
from lidar_emu.sensor_fit.characteristics import (
    NoiseBin,
    RangeShare,
    Row,
    fit_noise_bins,
    limit_rows,
    motion_rows,
    noise_by_snr,
    noise_rows,
    quantities,
    range_edges,
    range_shares,
    range_text,
    share_rows,
    step_of,
)
from lidar_emu.sensor_fit.flight_log import FlightLog
from lidar_emu.sensor_fit.noise_law import ENDS, LEVEL, REPLICATES, Interval
from lidar_emu.sensor_fit.reference import GATE, Errors, errors_of, robust_sigma, smooth_residual

BANDS = (0.5, 0.9, 0.99)
_WHITE_VALUES = 60_000


class Check(NamedTuple):
    """A figure of the held-out half with the band in which the fitted half expects it."""

    what: str
    unit: str
    value: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        return self.low <= self.value <= self.high


class Characterised(NamedTuple):
    """What the fitted half of a log says of its sensor; steps and limits by the whole log."""

    errors: Errors
    rows: list[Row]
    noise_bins: dict[str, list[NoiseBin]]
    shares: dict[str, tuple[list[RangeShare], list[RangeShare]]]
    """Shares by range of the fitted and of the held-out half, for range and speed."""


class Fit(NamedTuple):
    """A sensor, and the verdict on the held-out half."""

    log: FlightLog
    sensor: Characterised
    checks: list[Check]
    unfitted: int
    """Held-out values in bins of range where the fitted half has too little for a law."""


def characterised(log: FlightLog, block_s: float) -> Characterised:
    """Characterise the sensor of a log by every second block."""
    errors = errors_of(log, block_s)
    used, edges_m = ~errors.is_held_out, range_edges(errors)
    rows, noise_bins, shares = list(limit_rows(log, errors)), {}, {}
    for what, unit, value, quantity in quantities(log, errors):
        step = step_of(value)
        word = "" if np.isfinite(step) else "no common step in the values"
        rows.append(Row(f"{what} step", None, "", unit, Interval(step, step, step), word))
        noise_bins[what] = fit_noise_bins(quantity, errors, used, edges_m)
        rows += noise_rows(what, unit, noise_bins[what], step)
        fitted, held_out = (range_shares(value, quantity, errors, half, edges_m) for half in (used, ~used))
        shares[what] = fitted, held_out
        rows += share_rows(what, fitted)
    rows += [*noise_by_snr(log, errors, used), *motion_rows(log, errors, used)]
    rows += axis_rows(log, errors, used)
    return Characterised(errors, rows, noise_bins, shares)


def fit_log(log: FlightLog, block_s: float) -> Fit:
    """Characterise the sensor of a log by every second block, and predict the others."""
    sensor, unfitted = characterised(log, block_s), 0
    errors, checks = sensor.errors, list[Check]()
    for what, unit, _, quantity in quantities(log, errors):
        bins, residual = sensor.noise_bins[what], quantity.residual
        probability = _probability(bins, residual, errors)
        held_out = np.isfinite(residual) & errors.is_held_out
        unfitted += int(np.count_nonzero(held_out & np.isnan(probability)))
        checks += _noise_checks(what, unit, bins, residual, probability, errors)
        checks += _correlation_checks(what, bins, np.where(held_out, residual, np.nan), log.time_s, errors)
    for what, halves in sensor.shares.items():
        checks += _share_checks(what, *halves)
    return Fit(log, sensor, checks, unfitted)


def _probability(bins: list[NoiseBin], residual: FloatArray, errors: Errors) -> FloatArray:
    """(shots, beams) Share of its bin's law below each residual; NaN where there is no law."""
    found = np.full(residual.shape, np.nan)
    for each in bins:
        inside, model = each.holds(errors) & np.isfinite(residual), np.sort(each.noise.drawn(errors.smoothed))
        found[inside] = np.searchsorted(model, residual[inside]) / len(model)
    return found


def _levels(count: int) -> FloatArray:
    return (np.arange(count) + 0.5) / count


def _noise_checks(
    what: str, unit: str, bins: list[NoiseBin], residual: FloatArray, probability: FloatArray, errors: Errors
) -> Iterator[Check]:
    """Area between distributions, Kolmogorov-Smirnov distance, and shares inside bands of the law.

    The band of each figure is that of resampled blocks of the fitted half: as few that they scatter as much as fitted
    and held-out half together.
    """
    known = np.isfinite(probability)
    fitted, held_out = known & ~errors.is_held_out, known & errors.is_held_out
    if not held_out.any():
        return
    reach = GATE * robust_sigma(residual[fitted])
    laws = []
    for each in bins:
        count = int(np.count_nonzero(each.holds(errors) & held_out))
        laws.append(np.quantile(each.noise.drawn(errors.smoothed), _levels(count)))
    model = np.sort(np.concatenate(laws).clip(-reach, reach))

    def figures(noise: FloatArray, share: FloatArray) -> FloatArray:
        levels = _levels(len(share))
        expected = np.interp(levels, _levels(len(model)), model)
        area = np.mean(np.abs(np.sort(noise.clip(-reach, reach)) - expected))
        distance = np.max(np.abs(np.sort(share) - levels)) + 0.5 / len(share)
        return np.array([area, distance, *(np.mean(np.abs(share - 0.5) <= band / 2) for band in BANDS)])

    blocks, others = (np.unique(errors.block[half]) for half in (fitted, held_out))
    take = max(2, round(len(blocks) * len(others) / (len(blocks) + len(others))))
    members = [np.flatnonzero(errors.block[fitted] == number) for number in blocks]
    draws = generator(3).integers(len(members), size=(REPLICATES, take))
    places = (np.concatenate([members[k] for k in draw]) for draw in draws)
    drawn = np.array([figures(residual[fitted][at], probability[fitted][at]) for at in places])
    low, high = np.quantile(drawn, ENDS, axis=0)
    # No area or distance is too small.
    low[:2], high[:2] = 0.0, np.quantile(drawn[:, :2], LEVEL, axis=0)
    names = ["area metric", "Kolmogorov-Smirnov distance"]
    names += [f"share inside the {100 * band:.0f} % band" for band in BANDS]
    table = np.stack([figures(residual[held_out], probability[held_out]), low, high], axis=1).tolist()
    for k, (name, line) in enumerate(zip(names, table, strict=True)):
        yield Check(f"{what} noise, {name}", "" if k else unit, *line)


def _correlation_checks(
    what: str, bins: list[NoiseBin], residual: FloatArray, time_s: FloatArray, errors: Errors
) -> Iterator[Check]:
    """Correlation from shot to shot, and that of white noise at the same times, behind the same smoothing."""
    found, half = _correlation(residual, errors.block)
    if np.isnan(found):
        return
    expected = []
    if errors.smoothed:
        degrees = float(np.median([each.noise.degrees.value for each in bins] or [1000.0]))
        shape = (1 + _WHITE_VALUES // int(np.isfinite(residual).sum()), *residual.shape)
        draws = np.where(np.isfinite(residual), generator(4).standard_t(degrees, shape), np.nan)
        for noise in draws:
            columns = zip(time_s.T, noise.T, errors.block.T, strict=True)
            white = np.stack([smooth_residual(*column) for column in columns], axis=1)
            expected.append(_correlation(white, errors.block)[0])
    middle = float(np.mean(expected or [0.0]))
    yield Check(f"{what} noise, correlation from shot to shot", "", found, middle - half, middle + half)


def _correlation(residual: FloatArray, block: IntArray) -> tuple[float, float]:
    """Correlation of successive (shots, beams) residuals without tails; half width of its band, from block to block."""
    bound = 3.0 * robust_sigma(residual)
    value = np.clip(residual, -bound, bound)
    both = np.isfinite(value[1:] + value[:-1]) & (block[1:] == block[:-1])
    one, other, place = value[1:][both], value[:-1][both], np.unique(block[1:][both], return_inverse=True)[1]
    product, power = np.bincount(place, one * other), np.bincount(place, (one**2 + other**2) / 2)
    if not power.any():
        return np.nan, np.nan
    ratio = product.sum() / power.sum()
    return float(ratio), float(1.645 * np.sqrt(np.sum((product - ratio * power) ** 2)) / power.sum())


def _share_checks(what: str, fitted: list[RangeShare], held_out: list[RangeShare]) -> Iterator[Check]:
    """Values per shot of the held-out half, within what the fitted half's count predicts."""
    from scipy.stats import betabinom

    for before, after in zip(fitted, held_out, strict=True):
        if not before.shots or not after.shots:
            continue
        trials = max(1, round(min(after.effective, before.effective * after.shots / before.shots)))
        hits = before.valid.value * before.effective
        law = betabinom(trials, hits + 0.5, before.effective - hits + 0.5)
        low, high = law.ppf(ENDS) / trials
        name = f"{what}s per shot, {range_text(before.low_m, before.high_m)}"
        yield Check(name, "", after.valid.value, float(low), float(high))
