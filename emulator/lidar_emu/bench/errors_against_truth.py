"""Distribution of a setting's errors, and its difference from the reference's distribution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray

_SHARES = np.arange(0.01, 0.995, 0.01)
"""Quantiles 1 % to 99 %: beyond them a single false lock, kilometres off, would outweigh a thousand measurements."""


@dataclass(frozen=True)
class ErrorSpread:
    """Errors against the truth of the beams that fired and whose axis meets the ground."""

    range_m: FloatArray
    """(99,) Quantiles; NaN where nothing was valid."""
    speed_mps: FloatArray
    """(99,)"""
    dropout: float
    """Fraction without a valid range."""
    count: int


@dataclass(frozen=True)
class DistributionDifference:
    """Root mean square difference of two distributions' quantiles, and difference of their dropout rates."""

    range_m: float
    speed_mps: float
    dropout: float


def spread(range_error_m: FloatArray, speed_error_mps: FloatArray, expected: BoolArray) -> ErrorSpread:
    """The distribution of errors (shots, beams), NaN where invalid; `expected` where a measurement was possible."""
    count = int(expected.sum())
    valid = np.isfinite(range_error_m[expected])
    return ErrorSpread(
        _quantiles(range_error_m[expected]),
        _quantiles(speed_error_mps[expected]),
        float(1.0 - valid.mean()) if count else np.nan,
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
        abs(one.dropout - other.dropout),
    )
