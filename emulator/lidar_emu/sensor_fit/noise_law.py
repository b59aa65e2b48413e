"""The law of noise that is fitted: Student's t, scaled, seen through the smoothing; and intervals by blocks."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import betaincinv, stdtrit

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.sensor_fit.reference import WINDOW, smooth

LEVEL = 0.9
REPLICATES = 300
LEAST_BLOCKS, LEAST_VALUES = 6, 60
_DEGREES = (0.7, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 30.0, 1000.0)
_PIECE = 2 * WINDOW + 2
_DRAWN = 60_000
_GAUSSIAN_ROBUST = 1.4826


class NoiseLaw(NamedTuple):
    """Student's t, scaled."""

    scale: float
    degrees: float
    """Degrees of freedom; 1000: Gaussian."""

    @property
    def sigma(self) -> float:
        """Robust standard deviation: of the Gaussian that has the same median of magnitudes."""
        return float(_GAUSSIAN_ROBUST * self.scale * stdtrit(self.degrees, 0.75))


class Interval(NamedTuple):
    """An estimate and its 90 % interval; NaN where the data cannot say."""

    value: float
    low: float
    high: float

    @property
    def is_known(self) -> bool:
        return bool(np.isfinite(self.low) and np.isfinite(self.high))


UNKNOWN = Interval(np.nan, np.nan, np.nan)


@lru_cache(maxsize=64)
def drawn_noise(degrees: float, smoothed: bool) -> FloatArray:
    """(pieces, 20) White noise of scale 1 as `reference` sees it: about truth, or about the moving quadratic."""
    noise = generator(1).standard_t(degrees, size=(_DRAWN // _PIECE, _PIECE))
    if not smoothed:
        return noise
    return smooth(np.arange(_PIECE, dtype=np.float64), noise)[1]


@lru_cache(maxsize=2)
def _quantiles_by_degrees(smoothed: bool) -> tuple[FloatArray, FloatArray]:
    """Half-widths that hold 50 and 95 % of the noise, by degrees of freedom."""
    if not smoothed:
        return stdtrit(_DEGREES, 0.75), stdtrit(_DEGREES, 0.975)
    half = np.array([np.quantile(np.abs(drawn_noise(each, True)), (0.5, 0.95)) for each in _DEGREES])
    return half[:, 0], half[:, 1]


def _laws(half_50: FloatArray, half_95: FloatArray, smoothed: bool) -> tuple[FloatArray, FloatArray]:
    """Scale and inverse degrees of freedom of the laws whose noise has half-widths of 50 and 95 %."""
    at_50, at_95 = _quantiles_by_degrees(smoothed)
    # Tails grow with the inverse of the degrees of freedom; ascending, as `interp` needs it.
    ratio, inverse = (at_95 / at_50)[::-1], 1.0 / np.array(_DEGREES[::-1])
    tails = np.interp(half_95 / half_50, ratio, inverse)
    return half_50 / np.interp(tails, inverse, at_50[::-1]), tails


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


def _quantiles(ordered: FloatArray, weight: FloatArray, levels: tuple[float, ...]) -> FloatArray:
    """Quantiles of ascending values with weights."""
    total = np.cumsum(weight)
    return np.asarray(
        ordered[np.searchsorted(total, np.array(levels) * total[-1]).clip(max=len(ordered) - 1)]
    )


def interval_of(value: float, replicates: FloatArray, blocks: int) -> Interval:
    """90 % interval by the scatter of the replicates; with few blocks their scatter is uncertain itself."""
    scatter = float(np.std(replicates)) * np.sqrt(blocks / (blocks - 1))
    half = float(stdtrit(blocks - 1, (1 + LEVEL) / 2)) * scatter
    return Interval(value, value - half, value + half)


class FittedNoise(NamedTuple):
    """A law with intervals."""

    law: NoiseLaw
    sigma: Interval
    half_95: Interval
    inverse_degrees: Interval
    values: int


def fit_noise(residual: FloatArray, block: IntArray, smoothed: bool) -> FittedNoise | None:
    """Fit the law to (values,) residuals without NaN; None where the data cannot say."""
    blocks = len(np.unique(block))
    if len(residual) < LEAST_VALUES or blocks < LEAST_BLOCKS:
        return None
    order = np.argsort(np.abs(residual))
    ordered = np.abs(residual)[order]
    place, counts = resampled(block[order])
    # The data first, then the replicates.
    weights = np.concatenate([np.ones((1, blocks)), counts])
    half_50, half_95 = np.array([_quantiles(ordered, each[place], (0.5, 0.95)) for each in weights]).T
    if not half_50.all():
        return None
    scale, tails = _laws(half_50, half_95, smoothed)
    sigma = _interval_of_positive(_GAUSSIAN_ROBUST * scale * stdtrit(1.0 / tails, 0.75), blocks)
    half = _interval_of_positive(scale * stdtrit(1.0 / tails, 0.975), blocks)
    value, low, high = interval_of(float(tails[0]), tails[1:], blocks)
    inverse = Interval(value, max(low, 0.0), min(high, 1.0 / _DEGREES[0]))
    return FittedNoise(NoiseLaw(float(scale[0]), float(1.0 / tails[0])), sigma, half, inverse, len(residual))


def _interval_of_positive(values: FloatArray, blocks: int) -> Interval:
    found = interval_of(float(np.log(values[0])), np.log(values[1:]), blocks)
    return Interval(*(float(np.exp(each)) for each in found))


def share_interval(count: int, of: int, effective: float) -> Interval:
    """A share with Jeffreys' interval, for as many trials as are independent: from 0 or to 1 where all are alike."""
    if of == 0:
        return UNKNOWN
    share, tail = count / of, (1.0 - LEVEL) / 2.0
    hits, misses = share * effective + 0.5, (1.0 - share) * effective + 0.5
    low, high = (float(betaincinv(hits, misses, level)) for level in (tail, 1.0 - tail))
    return Interval(share, low if count else 0.0, high if count < of else 1.0)
