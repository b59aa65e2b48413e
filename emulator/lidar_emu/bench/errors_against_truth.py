"""Distribution of a setting's errors, and its difference from the reference's distribution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidar_emu.fmcw.returns import Echoes, Returns
from lidar_emu.numerics.arrays import BoolArray, FloatArray

_SHARES = np.arange(0.01, 0.995, 0.01)
"""Quantiles 1 % to 99 %: tails beyond them are not resolved by a thousand measurements."""


_FALSE_LOCK_BINS = 10.0
"""A valid measurement further than this from every beamlet of the footprint is a false lock. Motion between the
segments biases a range by a bin at 12 m/s² with the default instrument; noise peaks lie anywhere."""


@dataclass(frozen=True)
class ErrorSpread:
    """Errors against the truth of the beams that fired and whose axis meets the ground."""

    range_m: FloatArray
    """(99,) Quantiles of the correct locks; NaN where there are none."""
    speed_mps: FloatArray
    """(99,)"""
    dropout: float
    """Fraction without a valid range."""
    false_lock: float
    """Fraction with a valid range that is not the range of the surface."""
    count: int


@dataclass(frozen=True)
class DistributionDifference:
    """Differences of two distributions of errors."""

    range_m: float
    """Root mean square difference of the quantiles."""
    speed_mps: float
    outcome: float
    """Total variation distance of the shares of correct locks, false locks and dropouts."""


def false_locks(returns: Returns, echoes: Echoes, range_bin_m: float, speed_bin_mps: float) -> BoolArray:
    """(shots, beams) Whether a valid measurement lies ten bins or more outside its beamlets' ranges or speeds."""
    far: BoolArray = np.zeros(returns.range_valid.shape, dtype=bool)
    for found, beamlets, bin_width in (
        (returns.range_m, echoes.range_m, range_bin_m),
        (returns.closing_speed_mps, echoes.closing_speed_mps, speed_bin_mps),
    ):
        lowest = np.where(np.isnan(beamlets), np.inf, beamlets).min(axis=-1)
        highest = np.where(np.isnan(beamlets), -np.inf, beamlets).max(axis=-1)
        far |= np.maximum(lowest - found, found - highest) > _FALSE_LOCK_BINS * bin_width
    return returns.range_valid & far


def spread(
    range_error_m: FloatArray, speed_error_mps: FloatArray, false_lock: BoolArray, expected: BoolArray
) -> ErrorSpread:
    """Distribution of errors (shots, beams), NaN where invalid.

    Args:
        range_error_m, speed_error_mps: errors against the truth.
        false_lock: where a valid measurement is not of the surface; its errors are excluded from the quantiles.
        expected: where a measurement was possible.
    """
    count = int(expected.sum())
    valid, false = np.isfinite(range_error_m), false_lock & expected
    correct = valid & expected & ~false
    return ErrorSpread(
        _quantiles(range_error_m[correct]),
        _quantiles(speed_error_mps[correct]),
        float(1.0 - valid[expected].mean()) if count else np.nan,
        float(false.sum() / count) if count else np.nan,
        count,
    )


def _quantiles(error: FloatArray) -> FloatArray:
    known = error[np.isfinite(error)]
    return np.quantile(known, _SHARES) if known.size else np.full(_SHARES.size, np.nan)


def bias(quantiles: FloatArray) -> float:
    """Mean of the central 98 %."""
    return float(quantiles.mean())


def rms(quantiles: FloatArray) -> float:
    """Root mean square of the central 98 %."""
    return float(np.sqrt(np.mean(quantiles**2)))


def difference(one: ErrorSpread, other: ErrorSpread) -> DistributionDifference:
    """Difference of two distributions: for range and speed the 2-Wasserstein distance of the central 98 %."""
    return DistributionDifference(
        rms(one.range_m - other.range_m),
        rms(one.speed_mps - other.speed_mps),
        _total_variation(one, other),
    )


def _total_variation(one: ErrorSpread, other: ErrorSpread) -> float:
    dropout, false_lock = one.dropout - other.dropout, one.false_lock - other.false_lock
    return 0.5 * (abs(dropout) + abs(false_lock) + abs(dropout + false_lock))


def outcome_noise(one: ErrorSpread, other: ErrorSpread) -> float:
    """Standard deviation of a difference of shares by sampling: the largest for dropouts, false locks, and both."""
    shares = [0.5 * (one.dropout + other.dropout), 0.5 * (one.false_lock + other.false_lock)]
    variance = max(2.0 * share * (1.0 - share) for share in (*shares, sum(shares)))
    return float((variance / max(one.count, 1)) ** 0.5)
