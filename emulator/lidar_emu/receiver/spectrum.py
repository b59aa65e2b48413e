"""Bins of the FFT of a record of real tones and white noise, without the FFT.

All phases are referred to the centre of the record: bin k is the bin of the ordinary transform times exp(-jπk/N). The
exact rectangular-window bin of tones of complex weight w at n + δ bins, scaled so that a tone on its bin gives w, is
then a sum with real kernels (the transform is a geometric series):

    Y[k] = Σ (-1)^n sin(πδ)/N · ( w / sin(π(n - k + δ)/N)  +  conj(w) / sin(π(n + k + δ)/N) ),

the second term being the image that a real-valued tone has at negative frequency. Beyond the ends Y[-k] = conj Y[k] and
Y[N/2 + m] = -conj Y[N/2 - m]. A window is a three-tap filter over bins, with neighbours rotated by exp(±jπ/N), for
signal and noise alike.

A spectrum consists of two arrays of which the first columns are in use: a grid (ROWS, capacity) with the attributes of
bins, and bins (2, capacity) with real and imaginary parts; several looks share a grid. They are in single precision,
whose rounding is 1e-6 of the strongest tone: 60 dB below noise at an SNR of 60 dB. Beats are in double precision, and
bins whole numbers below 2**23: (n - k) + δ loses nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import IntArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import NOISE_BINS, Normals, reserve_numbers
from lidar_emu.numerics.vectors import FAST, sin_pi

BIN, NOISE, POWER, TOP, LOW = range(5)
"""Rows of a grid: index k of the bin, mean noise power of the rectangular bin, power under the window, and taps of a
peak's two filters (`peak_interpolation`)."""
ROWS = 5

LANES = 8
"""Tones are padded to a multiple of it with tones of no weight, and bins are computed in whole vectors of it."""

SEGMENT_INDICES = 2**24
"""Random number indices reserved for the bins of each record; N is at most 2**24."""

BIN_VARIANCE = 1.0 / 12.0
"""Variance of a frequency rounded to whole bins, in bins²."""

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


@kernel
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
def lay_bins(
    tone_bin: SingleArray,
    reach: float,
    length: float,
    scratch: SingleArray,
    grid: SingleArray,
    ends: IntArray,
) -> int:
    """Choose the bins around tones, ascending and without gaps within each interval.

    Args:
        tone_bin: (tones,) whole bins nearest to the tones, in any order.
        reach: bins on each side of a tone, at least TAPS.
        length: N.
        scratch: (tones,) overwritten.
        grid: (ROWS, capacity) receives BIN, from -TAPS to N/2 + TAPS; see `grid_capacity`.
        ends: (tones + 1,) receives the number of intervals and the column behind each.

    Returns:
        The number of bins. Adjacent and overlapping intervals are merged.
    """
    lowest, highest = tone_bin[0], tone_bin[0]
    for i in range(1, len(tone_bin)):
        lowest, highest = min(lowest, tone_bin[i]), max(highest, tone_bin[i])
    ends[0] = 0
    if highest - lowest <= _ONE_INTERVAL:
        count = _lay_interval(lowest - reach, highest + reach, length, grid, 0, ends)
    else:
        _sort(tone_bin, scratch)
        count = 0
        first = scratch[0]
        for i in range(1, len(tone_bin)):
            if scratch[i] - scratch[i - 1] > 2.0 * reach + 1.0:
                count = _lay_interval(first - reach, scratch[i - 1] + reach, length, grid, count, ends)
                first = scratch[i]
        count = _lay_interval(first - reach, highest + reach, length, grid, count, ends)
    # Padding, since whole vectors of bins are computed.
    last = grid[BIN, count - 1]
    for j in range(count, whole_vectors(count)):
        grid[BIN, j] = last + np.float32(j - count + 1)
    return count


@kernel
def whole_vectors(count: int) -> int:
    """A number rounded up to whole vectors."""
    return -(-count // LANES) * LANES


def grid_capacity(tones: int, reach: int, length: float) -> int:
    """Number of columns of a spectrum of `tones` tones, in whole vectors; at most all bins."""
    bins = min(tones * (2 * reach + 2) + int(_ONE_INTERVAL), int(length) // 2 + 2 * TAPS + 2)
    return int(-(-bins // LANES) * LANES)


@kernel
def _lay_interval(
    first: float, last: float, length: float, grid: SingleArray, count: int, ends: IntArray
) -> int:
    k = max(first, -float(TAPS))
    bins = int(min(last, 0.5 * length + TAPS) - k) + 1
    row = grid[BIN, count:]
    for j in range(bins):
        row[j] = np.float32(k + j)
    ends[0] += 1
    ends[ends[0]] = count + bins
    return count + bins


@kernel
def _sort(values: SingleArray, ascending: SingleArray) -> None:
    for i in range(len(values)):
        j = i
        while j > 0 and ascending[j - 1] > values[i]:
            ascending[j] = ascending[j - 1]
            j -= 1
        ascending[j] = values[i]


@kernel
def reserve_noise(
    beam: int, first_index: int, grid: SingleArray, ends: IntArray, at: int, into: Normals
) -> int:
    """Reserve the noise of all bins in columns `at`, even, and on; a bin's noise depends on its own index alone. For
    the arguments see `add_noise`.

    Returns:
        The column behind the last.
    """
    start = 0
    for interval in range(ends[0]):
        stop = ends[interval + 1]
        # Numbers come in pairs; bins below 0 have none.
        first = max(0, int(grid[BIN, start]))
        numbers = int(grid[BIN, stop - 1]) - first + 1 + first % 2
        at = reserve_numbers(beam, NOISE_BINS, first_index + first - first % 2, numbers, at, into)
        start = stop
    return at


@kernel
def add_noise(
    length: float,
    grid: SingleArray,
    level: int,
    ends: IntArray,
    bins: SingleArray,
    at: int,
    drawn: Normals,
) -> None:
    """Add noise to rectangular bins.

    Args:
        length: N.
        grid: grid from `lay_bins`.
        level: row of the grid with the mean power.
        ends: ends of the intervals, from `lay_bins`.
        bins: (2, capacity).
        at: column of the first number of `reserve_noise`.
        drawn: their numbers.
    """
    half = int(0.5 * length)
    start = 0
    for interval in range(ends[0]):
        stop = ends[interval + 1]
        lowest = int(grid[BIN, start])
        first = max(0, lowest)
        # Column of the bin 0, if it had one, and of its number.
        zero, number = start - lowest, at + first % 2 - first
        begin, end = max(start, zero + 1), min(stop, zero + half)
        shift = number - zero
        _add_scaled(
            grid[level, begin:end],
            drawn.re[begin + shift :],
            drawn.im[begin + shift :],
            bins[0, begin:end],
            bins[1, begin:end],
        )
        # The transform of a real record is real at 0 and imaginary at N/2, with the same mean power.
        if start <= zero < stop:
            bins[0, zero] += np.sqrt(np.float32(2.0) * grid[level, zero]) * drawn.re[number]
        if start <= zero + half < stop:
            bins[1, zero + half] += (
                np.sqrt(np.float32(2.0) * grid[level, zero + half]) * drawn.re[number + half]
            )
        count = int(grid[BIN, stop - 1]) - first + 1 + first % 2
        at += count + count % 2
        start = stop


@kernel(fastmath=FAST)
def _add_scaled(power: SingleArray, x: SingleArray, y: SingleArray, re: SingleArray, im: SingleArray) -> None:
    for j in range(len(power)):
        level = np.sqrt(power[j])
        re[j], im[j] = re[j] + level * x[j], im[j] + level * y[j]


@kernel
def mirror_ends(length: float, grid: SingleArray, count: int, bins: SingleArray) -> None:
    """Set the bins below 0 and above N/2 from their mirror images."""
    if grid[BIN, 0] >= 0.0 and grid[BIN, count - 1] <= 0.5 * length:
        return
    for j in range(count):
        k = np.float64(grid[BIN, j])
        if k < 0.0:
            mirrored = j - 2 * int(k)
            bins[0, j] = bins[0, mirrored]
            bins[1, j] = -bins[1, mirrored]
        elif k > 0.5 * length:
            mirrored = j - 2 * int(k - 0.5 * length)
            bins[0, j] = -bins[0, mirrored]
            bins[1, j] = bins[1, mirrored]


@kernel(fastmath=FAST)
def set_power(
    window: SpectralWindow,
    length: float,
    lowest_bin: float,
    grid: SingleArray,
    ends: IntArray,
    bins: SingleArray,
) -> None:
    """Set POWER, the mean over looks, of bins that can hold a target; `bins` is (looks, 2, capacity).

    It is 0 below `lowest_bin`, at 0 and N/2, and in the outer TAPS bins of an interval. The window's side taps rotate
    by exp(±jπ/N).
    """
    count = ends[ends[0]]
    power, share = grid[POWER], np.float32(1.0 / bins.shape[0])
    centre = np.float32(window.centre)
    side_cosine = np.float32(window.side * sin_pi(0.5 - 1.0 / length))
    side_sine = np.float32(window.side * sin_pi(1.0 / length))
    # Beyond the bins in use, too, up to whole vectors.
    for j in range(whole_vectors(count)):
        power[j] = 0.0
    for look in range(bins.shape[0]):
        _add_power((centre, side_cosine, side_sine, share), count, bins[look, 0], bins[look, 1], power)
    start = 0
    for interval in range(ends[0]):
        stop = ends[interval + 1]
        power[start : start + TAPS] = 0.0
        power[stop - TAPS : stop] = 0.0
        # Column of bin 0, if it had one.
        zero = start - int(grid[BIN, start])
        power[start : max(start, min(stop, zero + max(1, int(np.ceil(lowest_bin)))))] = 0.0
        power[min(stop, max(start, zero + int(0.5 * length))) : stop] = 0.0
        start = stop


@kernel(fastmath=FAST)
def _add_power(
    taps: tuple[np.float32, np.float32, np.float32, np.float32],
    count: int,
    re: SingleArray,
    im: SingleArray,
    power: SingleArray,
) -> None:
    centre, cosine, sine, share = taps
    for j in range(1, count - 1):
        x = centre * re[j] + cosine * (re[j - 1] + re[j + 1]) - sine * (im[j + 1] - im[j - 1])
        y = centre * im[j] + cosine * (im[j - 1] + im[j + 1]) + sine * (re[j + 1] - re[j - 1])
        power[j] += share * (x * x + y * y)
