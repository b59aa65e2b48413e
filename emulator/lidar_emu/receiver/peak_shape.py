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

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST
from lidar_emu.receiver.peak_interpolation import BIN_VARIANCE
from lidar_emu.receiver.spectrum import BIN, NOISE, POWER

MOST_QUADRATURE = 0.5
"""Limit of a quadrature in bins, at which the bins are nothing like a tone's."""

WIDTH_BINS = 8
"""Bins on each side of the peak whose powers give the width."""

WIDTH_POWER_SHARE = 0.09
"""Power of these bins relative to the peak, at least: 0.3 of its amplitude."""

WIDTH_POWER_OVER_NOISE = 7.0
"""Power of these bins relative to the noise, at least."""


class PeakShape(NamedTuple):
    """What the complex ratio of the three Hann-weighted bins shows beside the offset, in bins and bins²."""

    quadrature_bin: float
    quadrature_bin2: float
    """Mean square of the looks' quadratures by their power, over the number of looks: the variance of their mean if
    they are independent."""
    quadrature_variance_bin2: float
    """Variance of `quadrature_bin` by noise."""
    drift_bin: float
    """Change of the offset from look to look, by weighted regression; 0 for one look."""


@kernel(fastmath=FAST)
def peak_shape(grid: FloatArray, bins: FloatArray, j: int, length: float) -> PeakShape:
    """Quadrature and drift of the offset by three Hann-weighted bins.

    Both are 0, with a bin's width as variance, where the tone is beside its image, at 0 and N/2.

    With the ratio q of `peak_interpolation` all are divided by the slope of q over the offset, which is positive. To
    first order the slope follows from q alone.

    Args:
        grid, bins, j: as in `peak_interpolation.peak`.
        length: N.
    """
    real = imaginary = power = squares = 0.0
    late_real = late_power = late2_power = 0.0
    looks = bins.shape[0]
    for look in range(looks):
        re, im = bins[look, 0], bins[look, 1]
        top_re = 2.0 * (re[j - 1] - re[j + 1]) - re[j - 2] + re[j + 2]
        top_im = 2.0 * (im[j - 1] - im[j + 1]) - im[j - 2] + im[j + 2]
        low_re = 2.0 * re[j] - re[j - 2] - re[j + 2]
        low_im = 2.0 * im[j] - im[j - 2] - im[j + 2]
        along = top_re * low_re + top_im * low_im
        across = top_im * low_re - top_re * low_im
        strength = low_re * low_re + low_im * low_im
        real += along
        imaginary += across
        power += strength
        if strength > 0.0:
            squares += across * across / strength
        late_real += look * along
        late_power += look * strength
        late2_power += look * look * strength
    signal = max(power - 6.0 * (looks - 1) * grid[NOISE, j], power / looks)
    if not signal > 0.0:
        return PeakShape(0.0, 0.0, 1.0, 0.0)
    if grid[BIN, j] <= 2.0 or grid[BIN, j] >= 0.5 * length - 2.0:
        return PeakShape(0.0, 0.0, BIN_VARIANCE, 0.0)
    q = real / signal
    offset = 2.0 * q / (1.5 + sqrt(2.25 + 4.0 * q * q))
    square = min(offset * offset, 0.5)
    per_slope = (1.0 - square) ** 2 / (1.5 * (1.0 + square))
    noise = 10.0 + 6.0 * q * q
    variance = 0.5 * grid[NOISE, j] * noise / signal * (power / signal) * per_slope * per_slope
    quadrature = min(max(imaginary / signal * per_slope, -MOST_QUADRATURE), MOST_QUADRATURE)
    square_bin2 = squares / (looks * signal) * (power / signal) * per_slope * per_slope
    spread = late2_power - late_power * late_power / power
    drift = 0.0
    if looks > 1 and spread > 0.0:
        drift = (late_real - late_power * real / power) / spread * per_slope
    return PeakShape(
        quadrature,
        min(square_bin2, MOST_QUADRATURE**2),
        min(max(variance, 1e-12), 1.0),
        min(max(drift, -MOST_QUADRATURE), MOST_QUADRATURE),
    )


@kernel(fastmath=FAST)
def width_bin2(grid: FloatArray, j: int, count: int, noise_power: float) -> float:
    """Second moment of the strong powers around the peak about their centre, in bins².

    Beside a narrow line the second neighbours are weak. What is strong farther away is then not part of it.

    Args:
        grid: (ROWS, capacity) of which `count` columns are in use; see `spectrum`.
        j: column of the peak.
        noise_power: mean noise power of a windowed bin relative to a rectangular one.
    """
    floor = max(WIDTH_POWER_SHARE * grid[POWER, j], WIDTH_POWER_OVER_NOISE * noise_power * grid[NOISE, j])
    next_but_one = max(grid[POWER, max(j - 2, 0)], grid[POWER, min(j + 2, count - 1)])
    reach = WIDTH_BINS if next_but_one > floor else 1
    total = first = second = 0.0
    for i in range(max(j - reach, 0), min(j + reach + 1, count)):
        place = grid[BIN, i] - grid[BIN, j]
        if grid[POWER, i] > floor and abs(place) <= reach:
            total += grid[POWER, i]
            first += grid[POWER, i] * place
            second += grid[POWER, i] * place * place
    return (second - first * first / total) / total if total > 0.0 else 0.0
