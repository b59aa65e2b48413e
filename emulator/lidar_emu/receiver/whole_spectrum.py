"""Windowed bins of whole records, their targets and the targets' frequencies; the leading axis is over records."""

from __future__ import annotations

from functools import cache
from math import ceil
from typing import Literal, NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import ComplexArray, FloatArray, IntArray

WindowName = Literal["rect", "hann", "hamming"]

_COSINES: dict[WindowName, tuple[float, float]] = {
    "rect": (1.0, 0.0),
    "hann": (0.5, 0.5),
    "hamming": (0.54, 0.46),
}

TARGETS = 4
"""Maximum number of targets kept per spectrum, the strongest."""

_BIN_VARIANCE = 1.0 / 12.0

_LEAST_VARIANCE, _MOST_VARIANCE = 1e-12, 1.0 / 3.0
"""Limits of the variance; the upper one is the variance of a tone anywhere within a bin of this one."""


class Targets(NamedTuple):
    """The strongest targets of each record, strongest first; (records, TARGETS), NaN where there are fewer."""

    frequency_bin: FloatArray
    variance_bin2: FloatArray
    """Variance of the frequency by noise as the estimator computes it."""
    quadrature_bin: FloatArray
    """Quadrature of the offset: its error's twin, as in `receiver.peak_shape`."""
    quadrature_variance_bin2: FloatArray
    width_bin2: FloatArray
    """Second moment of the powers around the peak."""
    power: FloatArray
    """Power of the highest bin with the window."""
    peak_bin: FloatArray
    """Index of the highest bin."""


def window_samples(window: WindowName, count: int) -> FloatArray:
    """The periodic window, (N,)."""
    return window_at(window, np.arange(count) / count)


def window_at(window: WindowName, place: FloatArray) -> FloatArray:
    """The window a - b cos(2πx) at x = n/N, in its shape."""
    a, b = _COSINES[window]
    return a - b * np.cos(2.0 * np.pi * place)


def transform(samples: FloatArray, window: WindowName) -> ComplexArray:
    """Bins 0 to N/2 of (..., N) samples; a tone of weight w on a bin has magnitude |w| there if unwindowed."""
    from scipy import fft

    count = samples.shape[-1]
    bins: ComplexArray = fft.rfft(samples * window_samples(window, count)) * (2.0 / count)
    return bins


def windowed(bins: ComplexArray, window: WindowName) -> ComplexArray:
    """Apply a window to rectangular bins 0 to N/2 of real samples, (..., N/2 + 1)."""
    a, b = _COSINES[window]
    result = a * bins
    result[..., 1:] -= 0.5 * b * bins[..., :-1]
    result[..., :-1] -= 0.5 * b * bins[..., 1:]
    # The neighbours of the end bins are their images.
    result[..., 0] -= 0.5 * b * bins[..., 1].conj()
    result[..., -1] -= 0.5 * b * bins[..., -2].conj()
    return result


def window_gain(window: WindowName) -> float:
    """Amplitude of a tone on its bin, relative to no window."""
    return _COSINES[window][0]


@cache
def window_noise_power(window: WindowName, count: int) -> float:
    """Mean power of white noise in a windowed bin, relative to a rectangular one."""
    return float(np.mean(np.square(window_samples(window, count))))


def find_peaks(
    power: FloatArray, threshold: float | FloatArray, group_fraction: float, lowest_bin: float = 0.0
) -> IntArray:
    """Highest bins of the groups of contiguous strong bins.

    Bins 0 and N/2 hold no target. A group's bins exceed `group_fraction` of the spectrum's highest magnitude, and
    its peak exceeds the threshold.

    Args:
        power: (records, N/2 + 1).
        threshold: power, for all bins or (N/2 + 1,) for each.
        group_fraction: fraction of magnitude, not of power.
        lowest_bin: lowest bin that is searched.

    Returns:
        (records, TARGETS) indices of bins, strongest first, at equal power the lowest first; -1 where there are fewer.
    """
    records = power.shape[0]
    inner = power.copy()
    inner[:, [0, -1]] = 0.0
    inner[:, : ceil(lowest_bin)] = 0.0
    strong = inner > group_fraction**2 * inner.max(axis=1, keepdims=True)
    # The empty end bins separate the groups of consecutive records.
    flat = strong.ravel()
    first = flat & ~np.concatenate(([False], flat[:-1]))
    group = np.cumsum(first)
    member = np.flatnonzero(flat)
    order = np.lexsort((member, -inner.ravel()[member], group[member]))
    member = member[order]
    if member.size:
        member = member[np.concatenate(([True], np.diff(group[member]) > 0))]
    row, place = np.divmod(member, power.shape[1])
    above = inner[row, place] > np.broadcast_to(threshold, power.shape[1:])[place]
    row, place = row[above], place[above]
    order = np.lexsort((place, -inner[row, place], row))
    row, place = row[order], place[order]
    rank = np.arange(row.size) - np.searchsorted(row, row)
    peaks = np.full((records, TARGETS), -1, dtype=np.int64)
    kept = rank < TARGETS
    peaks[row[kept], rank[kept]] = place[kept]
    return peaks


def estimator_window(peak: str) -> WindowName:
    """Window of the bins from which `find_targets` takes offset and quadrature."""
    return "rect" if peak == "aboutanios_mulgrew" else "hann"


def find_targets(
    bins: ComplexArray,
    estimator_bins: ComplexArray,
    peak: str,
    threshold: float | FloatArray,
    group_fraction: float,
    noise_level: float | FloatArray = 1.0,
    window_noise: float = 1.0,
    lowest_bin: float = 0.0,
) -> Targets:
    """Find the targets of records.

    Args:
        bins: (records, N/2 + 1) transform of the samples with the window of detection.
        estimator_bins: the same with the window of `estimator_window`.
        peak: `bin`, `hann` or `aboutanios_mulgrew`.
        threshold, group_fraction, lowest_bin: as in `find_peaks`.
        noise_level: mean noise power in a rectangular bin, one for all or (N/2 + 1,) for each.
        window_noise: mean power of noise with the window of detection, relative to a rectangular bin.
    """
    power = np.square(bins.real) + np.square(bins.imag)
    peaks = find_peaks(power, threshold, group_fraction, lowest_bin)
    found = peaks >= 0
    row, _ = np.nonzero(found)
    place = peaks[found]
    values = np.full((7, *peaks.shape), np.nan)
    level = np.broadcast_to(noise_level, bins.shape[1:])[place]
    estimate = _half_bin_offset if peak == "aboutanios_mulgrew" else _hann_offset
    offset, variance, quadrature = estimate(estimator_bins, row, place, level)
    variance = np.clip(variance, _LEAST_VARIANCE, _MOST_VARIANCE)
    # Next to bins 0 and N/2 a tone's own image biases the estimate by up to half a bin.
    image = (place <= 2) | (place >= bins.shape[1] - 3)
    quadrature = np.where(image, 0.0, np.clip(quadrature, -0.5, 0.5))
    own = variance = np.where(image, np.maximum(variance, _BIN_VARIANCE), variance)
    if peak == "bin":
        offset, own = np.zeros(place.size), np.full(place.size, _BIN_VARIANCE)
    width = _width_bin2(power, row, place, level * window_noise)
    values[:, found] = place + offset, own, quadrature, variance, width, power[row, place], place
    return Targets(*values)


def _width_bin2(power: FloatArray, row: IntArray, place: IntArray, level: FloatArray) -> FloatArray:
    """Second moment of the powers up to 8 bins from the peak, above 0.09 of it and 7 times the noise: only of those
    beside the peak where the next but one are weaker."""
    around = np.arange(-8, 9)
    near = place[:, None] + around
    inner = (near > 0) & (near < power.shape[1] - 1)
    here = power[row[:, None], np.where(inner, near, 0)]
    floor = np.maximum(0.09 * power[row, place], 7.0 * level)
    strong = np.where(inner & (here > floor[:, None]), here, 0.0)
    narrow = np.maximum(strong[:, 6], strong[:, 10]) == 0.0
    strong[np.ix_(narrow, np.abs(around) > 1)] = 0.0
    total = np.maximum(strong.sum(axis=1), 1e-300)
    centre = strong @ around / total
    return np.asarray(strong @ np.square(around) / total - centre**2)


def _hann_offset(
    bins: ComplexArray, row: IntArray, place: IntArray, level: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offset from bin `place`, variance in noise of that level there, and the offset's quadrature.

    For a tone δ off the middle bin q = Re[(H₋ - H₊)/(2 H₀ + H₋ + H₊)] is 3δ / (2 (1 - δ²)); the root is written in the
    form without 0/0. With θ = 2πn/N the two sums have the windows j (1 - cos θ) sin θ, of mean square 5/8, and sin²θ,
    of mean square 3/8, and are uncorrelated, so that var q = (5 + 3q²)/16 over the signal-to-noise ratio of the latter
    sum.
    """
    before, here, after = bins[row, place - 1], bins[row, place], bins[row, place + 1]
    total = 2.0 * here + before + after
    ratio = (before - after) / total
    q = ratio.real
    offset = 4.0 * q / (3.0 + np.sqrt(9.0 + 16.0 * q * q))
    slope = 1.5 * (1.0 + offset**2) / (1.0 - offset**2) ** 2
    variance = (5.0 + 3.0 * q * q) / 16.0 * level / np.square(np.abs(total) * slope)
    return offset, variance, ratio.imag / slope


def _half_bin_offset(
    bins: ComplexArray, row: IntArray, place: IntArray, level: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same by the transform half a bin above and below the tone, of 13 bins (Aboutanios and Mulgrew).

    A tone ε beside the middle of the two, of the transforms A and B, has (A - B)/(A + B) = 2ε for long records and all
    bins. At δ beside the highest of n bins this is -sin(2πδ)/(πn) for ε = 0, with the slope 2 - 2 cos²(πδ)/n.
    """
    count = 2 * (bins.shape[1] - 1)
    around = np.arange(-6, 7)
    near = place[:, None] + around
    inner = (near >= 0) & (near < bins.shape[1])
    # Referred to the middle of the record.
    values = np.where(inner, bins[row[:, None], np.where(inner, near, 0)], 0.0)
    values = values * np.exp(1j * np.pi * near * (count - 1) / count)

    def tone(at: FloatArray) -> FloatArray:
        beside = at[:, None] - around
        return np.where(inner, np.sinc(beside) / np.sinc(beside / count), 0.0)

    own, offset = values, np.zeros(place.size)
    for _ in range(6):
        above, below = tone(offset + 0.5), tone(offset - 0.5)
        top, low = above - below, above + below
        amplitude = (own * low).sum(axis=1) / (tone(offset) * low).sum(axis=1)
        # The image at the negative frequency has the conjugate amplitude.
        own = values - amplitude.conj()[:, None] * tone(-2.0 * place - offset)
        total = (own * low).sum(axis=1)
        ratio = (own * top).sum(axis=1) / total
        slope = 2.0 - 2.0 / len(around) * np.cos(np.pi * offset) ** 2
        q = ratio.real
        centred = -np.sin(2.0 * np.pi * offset) / (np.pi * len(around))
        offset = np.clip(offset + (q - centred) / slope, -1.0, 1.0)
    noise = np.square(top - q[:, None] * low).sum(axis=1)
    variance = 0.5 * level * noise / np.square(np.abs(total) * slope)
    shown = ratio.imag / slope
    # Lines wider than 0.2 bin show less than they err.
    return offset, variance, shown * (1.0 + 0.5 * (shown / 0.3) ** 4)
