"""False alarms: the threshold that noise alone exceeds with P_fa, and its highest peaks where no bins are computed."""

from __future__ import annotations

from functools import lru_cache
from math import exp, expm1, log, log1p, pi, sin

import numpy as np
from scipy.special import chndtr

from lidar_emu.fmcw.peak_interpolation import BIN_CENTRE, BIN_VARIANCE
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.response import noise_level
from lidar_emu.fmcw.spectrum import SpectralWindow
from lidar_emu.fmcw.workspace import MAX_TARGETS
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import uniform_pair
from lidar_emu.numerics.random_streams import FALSE_ALARM

_PEAK_VARIANCE_TIMES_SNR = 0.5
"""Of the estimators that resolve part of a bin, for peaks in noise, whose bins are not computed."""


@kernel
def exceeding_bins(looks: int, power: float, bins: float) -> float:
    """Expected number of bins whose noise, averaged over looks, exceeds `power` times its mean."""
    return bins * exp(log_exceedance(looks, power))


@kernel
def log_exceedance(looks: int, power: float) -> float:
    """Logarithm of the probability that the mean of so many exponential powers of unit mean exceeds `power`.

    A gamma distribution of whole shape: Q(M, x) = e^-x (1 + x + ... + x^(M-1)/(M-1)!) with x = M power.
    """
    x = looks * power
    term, total = 1.0, 1.0
    for m in range(1, looks):
        term *= x / m
        total += term
    return log(total) - x


@kernel
def quantile(looks: int, log_probability: float) -> float:
    """The power whose `log_exceedance` is that; of several looks by bisection."""
    if looks == 1:
        return -log_probability
    low, high = 0.0, 2.0 + 2.0 * looks - log_probability
    for _ in range(60):
        middle = 0.5 * (low + high)
        if log_exceedance(looks, middle) > log_probability:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def noise_peak(
    looks: int,
    below: float,
    bins: float,
    seed: np.uint64,
    shot: int,
    beam: int,
    purpose: int,
    index: int,
) -> tuple[float, float]:
    """The highest of so many powers over their mean, given that none exceeds `below`, and where it is, from 0 to 1.

    The largest of B is below p with probability (1 - Q(p))^B; of a single look, p = -log(1 - u^(1/B)).
    """
    u, place = uniform_pair(seed, shot, beam, purpose, index)
    ceiling = log1p(-exp(log_exceedance(looks, below))) if below < np.inf else 0.0
    exceedance = -expm1(ceiling + log(u) / bins)
    return quantile(looks, log(exceedance)), place


@kernel
def draw_alarms(
    model: ReceiverModel,
    highest: float,
    noisiest: float,
    computed: float,
    segment: int,
    shot: int,
    beam: int,
    seed: np.uint64,
    alarms: FloatArray,
) -> int:
    """Peaks of noise above the threshold in bins that are not computed, unless the echo leaves them no chance.

    Args:
        highest: power of the echo's highest bin.
        noisiest: mean noise power of the rectangular bins there.
        computed: bins that are computed.
        alarms: (MAX_TARGETS, 3) receives power, bin, and power over noise.

    Returns:
        Their number.
    """
    # In units of the mean noise power of a windowed bin; the noise elsewhere may be twice as strong as here.
    floor = max(model.threshold, model.group_power_share * highest / (2.0 * noisiest * model.noise_power))
    bins = (0.5 * model.fft_length - 1.0 - computed) * model.independent_share
    if bins < 1.0 or exceeding_bins(model.looks, floor, bins) <= model.least_false_alarm:
        return 0
    below = np.inf
    for a in range(MAX_TARGETS):
        below, place = noise_peak(
            model.looks, below, max(1.0, bins - a), seed, shot, beam, FALSE_ALARM, MAX_TARGETS * segment + a
        )
        if below <= model.threshold:
            return a
        k = 1.0 + place * (0.5 * model.fft_length - 2.0)
        if model.peak_method == BIN_CENTRE:
            k = np.rint(k)
        level = noise_level(model.response, 1.0, 0.0, k, sin(pi * k / model.fft_length))
        alarms[a, 0] = below * level * model.noise_power
        alarms[a, 1] = k
        alarms[a, 2] = below
    return MAX_TARGETS


@kernel(inline="always")
def insert_alarms(
    model: ReceiverModel, alarms: FloatArray, highest: float, targets: FloatArray, count: int
) -> int:
    """Put peaks of noise among the `count` targets, as far as they are near the highest power; the new count."""
    for a in range(len(alarms)):
        if alarms[a, 0] > model.group_power_share * highest:
            count = _insert(model, alarms[a], targets, count)
    return count


@kernel
def _insert(model: ReceiverModel, alarm: FloatArray, targets: FloatArray, count: int) -> int:
    """Put a peak of noise in its place among the `count` strongest targets."""
    place = count
    while place > 0 and targets[place - 1, 3] < alarm[0]:
        if place < MAX_TARGETS:
            for i in range(targets.shape[1]):
                targets[place, i] = targets[place - 1, i]
        place -= 1
    if place < MAX_TARGETS:
        exact = model.peak_method != BIN_CENTRE
        targets[place, 0] = alarm[1]
        targets[place, 1] = _PEAK_VARIANCE_TIMES_SNR / alarm[2] if exact else BIN_VARIANCE
        targets[place, 2] = alarm[2]
        targets[place, 3] = alarm[0]
    return min(count + 1, MAX_TARGETS)


@lru_cache(16)
def neighbour_exceedance(window: SpectralWindow, threshold: float) -> float:
    """Probability that a bin of noise above the threshold is followed by another: windows correlate neighbours.

    Of two circular Gaussians with squared correlation ρ² the one's power, given the other's p, is noncentral
    chi-squared; p beyond the threshold is exponential.
    """
    correlation = (2.0 * window.centre * window.side / window.noise_power) ** 2
    if correlation == 0.0:
        return 0.0
    node, weight = np.polynomial.laguerre.laggauss(40)
    scale = 2.0 / (1.0 - correlation)
    below = chndtr(scale * threshold, 2.0, scale * correlation * (threshold + node))
    return float(np.sum(weight * (1.0 - below)))
