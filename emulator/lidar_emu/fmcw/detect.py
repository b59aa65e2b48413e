"""Targets in a spectrum: groups of contiguous strong bins, and the frequency of each group's peak."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from lidar_emu.arrays import FloatArray
from lidar_emu.fmcw.sine import FAST, sin_pi
from lidar_emu.fmcw.spectrum import windowed_bin
from lidar_emu.kernels import njit

MAX_GROUPS = 4
"""Groups kept of one spectrum, the strongest."""

BIN_VARIANCE = 1.0 / 12.0
"""Variance of a frequency rounded to whole bins, in bins²."""

_HANN_VARIANCE_TIMES_SNR = 0.49
"""Of the three-bin estimate, in bins², averaged over where in the bin the tone lies (0.070 bin at 20 dB)."""

_LEAST_VARIANCE = 1e-12
"""Below it the estimate is exact to rounding; it keeps weights finite."""


@njit(cache=True)
def find_groups(
    power: FloatArray, threshold: float, group_power_share: float, peaks: NDArray[np.int64]
) -> int:
    """Contiguous bins above a share of the highest power, with a peak above the threshold.

    Args:
        power: (bins,) with 0 at the end and between intervals that do not touch.
        threshold: least power of a group's peak.
        group_power_share: share of the highest *power* that a bin of a group exceeds.
        peaks: (MAX_GROUPS,) receives the indices of the groups' highest bins, strongest first.

    Returns:
        The number of groups, MAX_GROUPS at most.
    """
    highest = 0.0
    for j in range(len(power)):
        highest = max(highest, power[j])
    if not highest > threshold:
        return 0
    floor = group_power_share * highest
    count = 0
    peak = -1
    for j in range(len(power)):
        if power[j] > floor:
            if peak < 0 or power[j] > power[peak]:
                peak = j
        elif peak >= 0:
            count = _keep(power, threshold, peak, peaks, count)
            peak = -1
    return count


@njit(cache=True)
def _keep(power: FloatArray, threshold: float, peak: int, peaks: NDArray[np.int64], count: int) -> int:
    """Put a peak in its place among the `count` strongest; of equals the first stays before."""
    if not power[peak] > threshold:
        return count
    place = count
    while place > 0 and power[peaks[place - 1]] < power[peak]:
        if place < MAX_GROUPS:
            peaks[place] = peaks[place - 1]
        place -= 1
    if place < MAX_GROUPS:
        peaks[place] = peak
    return min(count + 1, MAX_GROUPS)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def hann_peak(spectrum: FloatArray, j: int, cosine: float, sine: float) -> tuple[float, float]:
    """Offset from column `j` of the tone there, and the estimate's variance, in bins and bins².

    The tone lies at δ where q = Re[(H₋ - H₊)/(2 H₀ + H₋ + H₊)] = 3δ / (2 (1 - δ²)) with the Hann-weighted
    bins H of the transform; the quadratic is solved in the form that has no 0/0 at δ = 0. |δ| < 1 whatever
    the noise.
    """
    before_re, before_im = windowed_bin(spectrum, j - 1, 0.5, -0.25, cosine, sine)
    here_re, here_im = windowed_bin(spectrum, j, 0.5, -0.25, cosine, sine)
    after_re, after_im = windowed_bin(spectrum, j + 1, 0.5, -0.25, cosine, sine)
    # Bins are referred to the record's centre: turn the neighbours to where the transform has them.
    sum_re = cosine * (before_re + after_re) + sine * (before_im - after_im)
    sum_im = cosine * (before_im + after_im) + sine * (after_re - before_re)
    top_re = cosine * (before_re - after_re) + sine * (before_im + after_im)
    top_im = cosine * (before_im - after_im) - sine * (before_re + after_re)
    low_re, low_im = 2.0 * here_re + sum_re, 2.0 * here_im + sum_im
    q = (top_re * low_re + top_im * low_im) / (low_re * low_re + low_im * low_im)
    offset = 2.0 * q / (1.5 + sqrt(2.25 + 4.0 * q * q))
    gain = _hann_gain(offset)
    snr = (here_re * here_re + here_im * here_im) / (gain * gain)
    return offset, max(_HANN_VARIANCE_TIMES_SNR / snr, _LEAST_VARIANCE)


@njit(cache=True)
def _hann_gain(offset: float) -> float:
    """Magnitude of the Hann-weighted bin nearest to a tone of unit weight, at most half a bin away."""
    x = min(max(abs(offset), 1e-18), 0.5)
    return 0.5 * sin_pi(x) / (pi * x * (1.0 - x * x))
