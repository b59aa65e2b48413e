"""What a peak's bins show of its error: the quadrature of its offset, and the width of its line.

An estimator's ratio of filters over the bins is complex, and its real part is the offset. White noise and speckle that
changes within the record disturb the ratio by a circular Gaussian number: the imaginary part has the same distribution
as the error, and is independent of it. Where light is a(x) exp(2πjgx), x from -1/2 to 1/2 within the record, the error
is Im(a'/a)/2π to first order, and its quadrature -Re(a'/a)/2π: frequency modulation goes with amplitude modulation,
and only the latter is seen. The laser's phase noise has no such quadrature while its drift is small.

A line wider than a bin shows in the second moment of the powers around the peak.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST
from lidar_emu.receiver.spectrum import BIN, BIN_VARIANCE, NOISE, POWER

MOST_QUADRATURE = 0.5
"""Limit of a quadrature in bins, at which the bins are nothing like a tone's."""

WIDTH_BINS = 8
"""Bins on each side of the peak whose powers give the width."""

WIDTH_POWER_SHARE = 0.09
"""Power of these bins relative to the peak, at least: 0.3 of its amplitude."""

WIDTH_POWER_OVER_NOISE = 7.0
"""Power of these bins relative to the noise, at least."""


class PeakShape(NamedTuple):
    """What the complex ratio of the three Hann-weighted bins shows, in bins and bins²."""

    offset_bin: float
    offset_variance_bin2: float
    """Variance of the offset by noise."""
    quadrature_bin: float
    quadrature_bin2: float
    """Mean square of the looks' quadratures by their power, over the number of looks: the variance of their mean if
    they are independent."""
    quadrature_variance_bin2: float
    """Variance of `quadrature_bin` by noise."""
    drift_bin: float
    """Change of the offset from look to look, by weighted regression; 0 for one look."""


@kernel
def peak_shape(grid: SingleArray, bins: SingleArray, j: int, length: float) -> PeakShape:
    """Offset, its quadrature and its drift by three Hann-weighted bins H, computed from five rectangular ones.

    The tone's offset solves q = (H₋ - H₊)/(2 H₀ + H₋ + H₊) = 3δ / (2 (1 - δ²)); the root of the quadratic is written
    in the form without 0/0 at δ = 0. Quadrature and drift are divided by the slope of q over the offset, which to first
    order follows from q alone. They are 0, with a bin's width as variance, where the tone is beside its image, at 0 and
    N/2.

    Args:
        grid, bins, j: as in `peak_interpolation.peak`.
        length: N.
    """
    real = imaginary = power = squares = 0.0
    late_real = late_power = late2_power = 0.0
    looks = bins.shape[0]
    for look in range(looks):
        along, across, strength = _hann_products(bins[look, 0, j - 2 : j + 3], bins[look, 1, j - 2 : j + 3])
        real += along
        imaginary += across
        power += strength
        if strength > 0.0:
            squares += across * across / strength
        late_real += look * along
        late_power += look * strength
        late2_power += look * look * strength
    level = np.float64(grid[NOISE, j])
    signal = max(power - _LOW_NOISE * (looks - 1) * level, power / looks)
    if not signal > 0.0:
        return PeakShape(0.0, 1.0, 0.0, 0.0, 1.0, 0.0)
    q = real / signal
    offset = 2.0 * q / (1.5 + sqrt(2.25 + 4.0 * q * q))
    by_noise = 0.5 * level * (_TOP_NOISE + _LOW_NOISE * q * q) / signal * (power / signal)
    square = offset * offset
    per_slope = (1.0 - square) ** 2 / (1.5 * (1.0 + square))
    variance = by_noise * per_slope * per_slope
    if grid[BIN, j] <= 2.0 or grid[BIN, j] >= 0.5 * length - 2.0:
        return PeakShape(offset, variance, 0.0, 0.0, BIN_VARIANCE, 0.0)
    square = min(square, 0.5)
    per_slope = (1.0 - square) ** 2 / (1.5 * (1.0 + square))
    bounded = min(max(by_noise * per_slope * per_slope, 1e-12), 1.0)
    quadrature = min(max(imaginary / signal * per_slope, -MOST_QUADRATURE), MOST_QUADRATURE)
    square_bin2 = squares / (looks * signal) * (power / signal) * per_slope * per_slope
    drift = 0.0
    spread = late2_power - late_power * late_power / power
    if looks > 1 and spread > 0.0:
        drift = (late_real - late_power * real / power) / spread * per_slope
    drift = min(max(drift, -MOST_QUADRATURE), MOST_QUADRATURE)
    return PeakShape(offset, variance, quadrature, min(square_bin2, MOST_QUADRATURE**2), bounded, drift)


_TOP_NOISE, _LOW_NOISE = 10.0, 6.0
"""Sums of the squared taps of the two filters."""


@kernel
def _hann_products(re: SingleArray, im: SingleArray) -> tuple[float, float, float]:
    """Re and Im of the product of H₋ - H₊ and the conjugate of 2 H₀ + H₋ + H₊, times 16, and the latter's power."""
    a, b, c, d, e = (
        np.float64(re[0]),
        np.float64(re[1]),
        np.float64(re[2]),
        np.float64(re[3]),
        np.float64(re[4]),
    )
    top_re, low_re = 2.0 * (b - d) - a + e, 2.0 * c - a - e
    a, b, c, d, e = (
        np.float64(im[0]),
        np.float64(im[1]),
        np.float64(im[2]),
        np.float64(im[3]),
        np.float64(im[4]),
    )
    top_im, low_im = 2.0 * (b - d) - a + e, 2.0 * c - a - e
    return (
        top_re * low_re + top_im * low_im,
        top_im * low_re - top_re * low_im,
        low_re * low_re + low_im * low_im,
    )


@kernel(fastmath=FAST)
def width_bin2(grid: SingleArray, j: int, count: int, noise_power: float) -> float:
    """Second moment of the strong powers around the peak about their centre, in bins².

    Beside a narrow line the second neighbours are weak. What is strong farther away is then not part of it.

    Args:
        grid: (ROWS, capacity) of which `count` columns are in use; see `spectrum`.
        j: column of the peak.
        noise_power: mean noise power of a windowed bin relative to a rectangular one.
    """
    power, here = grid[POWER], np.float64(grid[POWER, j])
    floor = max(WIDTH_POWER_SHARE * here, WIDTH_POWER_OVER_NOISE * noise_power * np.float64(grid[NOISE, j]))
    next_but_one = max(power[max(j - 2, 0)], power[min(j + 2, count - 1)])
    reach = WIDTH_BINS if next_but_one > floor else 1
    total = first = second = 0.0
    for i in range(max(j - reach, 0), min(j + reach + 1, count)):
        if power[i] > floor:
            place = np.float64(grid[BIN, i] - grid[BIN, j])
            if abs(place) <= reach:
                strength = np.float64(power[i])
                total += strength
                first += strength * place
                second += strength * place * place
    return (second - first * first / total) / total if total > 0.0 else 0.0
