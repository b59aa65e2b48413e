"""Sub-bin interpolation of a spectrum's peak: five methods, each with its variance.

All but the bin's centre and the parabola are ratios of two filters over the rectangular bins Y around the peak,

    q = Σ Re(T conj L) / Σ |L|²,    T = Σ t[m] Y[k+m],    L = Σ l[m] Y[k+m],

summed over looks. Bins are referred to the record's centre: for one tone at offset δ they are one complex number times
the real kernel sin(πδ) / (N sin(π(δ - m)/N)), so that the filters are real, no neighbour needs a phase rotation, and
windows are symmetric about the centre. To first order in white noise of power σ²,

    var q = σ²/2 Σ (t[m] - q l[m])² / Σ |L|².

The noise in Σ |L|² would bias q towards 0 with many looks; the contribution of looks beyond the first is subtracted
(the noise of a single look leaves its ratio unbiased).

Averaged over positions in the bin, the errors are 1.5 (Jacobsen), 1.8 (Hann) and 1.03 (Aboutanios-Mulgrew) times the
Cramér-Rao bound, 0.3898 bin / sqrt(snr). Only Aboutanios and Mulgrew's subtracts the tone's image at the negative
frequency.
"""

from __future__ import annotations

from math import asin, copysign, log, pi, sin, sqrt
from typing import Any, TypeVar

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST, sin_pi
from lidar_emu.receiver.peak_shape import MOST_QUADRATURE, PeakShape
from lidar_emu.receiver.spectrum import BIN, BIN_VARIANCE, LOW, NOISE, POWER, TAPS, TOP, SpectralWindow

BIN_CENTRE, PARABOLA, JACOBSEN, HANN, ABOUTANIOS_MULGREW = range(5)
PEAK_METHODS = {
    "bin": BIN_CENTRE,
    "parabola": PARABOLA,
    "jacobsen": JACOBSEN,
    "hann": HANN,
    "aboutanios_mulgrew": ABOUTANIOS_MULGREW,
}
"""Methods by their names in a scenario."""

CRAMER_RAO_BIN2 = 0.3898**2
"""Cramér-Rao bound: least variance of a tone's frequency in bins² times its SNR."""

EFFICIENCY = (1.0, 3.24, 2.4, 3.24, 1.1)
"""Variance of each method by noise, relative to the bound, averaged over positions in the bin."""

FLICKER_SCATTER = (3.71, 3.71, 3.71, 4.83, 3.07)
"""Standard deviation of each method's rate of the laser's frequency by 1/f noise of the density k/f, times T_rec/√k.

An estimate is the mean of the frequency with weights g over the record: its deviation is 2π (∫ f |G(f T_rec)|² df)^½ of
their transform G. With x from -1/2 to 1/2, g is 1 + cos 2πx (`jacobsen`), its square (`hann`), cos πx
(`aboutanios_mulgrew`), and -∫ x w dx of a window w at the highest of its bins (`bin` and `parabola`, here for
`hamming`; 3 for `rect` and 4.18 for `hann`). Least squares on the phase, 1 - 4x², has 3."""

_WEIGHTS = 1024
"""Parts of a record in `passed_modulation`."""

_LEAST_VARIANCE = 1e-12
"""Lower limit of the variance, at which the estimate is exact to rounding; it keeps weights finite."""

_MOST_VARIANCE = 1.0 / 3.0
"""Variance of an offset that is uniform within a bin on either side."""

_SPAN = 6
"""Bins on each side of the peak from which Aboutanios and Mulgrew's half-bin transforms are computed, where available.
"""

_Numbers = TypeVar("_Numbers", float, FloatArray)

_ONE: Any = np.int64(1)
"""Taps on each side; a variable, since numba would compile filters for each literal."""

_ITERATIONS = 2
"""Iterations after Hann's estimate. At 20 dB a third one moves it by 0.0009 bin rms, and further ones by 0.0002."""

_IMAGE_REACH = 256.0
"""Bins from 0 and N/2 up to which the tone's image is subtracted; beyond, it moves the estimate by up to 3e-4 bin."""

_WIDE_QUADRATURE = 0.3
"""Quadrature in bins that is raised by half: lines wider than 0.2 bin show less of it than they err."""

_LEAST_DISTANCE = 1e-7
"""Least distance of a tone from a bin's centre in bins, against 0/0."""

_BISECTIONS = 10
"""Iterations to the position in the half bin whose tone gives a parabola's vertex."""


def passed_modulation(method: int, window: SpectralWindow, frequency_bin: float) -> float:
    """Response of an estimate to a modulation of the tone's frequency at this frequency, relative to a slow one.

    The transform G of the weights of `FLICKER_SCATTER`. With weights g that fall to 0 at the ends of the record,
    ∫ g cos(2πfx) dx = -∫ g' sin(2πfx)/(2πf) dx, and g' is -x w for a window w.
    """
    x = (np.arange(_WEIGHTS) + 0.5) / _WEIGHTS - 0.5
    turns = 2.0 * np.pi * frequency_bin
    if method in (BIN_CENTRE, PARABOLA):
        inertia = x * (window.centre - 2.0 * window.side * np.cos(2.0 * np.pi * x))
        return float(inertia @ (x * np.sinc(2.0 * frequency_bin * x)) / (inertia @ x))
    if method == ABOUTANIOS_MULGREW:
        weights = np.cos(np.pi * x)
    else:
        weights = (1.0 + np.cos(2.0 * np.pi * x)) ** (2 if method == HANN else 1)
    return float(weights @ np.cos(turns * x) / weights.sum())


@kernel
def noise_bin2(method: int, snr: _Numbers) -> _Numbers:
    """Variance of a frequency by noise in bins², at the SNR of a rectangular bin."""
    variance: _Numbers = EFFICIENCY[method] * CRAMER_RAO_BIN2 / snr
    return variance


@kernel
def rounding_bin2(method: int) -> float:
    """Variance of a frequency by rounding to bins, in bins²."""
    return BIN_VARIANCE if method == BIN_CENTRE else 0.0


@kernel
def peak(
    method: int,
    grid: SingleArray,
    bins: SingleArray,
    j: int,
    window: SpectralWindow,
    length: float,
    shape: PeakShape,
) -> tuple[float, float, PeakShape]:
    """Offset from column `j` of the tone that has its peak there, the estimate's variance, and its shape.

    Within two bins of 0 and N/2, where a tone's own image biases every formula by up to half a bin, the variance
    is at least a rounded bin's.

    Args:
        method: one of PEAK_METHODS.
        grid: (ROWS, capacity) with BIN, NOISE and POWER, the mean over looks; see `spectrum`. The filters' taps are
            written to TOP and LOW.
        bins: (looks, 2, capacity) real and imaginary part of the rectangular bins, referred to the record's centre.
        j: column of the peak. Columns to j ± TAPS are its neighbours, and so for each column that has a power.
        window: window under which the powers are.
        length: N.
        shape: from `peak_shape`, which holds Hann's estimate.

    Returns:
        The offset in bins, between -1 and 1 whatever the bins hold, and its variance in bins², between 1e-12 and
        1/3; and `shape`, with the quadrature of Aboutanios and Mulgrew's ratio if the offset is by it and of one look.
    """
    if method == BIN_CENTRE:
        return 0.0, BIN_VARIANCE, shape
    quadrature = 0.0
    if method == HANN:
        offset, variance = shape.offset_bin, shape.offset_variance_bin2
    elif method == PARABOLA:
        offset, variance = _parabola(grid, bins.shape[0], j, window)
    elif method == JACOBSEN:
        offset, variance = _jacobsen(grid, bins, j, length)
    else:
        offset, variance, quadrature = _aboutanios_mulgrew(grid, bins, j, length, shape.offset_bin)
    if not (abs(offset) <= 1.0 and variance <= _MOST_VARIANCE):  # Also for NaN: bins without any power.
        offset = min(max(offset, -1.0), 1.0) if abs(offset) > 0.0 else 0.0
        variance = _MOST_VARIANCE
    # Beyond three quarters of a bin the neighbour would be the highest bin: the estimate is noise.
    if abs(offset) > 0.75 or grid[BIN, j] <= 2.0 or grid[BIN, j] >= 0.5 * length - 2.0:
        variance = _MOST_VARIANCE if abs(offset) <= 0.75 else max(variance, BIN_VARIANCE)
    variance = max(variance, _LEAST_VARIANCE)
    if method == ABOUTANIOS_MULGREW and bins.shape[0] == 1 and variance < _MOST_VARIANCE:
        shape = PeakShape(offset, variance, quadrature, quadrature * quadrature, variance, 0.0)
    return offset, variance, shape


@kernel(fastmath=FAST)
def _jacobsen(grid: SingleArray, bins: SingleArray, j: int, length: float) -> tuple[float, float]:
    """Three rectangular bins, after Jacobsen; exact for any N, after Candan (2011).

    The ratio of Y₋ - Y₊ to 2 cos(π/N) Y₀ - Y₋ - Y₊ is sin(2πδ/N) / sin(2π/N), for long records δ itself.
    """
    grid[TOP, j - 1], grid[TOP, j], grid[TOP, j + 1] = 1.0, 0.0, -1.0
    grid[LOW, j - 1], grid[LOW, j], grid[LOW, j + 1] = -1.0, 2.0 * sin_pi(0.5 - 1.0 / length), -1.0
    q, _, variance = _ratio(grid, bins, j, _ONE, (0.0, 0.0))
    angle = 2.0 * pi / length
    return asin(min(max(q, -1.0), 1.0) * sin(angle)) / angle, variance


@kernel(fastmath=FAST)
def _aboutanios_mulgrew(
    grid: SingleArray, bins: SingleArray, j: int, length: float, offset: float
) -> tuple[float, float, float]:
    """Offset, variance and quadrature, after Aboutanios and Mulgrew (2005): iterate on the transform half a bin to
    either side of the estimate, at first `offset`.

    The transform of the record between bins is a sum over all bins; here only the available bins contribute, up to
    _SPAN on each side of the peak. The missing ones are accounted for by the estimate: the measured ratio is compared
    with the ratio of a pure tone over the same bins. A pure tone therefore has no bias, and the missing bins cost about
    5 % of the standard deviation. Factors that all bins of a tone share are left out.
    """
    span = TAPS
    # A column with power has its neighbours up to ±TAPS.
    while span < _SPAN and min(grid[POWER, j - span + TAPS - 1], grid[POWER, j + span - TAPS + 1]) > 0.0:
        span += 1
    quadrature = variance = 0.0
    slope = 1.0
    for _ in range(_ITERATIONS):
        below = _tone_bin(offset + 0.5 + span, length)
        for m in range(-span, span + 1):
            above, below = below, _tone_bin(offset - 0.5 - m, length)
            grid[TOP, j + m], grid[LOW, j + m] = np.float32(above + below), np.float32(above - below)
        expected, image = _filtered_tone(grid, j, span, offset, length)
        q, quadrature, variance = _ratio(grid, bins, j, span, image)
        # 2 for all bins; the sum of 1/x² over the missing ones is close to 2/(span + 1/2).
        slope = 2.0 - 2.0 / (2.0 * span + 1.0) * sin_pi(0.5 - min(abs(offset), 1.0)) ** 2
        offset = min(max(offset + (q - expected) / slope, -1.0), 1.0)
    quadrature /= slope
    quadrature *= 1.0 + 0.5 * (quadrature / _WIDE_QUADRATURE) ** 4
    return offset, variance / (slope * slope), min(max(quadrature, -MOST_QUADRATURE), MOST_QUADRATURE)


@kernel(fastmath=FAST)
def _ratio(
    grid: SingleArray, bins: SingleArray, j: int, span: int, image: tuple[float, float]
) -> tuple[float, float, float]:
    """The ratio of the two filters in TOP and LOW, `span` taps on each side of column `j`: real and imaginary part, and
    variance. `image` has the filters' outputs by the tone's image, over LOW's by the tone."""
    product = across = power = 0.0
    for look in range(bins.shape[0]):
        top_re = top_im = low_re = low_im = 0.0
        for i in range(j - span, j + span + 1):
            re, im = np.float64(bins[look, 0, i]), np.float64(bins[look, 1, i])
            top_re += grid[TOP, i] * re
            top_im += grid[TOP, i] * im
            low_re += grid[LOW, i] * re
            low_im += grid[LOW, i] * im
        # The image's amplitude is the conjugate of the tone's.
        low_re, low_im = low_re / (1.0 + image[1]), low_im / (1.0 - image[1])
        top_re, top_im = top_re - image[0] * low_re, top_im + image[0] * low_im
        product += top_re * low_re + top_im * low_im
        across += top_im * low_re - top_re * low_im
        power += low_re * low_re + low_im * low_im
    low_noise = 0.0
    for i in range(j - span, j + span + 1):
        low_noise += np.float64(grid[LOW, i]) ** 2
    looks = bins.shape[0]
    signal = max(power - (looks - 1) * low_noise * grid[NOISE, j], power / looks)
    q = product / signal
    noise = 0.0
    for i in range(j - span, j + span + 1):
        noise += (np.float64(grid[TOP, i]) - q * np.float64(grid[LOW, i])) ** 2
    return q, across / signal, 0.5 * grid[NOISE, j] * noise / signal * (power / signal)


@kernel(fastmath=FAST)
def _filtered_tone(
    grid: SingleArray, j: int, span: int, offset: float, length: float
) -> tuple[float, tuple[float, float]]:
    """TOP's output by a tone at this offset, and both filters' outputs by its image, over LOW's output by the tone."""
    place = np.float64(grid[BIN, j])
    top = low = top_image = low_image = 0.0
    for m in range(-span, span + 1):
        here = _tone_bin(offset - m, length)
        top += grid[TOP, j + m] * here
        low += grid[LOW, j + m] * here
        if not _IMAGE_REACH < place < 0.5 * length - _IMAGE_REACH:
            sine = sin(pi * (2.0 * place + offset + m) / length)
            image = 1.0 / (length * copysign(max(abs(sine), pi * _LEAST_DISTANCE / length), sine))
            top_image += grid[TOP, j + m] * image
            low_image += grid[LOW, j + m] * image
    return top / low, (top_image / low, low_image / low)


@kernel(fastmath=FAST)
def _tone_bin(x: float, length: float) -> float:
    """A tone x bins beside a bin, there, over the sine of its position: 1 / (N sin(πx/N)) to the third order."""
    angle = pi * copysign(max(abs(x), _LEAST_DISTANCE), x)
    return 1.0 / angle + angle / (6.0 * length * length)


@kernel(fastmath=FAST)
def _parabola(grid: SingleArray, looks: int, j: int, window: SpectralWindow) -> tuple[float, float]:
    """Vertex of the parabola through the log powers of three bins under the window.

    A window's main lobe is not exactly a parabola: the vertex is biased by up to 0.016 bin with Hann and Hamming (rms
    0.011) and by up to 0.17 without a window (rms 0.12). The variance includes the square of that bias at the estimate.
    To first order in the powers P, the remaining variance follows from

        cov(ln P_a, ln P_b) = (2 σ² R A_a A_b + σ⁴ R²) / (looks P_a P_b),

    with A the tone's signed amplitudes and R the correlation of noise under the window, a - b bins apart.
    Without a window a side bin may contain noise alone: at 20 dB the stated standard deviation is then 8 % too large.
    """
    before, here, after = (
        np.float64(grid[POWER, j - 1]),
        np.float64(grid[POWER, j]),
        np.float64(grid[POWER, j + 1]),
    )
    if not min(before, here, after) > 0.0:  # Next to the last bin that can hold a target.
        return 0.0, BIN_VARIANCE
    vertex, _ = _vertex(log(before), log(here), log(after))
    # Consistent with amplitudes without the alternating sign of the bins.
    centre, side = window.centre, -window.side
    correlation = (centre * centre + 2.0 * side * side, 2.0 * centre * side, 1.0 * side * side)
    noise = grid[NOISE, j] / here
    floor = noise * correlation[0]
    place, step, curvature = 0.25, 0.125, 0.0
    amplitudes = powers = (0.0, 0.0, 0.0)
    for _ in range(_BISECTIONS):
        lobe = _lobe(place, centre, side)
        gain = sqrt(max(1.0 - floor, 0.0)) / lobe[1]
        amplitudes = (gain * lobe[0], gain * lobe[1], gain * lobe[2])
        powers = (amplitudes[0] ** 2 + floor, amplitudes[1] ** 2 + floor, amplitudes[2] ** 2 + floor)
        expected, curvature = _vertex(log(powers[0]), log(powers[1]), log(powers[2]))
        place += step if expected < abs(vertex) else -step
        step *= 0.5
    bias = abs(vertex) - place
    if vertex < 0.0:
        amplitudes = (amplitudes[2], amplitudes[1], amplitudes[0])
        powers = (powers[2], powers[1], powers[0])
    slopes = ((0.5 - vertex) / curvature, 2.0 * vertex / curvature, (-0.5 - vertex) / curvature)
    variance = 0.0
    for a in range(3):
        for b in range(3):
            joint = noise * correlation[abs(a - b)]
            covariance = joint * (2.0 * amplitudes[a] * amplitudes[b] + joint) / (powers[a] * powers[b])
            variance += slopes[a] * slopes[b] * covariance
    return vertex, bias * bias + variance / looks


@kernel(fastmath=FAST)
def _vertex(before: float, here: float, after: float) -> tuple[float, float]:
    curvature = before - 2.0 * here + after
    return 0.5 * (before - after) / curvature, curvature


@kernel(fastmath=FAST)
def _lobe(place: float, centre: float, side: float) -> tuple[float, float, float]:
    """Bins -1, 0 and 1 under the window, without alternating sign, of a tone at 0 < `place` <= 1/2."""
    scale = sin_pi(place) / pi
    outer, before, here = 1.0 / (place + 2.0), 1.0 / (place + 1.0), 1.0 / place
    after, beyond = 1.0 / (place - 1.0), 1.0 / (place - 2.0)
    return (
        -scale * (centre * before - side * (here + outer)),
        scale * (centre * here - side * (after + before)),
        -scale * (centre * after - side * (beyond + here)),
    )
