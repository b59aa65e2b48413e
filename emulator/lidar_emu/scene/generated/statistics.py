"""Statistics of an elevation grid: structure functions, Hurst exponent, rms slope."""

from __future__ import annotations

import math

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray


def doubling_lags(side: int, largest_share: float) -> IntArray:
    """Lags of 1, 2, 4, ... samples, up to a fraction of the side."""
    return 2 ** np.arange(1 + max(1, int(math.log2(side * largest_share))))


def structure_function(height_m: FloatArray, lags: IntArray) -> FloatArray:
    """Mean square difference (lags,) of heights at given lags in samples, over both directions of the grid."""
    return np.array([_mean_square(height_m, (-1, 1), int(lag)) for lag in lags])


def second_structure_function(height_m: FloatArray, lags: IntArray) -> FloatArray:
    """Mean square (lags,) of h(x - lag) - 2 h(x) + h(x + lag), over both directions; insensitive to tilt."""
    return np.array([_mean_square(height_m, (1, -2, 1), int(lag)) for lag in lags])


def hurst_exponent(height_m: FloatArray) -> float:
    """H from the growth of second differences, whose mean square is proportional to lag^2H.

    First differences would suffice for a rough surface; on a smooth one they depend on a few long waves (Kent and Wood
    1997). The lags end at a sixteenth of the side; each is weighted by the number of independent differences on the
    grid.
    """
    lags = doubling_lags(min(height_m.shape), 1 / 16)
    x, y = np.log(lags), np.log(second_structure_function(height_m, lags))
    weight = 1.0 / lags.astype(np.float64) ** 2
    # Otherwise the finest lags would decide alone; every lag has errors that do not decrease with the number of
    # differences.
    weight = 1.0 / (1.0 / (weight * height_m.size) + 1e-4)
    x = x - np.average(x, weights=weight)
    return float((weight * x * y).sum() / (weight * x * x).sum() / 2)


def rms_slope(height_m: FloatArray, spacing_m: float, baseline_m: float, hurst: float) -> float:
    """Root mean square difference of height over a baseline, divided by the baseline.

    A baseline that is not a whole number of samples is replaced by the nearest one, scaled by the exponent.
    """
    lag = max(1, round(baseline_m / spacing_m))
    deviation_m = math.sqrt(_mean_square(height_m, (-1, 1), lag))
    return float(deviation_m * (baseline_m / (lag * spacing_m)) ** hurst / baseline_m)


def _mean_square(height_m: FloatArray, weights: tuple[int, ...], lag: int) -> float:
    """Mean square of weighted differences over `lag` samples, along rows and columns; NaN if there are none."""
    squares, count = 0.0, 0
    for grid in (height_m, height_m.T):
        length = len(grid) - lag * (len(weights) - 1)
        difference = sum(w * grid[k * lag : k * lag + length] for k, w in enumerate(weights))
        missing = np.isnan(difference)
        squares += float(np.square(np.where(missing, 0.0, difference) if missing.any() else difference).sum())
        count += length * grid.shape[1] - int(missing.sum())
    return squares / count if count else math.nan
