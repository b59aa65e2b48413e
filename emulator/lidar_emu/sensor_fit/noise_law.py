"""The law of noise that is fitted: Student's t, scaled, seen through the smoothing; and intervals by blocks."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.sensor_fit.reference import GATE, WINDOW, Errors, Quantity, about_quadratic

LEVEL, ENDS = 0.9, (0.05, 0.95)
REPLICATES = 300
LEAST_BLOCKS, LEAST_VALUES = 6, 60
_DEGREES = (0.7, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 30.0, 1000.0)
_PIECE = 2 * WINDOW + 2
_DRAWN = 60_000
_GAUSSIAN_ROBUST = 1.4826


class Interval(NamedTuple):
    """An estimate and its 90 % interval; NaN where the data cannot say."""

    value: float
    low: float
    high: float

    @property
    def is_known(self) -> bool:
        return bool(np.isfinite(self.low) and np.isfinite(self.high))


UNKNOWN = Interval(np.nan, np.nan, np.nan)


class FittedNoise(NamedTuple):
    """Student's t, scaled, with intervals."""

    scale: float
    degrees: Interval
    """Degrees of freedom; 1000: Gaussian."""
    sigma: Interval
    """Robust standard deviation: of the Gaussian that has the same median of magnitudes."""
    half_95: Interval
    """Half-width that holds 95 % of the noise."""

    def drawn(self, smoothed: bool) -> FloatArray:
        """Noise of this law as the reference shows it, without what would be a false lock."""
        noise: FloatArray = self.scale * _drawn(round(self.degrees.value, 3), smoothed).ravel()
        return noise[np.abs(noise) < GATE * self.sigma.value]


@lru_cache(maxsize=64)
def _drawn(degrees: float, smoothed: bool) -> FloatArray:
    """(pieces, 20) White noise of scale 1 as `reference` sees it: about truth, or about the moving quadratic."""
    noise = generator(1).standard_t(degrees, size=(_DRAWN // _PIECE, _PIECE))
    return about_quadratic(np.arange(_PIECE, dtype=np.float64), noise) if smoothed else noise


@lru_cache(maxsize=2)
def _half_widths(smoothed: bool) -> FloatArray:
    """(2, degrees of freedom) Half-widths that hold 50 and 95 % of the noise."""
    if not smoothed:
        return np.array([stdtrit(_DEGREES, 0.75), stdtrit(_DEGREES, 0.975)])
    return np.array([np.quantile(np.abs(_drawn(each, True)), (0.5, 0.95)) for each in _DEGREES]).T


def _laws(half_50: FloatArray, half_95: FloatArray, smoothed: bool) -> tuple[FloatArray, FloatArray]:
    """Scale and inverse degrees of freedom of the laws whose noise has half-widths of 50 and 95 %."""
    # Tails grow with the inverse of the degrees of freedom; ascending, as `interp` needs it.
    (at_50, at_95), inverse = _half_widths(smoothed)[:, ::-1], 1.0 / np.array(_DEGREES[::-1])
    tails = np.interp(half_95 / half_50, at_95 / at_50, inverse)
    return half_50 / np.interp(tails, inverse, at_50), tails


def resampled(block: IntArray) -> tuple[IntArray, FloatArray]:
    """Resampling of whole blocks, in which noise may depend on the noise before.

    Args:
        block: (values,) number of the block of each value.

    Returns:
        (values,) place of the block of each value, and (REPLICATES, blocks) how often each block is taken.
    """
    names, place = np.unique(block, return_inverse=True)
    share = np.full(len(names), 1.0 / len(names))
    return place, generator(2).multinomial(len(names), share, size=REPLICATES).astype(np.float64)


def interval_of(value: float, replicates: FloatArray, blocks: int) -> Interval:
    """90 % interval by the scatter of the replicates; with few blocks their scatter is uncertain itself."""
    scatter = float(np.std(replicates)) * np.sqrt(blocks / (blocks - 1))
    half = float(stdtrit(blocks - 1, ENDS[1])) * scatter
    return Interval(value, value - half, value + half)


def _interval_of_positive(values: FloatArray, blocks: int) -> Interval:
    return Interval(*np.exp(interval_of(np.log(values[0]), np.log(values[1:]), blocks)).tolist())


def fit_noise(quantity: Quantity, errors: Errors, inside: BoolArray) -> FittedNoise | None:
    """Fit the law to the noise of the values `inside`; None where the data cannot say."""
    known = inside & np.isfinite(quantity.residual)
    residual, block = quantity.residual[known], errors.block[known]
    blocks = len(np.unique(block))
    if len(residual) < LEAST_VALUES or blocks < LEAST_BLOCKS:
        return None
    order = np.argsort(np.abs(residual))
    place, counts = resampled(block[order])
    # The data first, then the replicates.
    below = [np.cumsum(each[place]) for each in (np.ones(blocks), *counts)]
    at = np.array([np.searchsorted(each, (0.5 * each[-1], 0.95 * each[-1])) for each in below])
    half_50, half_95 = np.abs(residual)[order][at].T
    if not half_50.all():
        return None
    scale, tails = _laws(half_50, half_95, errors.smoothed)
    value, low, high = interval_of(float(tails[0]), tails[1:], blocks)
    return FittedNoise(
        float(scale[0]),
        Interval(1.0 / value, 1.0 / min(high, 1.0 / _DEGREES[0]), 1.0 / low if low > 0 else np.inf),
        _interval_of_positive(_GAUSSIAN_ROBUST * scale * stdtrit(1.0 / tails, 0.75), blocks),
        _interval_of_positive(scale * stdtrit(1.0 / tails, 0.975), blocks),
    )
