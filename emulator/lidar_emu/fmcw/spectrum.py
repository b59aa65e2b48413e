"""Bins of the FFT of a record of real tones and white noise, without the FFT.

Everything here is referred to the centre of the record: a tone has its phase there, and bin k is the bin of
the ordinary transform times exp(-jπk/N). The exact rectangular-window bin of tones of complex weight w at n +
δ bins, scaled so that a tone on its bin gives w, is then a sum with real kernels (the transform is a
geometric series):

    Y[k] = Σ (-1)^n sin(πδ)/N · ( w / sin(π(n - k + δ)/N)  +  conj(w) / sin(π(n + k + δ)/N) ),

the second term being the image that a real-valued tone has at negative frequency. Beyond the ends Y[-k] =
conj Y[k] and Y[N/2 + m] = -conj Y[N/2 - m]. A window is a three-tap filter over bins, with neighbours turned
by exp(±jπ/N), on signal and noise alike.

A spectrum is a float array (ROWS, capacity) of which the first bins are in use.
"""

from __future__ import annotations

from math import copysign, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.fmcw.philox import complex_normal
from lidar_emu.fmcw.sine import FAST, sin_pi
from lidar_emu.kernels import njit

BIN, COS, SIN, RE, IM, POWER = range(6)
"""Rows of a spectrum: index of the bin, cosine and sine of πk/N, rectangular bin, power under the window."""
ROWS = 6

TAPS = 2
"""Rectangular bins beyond the windowed ones: a tap of the window of a neighbour of the highest bin."""
REACH = 6 + TAPS
"""Bins computed on each side of a tone. With fewer than six, noise beside a tone changes its groups."""
BINS_PER_TONE = 2 * REACH + 1


class Window(NamedTuple):
    """A window as a filter over bins."""

    centre: float
    side: float

    @property
    def noise_power(self) -> float:
        """Mean power of white noise that has unit power in a rectangular bin."""
        return self.centre**2 + 2 * self.side**2


WINDOWS = {
    "rect": Window(1.0, 0.0),
    "hann": Window(0.5, -0.25),
    "hamming": Window(0.54, -0.23),
}


@njit(cache=True)
def fold(signed_bin: float, length: float) -> tuple[float, float, float]:
    """Where a real-valued receiver sees a tone of signed frequency, and what becomes of its weight.

    Returns:
        The observed bin, 0 to N/2, and factors of ±1 for the real and the imaginary part of the weight: a
        fold at 0 conjugates it; sampled at whole steps, a shift by N turns the phase at the record's centre,
        half a step from the nearest sample, by π.
    """
    shift = np.rint(signed_bin / length)
    nearest = signed_bin - length * shift
    factor = 1.0 if np.rint(0.5 * shift) == 0.5 * shift else -1.0
    return abs(nearest), factor, (factor if nearest >= 0.0 else -factor)


@njit(cache=True, fastmath=FAST)
def lay_bins(tone_bin: FloatArray, length: float, scratch: FloatArray, spectrum: FloatArray) -> int:
    """Choose the bins around tones, ascending and without gaps within each interval.

    Args:
        tone_bin: (tones,) whole bins nearest to the tones, in any order.
        length: N.
        scratch: (tones,) overwritten.
        spectrum: (ROWS, tones * BINS_PER_TONE) receives BIN, from -TAPS to N/2 + TAPS, COS and SIN.

    Returns:
        The number of bins. Intervals that touch or overlap are one.
    """
    for i in range(len(tone_bin)):
        j = i
        while j > 0 and scratch[j - 1] > tone_bin[i]:
            scratch[j] = scratch[j - 1]
            j -= 1
        scratch[j] = tone_bin[i]
    count = 0
    free = -float(TAPS)
    last = 0.5 * length + TAPS
    for i in range(len(tone_bin)):
        k = max(free, scratch[i] - REACH)
        while k <= min(last, scratch[i] + REACH):
            spectrum[BIN, count] = k
            count += 1
            k += 1.0
        free = k
    for j in range(count):
        spectrum[COS, j] = sin_pi((0.5 * length - spectrum[BIN, j]) / length)
        spectrum[SIN, j] = sin_pi(spectrum[BIN, j] / length)
    return count


@njit(cache=True, fastmath=FAST, error_model="numpy")
def set_tones(tones: FloatArray, length: float, spectrum: FloatArray, count: int) -> None:
    """Set RE and IM of the first `count` bins, from 0 to N/2, to the sum of tones.

    With a = π(n + δ)/N and b = πk/N the two terms of a tone (see the module) share their denominator:

        1/sin(a - b) + 1/sin(a + b) = 2 sin(a) cos(b) / (sin(a - b) sin(a + b)),
        1/sin(a - b) - 1/sin(a + b) = 2 cos(a) sin(b) / (sin(a - b) sin(a + b)).

    Nothing cancels: a - b keeps the association (n - k) + δ, the sum that makes sin(a + b) has no negative
    term, and cosines are sines of the distance to N/2.

    Args:
        tones: (4, tones) n, δ with |δ| <= 1/2, real and imaginary part of the weight.
        length: N.
        spectrum: as `lay_bins` leaves it.
        count: bins in use.
    """
    per_length = 1.0 / length
    half = 0.5 * length
    bins, cosines, sines = spectrum[BIN, :count], spectrum[COS, :count], spectrum[SIN, :count]
    re, im = spectrum[RE, :count], spectrum[IM, :count]
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
            difference = sin_pi(((n - bins[j]) + rest) * per_length)
            kernel = 1.0 / (difference * (sine * cosines[j] + cosine * sines[j]))
            re[j] += share_re * kernel
            im[j] += share_im * kernel
    for j in range(count):
        re[j] *= cosines[j]
        im[j] *= sines[j]


@njit(cache=True)
def add_noise(
    seed: np.uint64,
    shot: int,
    beam: int,
    purpose: int,
    first_index: int,
    length: float,
    spectrum: FloatArray,
    count: int,
) -> None:
    """Add white noise of unit mean power to RE and IM; a bin's noise depends on its own index alone."""
    half = 0.5 * length
    for j in range(count):
        k = spectrum[BIN, j]
        if 0.0 <= k <= half:
            x, y = complex_normal(seed, shot, beam, purpose, first_index + int(k))
            # The transform of a real record is real at 0 and N/2, with the same mean power.
            spectrum[RE, j] += x if 0.0 < k < half else (sqrt(2.0) * x if k == 0.0 else 0.0)
            spectrum[IM, j] += y if 0.0 < k < half else (sqrt(2.0) * y if k == half else 0.0)


@njit(cache=True)
def mirror_ends(length: float, spectrum: FloatArray, count: int) -> None:
    """Set the bins below 0 and above N/2 from those that they mirror."""
    for j in range(count):
        k = spectrum[BIN, j]
        if k < 0.0:
            mirrored = j - 2 * int(k)
            spectrum[RE, j] = spectrum[RE, mirrored]
            spectrum[IM, j] = -spectrum[IM, mirrored]
        elif k > 0.5 * length:
            mirrored = j - 2 * int(k - 0.5 * length)
            spectrum[RE, j] = -spectrum[RE, mirrored]
            spectrum[IM, j] = spectrum[IM, mirrored]


@njit(cache=True, fastmath=FAST)
def windowed_bin(
    spectrum: FloatArray, j: int, centre: float, side: float, cosine: float, sine: float
) -> tuple[float, float]:
    """Column `j` under a window; `cosine` and `sine` are those of π/N."""
    sum_re = spectrum[RE, j - 1] + spectrum[RE, j + 1]
    sum_im = spectrum[IM, j - 1] + spectrum[IM, j + 1]
    rise_re = spectrum[RE, j + 1] - spectrum[RE, j - 1]
    rise_im = spectrum[IM, j + 1] - spectrum[IM, j - 1]
    return (
        centre * spectrum[RE, j] + side * (cosine * sum_re - sine * rise_im),
        centre * spectrum[IM, j] + side * (cosine * sum_im + sine * rise_re),
    )


@njit(cache=True, fastmath=FAST)
def set_power(
    centre: float, side: float, cosine: float, sine: float, length: float, spectrum: FloatArray, count: int
) -> None:
    """Set POWER where a target can be; it is 0 at 0 and N/2, and in the outer TAPS bins of an interval."""
    spectrum[POWER, :count] = 0.0
    for j in range(TAPS, count - TAPS):
        contiguous = spectrum[BIN, j + TAPS] - spectrum[BIN, j - TAPS] == 2.0 * TAPS
        if contiguous and 0.0 < spectrum[BIN, j] < 0.5 * length:
            x, y = windowed_bin(spectrum, j, centre, side, cosine, sine)
            spectrum[POWER, j] = x * x + y * y
