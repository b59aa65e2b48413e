"""Bins of the FFT of a record of real tones and white noise, without the FFT.

All phases are referred to the centre of the record: bin k is the bin of the ordinary transform times exp(-jπk/N). The
exact rectangular-window bin of tones of complex weight w at n + δ bins, scaled so that a tone on its bin gives w, is
then a sum with real kernels (the transform is a geometric series):

    Y[k] = Σ (-1)^n sin(πδ)/N · ( w / sin(π(n - k + δ)/N)  +  conj(w) / sin(π(n + k + δ)/N) ),

the second term being the image that a real-valued tone has at negative frequency. Beyond the ends Y[-k] = conj Y[k] and
Y[N/2 + m] = -conj Y[N/2 - m]. A window is a three-tap filter over bins, with neighbours rotated by exp(±jπ/N), for
signal and noise alike.

A spectrum consists of two arrays of which the first columns are in use: a grid (ROWS, capacity) with the attributes of
bins, and bins (2, capacity) with real and imaginary parts; several looks share a grid.
"""

from __future__ import annotations

from math import copysign, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import NOISE_BINS, fill_complex_normals
from lidar_emu.numerics.vectors import FAST, sin_pi

BIN, COS, SIN, NOISE, POWER, TOP, LOW = range(7)
"""Rows of a grid: index k of the bin, cosine and sine of πk/N, mean noise power of the rectangular bin, power
under the window, and taps of a peak's two filters (`peak_interpolation`)."""
ROWS = 7

TAPS = 2
"""Rectangular bins needed beyond the windowed ones: for the window of a neighbour of the highest bin."""
REACH = 6 + TAPS
"""Bins computed on each side of a tone. With fewer than six, noise beside a tone would change its groups."""

_ONE_INTERVAL = 48.0
"""Tones no farther apart share one interval without being sorted."""


class SpectralWindow(NamedTuple):
    """A window as a filter over bins."""

    centre: float
    side: float

    @property
    def noise_power(self) -> float:
        """Mean power of windowed noise that has unit power in a rectangular bin."""
        return self.centre**2 + 2 * self.side**2


WINDOWS = {
    "rect": SpectralWindow(1.0, 0.0),
    "hann": SpectralWindow(0.5, -0.25),
    "hamming": SpectralWindow(0.54, -0.23),
}


@kernel(forceinline=True)
def fold(signed_bin: float, length: float) -> tuple[float, float, float]:
    """The bin at which a real-valued receiver observes a tone of signed frequency, and the factors of its weight.

    Returns:
        The observed bin, 0 to N/2, and factors of ±1 for the real and the imaginary part of the weight: a fold at 0
        conjugates the weight; a shift by N changes the phase at the record's centre, half a step from the nearest
        sample, by π.
    """
    shift = np.rint(signed_bin / length)
    nearest = signed_bin - length * shift
    factor = 1.0 if np.rint(0.5 * shift) == 0.5 * shift else -1.0
    return abs(nearest), factor, (factor if nearest >= 0.0 else -factor)


@kernel
def lay_bins(tone_bin: FloatArray, reach: float, length: float, scratch: FloatArray, grid: FloatArray) -> int:
    """Choose the bins around tones, ascending and without gaps within each interval.

    Args:
        tone_bin: (tones,) whole bins nearest to the tones, in any order.
        reach: bins on each side of a tone, at least TAPS.
        length: N.
        scratch: (tones,) overwritten.
        grid: (ROWS, capacity) receives BIN, from -TAPS to N/2 + TAPS, COS and SIN; see `grid_capacity`.

    Returns:
        The number of bins. Adjacent and overlapping intervals are merged.
    """
    lowest, highest = tone_bin[0], tone_bin[0]
    for i in range(1, len(tone_bin)):
        lowest, highest = min(lowest, tone_bin[i]), max(highest, tone_bin[i])
    if highest - lowest <= _ONE_INTERVAL:
        count = _lay_interval(lowest - reach, highest + reach, length, grid, 0)
    else:
        _sort(tone_bin, scratch)
        count = 0
        first = scratch[0]
        for i in range(1, len(tone_bin)):
            if scratch[i] - scratch[i - 1] > 2.0 * reach + 1.0:
                count = _lay_interval(first - reach, scratch[i - 1] + reach, length, grid, count)
                first = scratch[i]
        count = _lay_interval(first - reach, highest + reach, length, grid, count)
    _set_angles(length, grid, count)
    # Padding, since whole vectors of bins may be computed.
    for j in range(count, min(count + 3, grid.shape[1])):
        grid[BIN, j] = grid[BIN, j - 1] + 1.0
    return count


def grid_capacity(tones: int, reach: int, length: float) -> int:
    """Maximum number of columns of a spectrum of `tones` tones; at most all bins."""
    return min(tones * (2 * reach + 2) + int(_ONE_INTERVAL), int(length) // 2 + 2 * TAPS + 2)


@kernel
def _lay_interval(first: float, last: float, length: float, grid: FloatArray, count: int) -> int:
    k = max(first, -float(TAPS))
    last = min(last, 0.5 * length + TAPS)
    while k <= last:
        grid[BIN, count] = k
        count += 1
        k += 1.0
    return count


@kernel
def _sort(values: FloatArray, ascending: FloatArray) -> None:
    for i in range(len(values)):
        j = i
        while j > 0 and ascending[j - 1] > values[i]:
            ascending[j] = ascending[j - 1]
            j -= 1
        ascending[j] = values[i]


@kernel(fastmath=FAST)
def _set_angles(length: float, grid: FloatArray, count: int) -> None:
    for j in range(count):
        grid[COS, j] = sin_pi((0.5 * length - grid[BIN, j]) / length)
        grid[SIN, j] = sin_pi(grid[BIN, j] / length)


@kernel(fastmath=FAST)
def set_tones(tones: FloatArray, length: float, grid: FloatArray, count: int, bins: FloatArray) -> None:
    """Set the first `count` bins, from 0 to N/2, to the sum of tones, at any frequency.

    With a = π(n + δ)/N and b = πk/N the two terms of a tone (see the module) share their denominator:

        1/sin(a - b) + 1/sin(a + b) = 2 sin(a) cos(b) / (sin(a - b) sin(a + b)),
        1/sin(a - b) - 1/sin(a + b) = 2 cos(a) sin(b) / (sin(a - b) sin(a + b)).

    There is no cancellation: a - b is evaluated as (n - k) + δ, the sum for sin(a + b) has no negative term, and
    cosines are sines of the distance to N/2.

    Args:
        tones: (4, tones) n, δ with |δ| <= 1/2, real and imaginary part of the weight.
        length: N.
        grid: grid from `lay_bins`.
        count: bins in use.
        bins: (2, capacity) receives real and imaginary parts.
    """
    per_length = 1.0 / length
    half = 0.5 * length
    numbers, cosines, sines = grid[BIN, :count], grid[COS, :count], grid[SIN, :count]
    re, im = bins[0, :count], bins[1, :count]
    re[:] = 0.0
    im[:] = 0.0
    for i in range(tones.shape[1]):
        n = tones[0, i]
        rest = copysign(max(abs(tones[1, i]), 1e-18), tones[1, i])
        sine = sin_pi((n + rest) * per_length)
        cosine = sin_pi(((half - n) - rest) * per_length)
        sign = -2.0 if int(n) & 1 else 2.0
        scale = sign * sin_pi(rest) * per_length
        share_re = scale * sine * tones[2, i]
        share_im = scale * cosine * tones[3, i]
        for j in range(count):
            difference = sin_pi(((n - numbers[j]) + rest) * per_length)
            kernel = 1.0 / (difference * (sine * cosines[j] + cosine * sines[j]))
            re[j], im[j] = re[j] + share_re * kernel, im[j] + share_im * kernel
    for j in range(count):
        re[j], im[j] = re[j] * cosines[j], im[j] * sines[j]


@kernel
def add_noise(
    beam: Any,
    first_index: int,
    length: float,
    grid: FloatArray,
    level: int,
    count: int,
    bins: FloatArray,
    words: NDArray[np.uint64],
    scratch: FloatArray,
) -> None:
    """Add noise to rectangular bins; a bin's noise depends on its own index alone.

    Args:
        beam: record of the beam, `workspace.BEAM`.
        first_index: even; index of bin 0.
        level: row of the grid with the mean power.
        words, scratch: (4, capacity / 2), (2, capacity) overwritten, two columns longer than any interval.
    """
    start = int(np.int64(0))  # A variable, since numba would compile `_add` once more for a literal.
    while start < count:
        stop = start + 1
        while stop < count and grid[BIN, stop] - grid[BIN, stop - 1] == 1.0:
            stop += 1
        # Numbers come in pairs; bins below 0 have none.
        skipped = max(0, -int(grid[BIN, start]))
        first = int(grid[BIN, start]) + skipped
        needed = stop - start - skipped + first % 2
        drawn = needed + needed % 2
        pair = (first_index + first) // 2
        fill_complex_normals(beam.seed, beam.shot, beam.beam, NOISE_BINS, pair, drawn, words, scratch)
        _add(scratch, first % 2 - start - skipped, start, stop, length, grid, grid[level], bins)
        start = stop


@kernel(fastmath=FAST)
def _add(
    normals: FloatArray,
    shift: int,
    start: int,
    stop: int,
    length: float,
    grid: FloatArray,
    power: FloatArray,
    bins: FloatArray,
) -> None:
    """Add noise to one interval; bin j's is in column j + `shift`."""
    half = 0.5 * length
    zero = start - int(grid[BIN, start])
    nyquist = zero + int(half)
    first, last = max(start, zero + 1), min(stop, nyquist)
    noise, x, y = power[first:last], normals[0, first + shift :], normals[1, first + shift :]
    re, im = bins[0, first:last], bins[1, first:last]
    for j in range(last - first):
        level = np.sqrt(noise[j])
        re[j], im[j] = re[j] + level * x[j], im[j] + level * y[j]
    # The transform of a real record is real at 0 and imaginary at N/2, with the same mean power.
    if start <= zero < stop:
        bins[0, zero] += sqrt(2.0 * power[zero]) * normals[0, zero + shift]
    if start <= nyquist < stop:
        bins[1, nyquist] += sqrt(2.0 * power[nyquist]) * normals[1, nyquist + shift]


@kernel
def mirror_ends(length: float, grid: FloatArray, count: int, bins: FloatArray) -> None:
    """Set the bins below 0 and above N/2 from their mirror images."""
    for j in range(count):
        k = grid[BIN, j]
        if k < 0.0:
            mirrored = j - 2 * int(k)
            bins[0, j] = bins[0, mirrored]
            bins[1, j] = -bins[1, mirrored]
        elif k > 0.5 * length:
            mirrored = j - 2 * int(k - 0.5 * length)
            bins[0, j] = -bins[0, mirrored]
            bins[1, j] = bins[1, mirrored]


@kernel(fastmath=FAST, forceinline=True)
def windowed_bin(
    bins: FloatArray, j: int, centre: float, side: float, cosine: float, sine: float
) -> tuple[float, float]:
    """Column `j` with a window; `cosine` and `sine` belong to the angle π/N."""
    sum_re = bins[0, j - 1] + bins[0, j + 1]
    sum_im = bins[1, j - 1] + bins[1, j + 1]
    rise_re = bins[0, j + 1] - bins[0, j - 1]
    rise_im = bins[1, j + 1] - bins[1, j - 1]
    return (
        centre * bins[0, j] + side * (cosine * sum_re - sine * rise_im),
        centre * bins[1, j] + side * (cosine * sum_im + sine * rise_re),
    )


@kernel(fastmath=FAST)
def set_power(
    centre: float,
    side: float,
    cosine: float,
    sine: float,
    length: float,
    grid: FloatArray,
    count: int,
    bins: FloatArray,
) -> None:
    """Set POWER, the mean over looks, of bins that can hold a target.

    It is 0 at 0 and N/2, and in the outer TAPS bins of an interval. `bins` is (looks, 2, capacity).
    """
    grid[POWER, :count] = 0.0
    share = 1.0 / bins.shape[0]
    for look in range(bins.shape[0]):
        for j in range(TAPS, count - TAPS):
            x, y = windowed_bin(bins[look], j, centre, side, cosine, sine)
            grid[POWER, j] += share * (x * x + y * y)
    for j in range(TAPS, count - TAPS):
        contiguous = grid[BIN, j + TAPS] - grid[BIN, j - TAPS] == 2.0 * TAPS
        if not (contiguous and 0.0 < grid[BIN, j] < 0.5 * length):
            grid[POWER, j] = 0.0
