"""A sensor fitted on every second block of a log, and the verdict on the blocks between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
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
    range_edges,
    range_shares,
    share_rows,
    smoothing_rows,
    step_rows,
)
from lidar_emu.sensor_fit.flight_log import FlightLog
from lidar_emu.sensor_fit.noise_law import LEVEL, REPLICATES, drawn_noise
from lidar_emu.sensor_fit.reference import GATE, Errors, Quantity, errors_of, robust_sigma, smooth_residual

BANDS = (0.5, 0.9, 0.99)
LAGS = 5
_MODEL_POINTS = 4000
_WHITE_VALUES, _MOST_DRAWS = 60_000, 40


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


class Predicted(NamedTuple):
    """Residuals of one half beside the law of their bins, (values,) each."""

    residual: FloatArray
    probability: FloatArray
    """Share of the law's noise below the residual."""
    group: IntArray
    """Bin of each value."""
    block: IntArray


class NoiseVerdict(NamedTuple):
    """Noise of one quantity: what was fitted, and the two halves beside it."""

    what: str
    unit: str
    bins: list[NoiseBin]
    fitted: Predicted
    held_out: Predicted
    unfitted: int
    """Held-out values in bins that the fitted half says too little of."""
    checks: list[Check]
    correlation: FloatArray
    """(LAGS,) of the held-out residuals, shot to shot."""
    expected_correlation: FloatArray
    """(LAGS,) of white noise behind the same smoothing."""
    correlation_half: FloatArray
    """(LAGS,) Half width of the band."""


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
    noise: list[NoiseVerdict]
    share_checks: list[Check]

    @property
    def checks(self) -> list[Check]:
        return [check for noise in self.noise for check in noise.checks] + self.share_checks


_QUANTITIES = (("range", "m", "range_m"), ("speed", "m/s", "closing_speed_mps"))


def characterised(log: FlightLog, block_s: float) -> Characterised:
    """Characterise the sensor of a log by every second block."""
    errors = errors_of(log, block_s)
    used, edges_m, steps = ~errors.is_held_out, range_edges(errors), step_rows(log)
    rows, noise_bins, shares = steps + limit_rows(log, errors), {}, {}
    for (what, unit, column), quantity, step in zip(_QUANTITIES, errors[:2], steps, strict=True):
        noise_bins[what] = fit_noise_bins(quantity, errors, used, edges_m)
        rows += noise_rows(what, unit, noise_bins[what], step.estimate.value)
        halves = [
            range_shares(getattr(log, column), quantity, errors, half, edges_m) for half in (used, ~used)
        ]
        shares[what] = (halves[0], halves[1])
        rows += share_rows(what, halves[0])
    rows += noise_by_snr(log, errors, used) + smoothing_rows(log, errors) + motion_rows(log, errors, used)
    rows += axis_rows(log, errors, used)
    return Characterised(errors, rows, noise_bins, shares)


def fit_log(log: FlightLog, block_s: float) -> Fit:
    """Characterise the sensor of a log by every second block, and predict the others."""
    sensor = characterised(log, block_s)
    noise = [
        _noise_verdict(log, what, unit, sensor.noise_bins[what], quantity, sensor.errors)
        for (what, unit, _), quantity in zip(_QUANTITIES, sensor.errors[:2], strict=True)
    ]
    checks = [check for what, halves in sensor.shares.items() for check in _share_checks(what, *halves)]
    return Fit(log, sensor, noise, checks)


def _noise_verdict(
    log: FlightLog, what: str, unit: str, bins: list[NoiseBin], quantity: Quantity, errors: Errors
) -> NoiseVerdict:
    fitted, held_out = (
        _predicted(bins, quantity, errors, half) for half in (~errors.is_held_out, errors.is_held_out)
    )
    all_held = int(np.count_nonzero(np.isfinite(quantity.residual) & errors.is_held_out))
    held_residual = np.where(errors.is_held_out, quantity.residual, np.nan)
    correlation, half = _correlation(held_residual, errors.block)
    degrees = float(np.median([each.noise.law.degrees for each in bins])) if bins else 1000.0
    expected = _white_correlation(log.time_s, held_residual, errors, degrees)
    checks = _noise_checks(what, unit, bins, fitted, held_out, errors.smoothed)
    if np.isfinite(correlation[0]):
        low, high = expected[0] - half[0], expected[0] + half[0]
        checks.append(
            Check(
                f"{what} noise, correlation from shot to shot", "", *map(float, (correlation[0], low, high))
            )
        )
    return NoiseVerdict(
        what,
        unit,
        bins,
        fitted,
        held_out,
        all_held - len(held_out.residual),
        checks,
        correlation,
        expected,
        half,
    )


def _predicted(bins: list[NoiseBin], quantity: Quantity, errors: Errors, half: BoolArray) -> Predicted:
    parts = [Predicted(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))]
    for number, each in enumerate(bins):
        reference_m, residual = errors.range.reference[:, each.beam], quantity.residual[:, each.beam]
        inside = (
            half[:, each.beam]
            & np.isfinite(residual)
            & (reference_m >= each.low_m)
            & (reference_m < each.high_m)
        )
        model = np.sort(model_noise(each, errors.smoothed))
        # Half way through what is equal, as quantised values are.
        below = np.searchsorted(model, residual[inside]) / len(model)
        group = np.full(int(inside.sum()), number)
        parts.append(Predicted(residual[inside], below, group, errors.block[inside, each.beam]))
    return Predicted(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def model_noise(each: NoiseBin, smoothed: bool) -> FloatArray:
    """Noise of a bin by its law, as the reference shows it."""
    law = each.noise.law
    drawn: FloatArray = law.scale * drawn_noise(round(law.degrees, 3), smoothed).ravel()
    return drawn[np.abs(drawn) < GATE * law.sigma]


def _noise_checks(
    what: str, unit: str, bins: list[NoiseBin], fitted: Predicted, held_out: Predicted, smoothed: bool
) -> list[Check]:
    """Area between distributions, Kolmogorov-Smirnov distance, and shares inside bands of the law.

    The band of each figure is that of resampled blocks of the fitted half: as few that they scatter as much as fitted
    and held-out half together.
    """
    if not len(held_out.residual):
        return []
    reach = GATE * robust_sigma(fitted.residual)
    model = np.concatenate([
        np.quantile(model_noise(each, smoothed), (np.arange(points) + 0.5) / points)
        for number, each in enumerate(bins)
        if (points := _MODEL_POINTS * int((held_out.group == number).sum()) // len(held_out.residual))
    ]).clip(-reach, reach)  # fmt: skip
    names = [f"{what} noise, area metric", f"{what} noise, Kolmogorov-Smirnov distance"]
    names += [f"{what} noise, share inside the {100 * band:.0f} % band" for band in BANDS]
    value = _figures(held_out, model, reach)
    blocks = [np.unique(each.block) for each in (fitted, held_out)]
    take = max(2, round(len(blocks[0]) * len(blocks[1]) / (len(blocks[0]) + len(blocks[1]))))
    members = [np.flatnonzero(fitted.block == number) for number in blocks[0]]
    rng = generator(3)
    drawn = np.array([
        _figures(Predicted(*(column[at] for column in fitted)), model, reach)
        for at in (
            np.concatenate([members[k] for k in rng.integers(len(members), size=take)]) for _ in range(REPLICATES)
        )
    ])  # fmt: skip
    tail = (1.0 - LEVEL) / 2.0
    bands = [(0.0, np.quantile(drawn[:, k], LEVEL)) for k in (0, 1)]
    bands += [tuple(np.quantile(drawn[:, k], (tail, 1.0 - tail))) for k in range(2, 2 + len(BANDS))]
    units = [unit, *[""] * (1 + len(BANDS))]
    return [
        Check(name, of, float(v), float(low), float(high))
        for name, of, v, (low, high) in zip(names, units, value, bands, strict=True)
    ]


def _figures(half: Predicted, model: FloatArray, reach: float) -> FloatArray:
    from scipy.stats import wasserstein_distance

    ordered, n = np.sort(half.probability), len(half.probability)
    distance = np.max(np.maximum(np.arange(1, n + 1) / n - ordered, ordered - np.arange(n) / n))
    area = wasserstein_distance(half.residual.clip(-reach, reach), model)
    inside = [np.mean(np.abs(half.probability - 0.5) <= band / 2) for band in BANDS]
    return np.array([area, distance, *inside])


def _correlation(residual: FloatArray, block: IntArray) -> tuple[FloatArray, FloatArray]:
    """Correlation by lag of (shots, beams) residuals without tails; half width of its band, from block to block."""
    bound = 3.0 * robust_sigma(residual)
    value = np.clip(residual, -bound, bound)
    found = np.full((2, LAGS), np.nan)
    for lag in range(1, min(LAGS, len(value) - 1) + 1):
        both = np.isfinite(value[lag:]) & np.isfinite(value[:-lag]) & (block[lag:] == block[:-lag])
        if both.any():
            one, other, (_, place) = (
                value[lag:][both],
                value[:-lag][both],
                np.unique(block[lag:][both], return_inverse=True),
            )
            product, power = np.bincount(place, one * other), np.bincount(place, (one**2 + other**2) / 2)
            if total := power.sum():
                ratio = product.sum() / total
                found[:, lag - 1] = ratio, 1.645 * np.sqrt(np.sum((product - ratio * power) ** 2)) / total
    return found[0], found[1]


def _white_correlation(
    time_s: FloatArray, residual: FloatArray, errors: Errors, degrees: float
) -> FloatArray:
    """Correlation by lag of white noise at the times of the residuals, behind the same smoothing."""
    known = np.isfinite(residual)
    if not errors.smoothed or not known.any():
        return np.zeros(LAGS)
    rng, found = generator(4), []
    for _ in range(int(np.clip(_WHITE_VALUES // known.sum(), 1, _MOST_DRAWS))):
        noise = rng.standard_t(degrees, residual.shape)
        columns = zip(time_s.T, noise.T, known.T, errors.block.T, strict=True)
        white = np.stack([smooth_residual(*column) for column in columns], axis=1)
        found.append(_correlation(white, errors.block)[0])
    return np.asarray(np.mean(found, axis=0))


def _share_checks(what: str, fitted: list[RangeShare], held_out: list[RangeShare]) -> list[Check]:
    """Values per shot of the held-out half, within what the fitted half's count predicts."""
    from scipy.stats import betabinom

    checks = []
    for before, after in zip(fitted, held_out, strict=True):
        if not before.shots or not after.shots:
            continue
        trials = max(1, round(min(after.effective, before.effective * after.shots / before.shots)))
        hits = before.valid.value * before.effective
        law = betabinom(trials, hits + 0.5, before.effective - hits + 0.5)
        low, high = law.ppf((1 - LEVEL) / 2) / trials, law.ppf((1 + LEVEL) / 2) / trials
        name = f"{what}s per shot, {before.low_m:.0f} to {before.high_m:.0f} m"
        checks.append(Check(name, "", after.valid.value, float(low), float(high)))
    return checks
