"""False alarms: the highest noise peaks in bins that are not computed."""

from __future__ import annotations

from functools import lru_cache
from math import exp, expm1, log, log1p, pi, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import FALSE_ALARM, uniform_pair
from lidar_emu.receiver.analog_response import noise_level
from lidar_emu.receiver.peak_interpolation import BIN_CENTRE
from lidar_emu.receiver.probability import exceedance, minus_log_exceedance, threshold_power
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import MAX_TARGETS, Beam, SpectrumTarget
from lidar_emu.receiver.spectrum import BIN_VARIANCE, SpectralWindow

_VARIANCE_TIMES_SNR = 0.5
"""Variance of a sub-bin estimator times the SNR, for noise peaks, whose neighbouring bins are not computed."""


@kernel
def noise_peak(looks: int, below: float, bins: float, beam: Beam, index: int) -> tuple[float, float]:
    """The highest of `bins` noise powers over their mean, given that none exceeds `below`, and its position from 0 to
    1.

    The largest of B powers is below p with probability (1 - Q(p))^B; for a single look, p = -log(1 - u^(1/B)).
    """
    u, place = uniform_pair(beam.seed, beam.shot, beam.beam, FALSE_ALARM, index)
    ceiling = log1p(-exp(-minus_log_exceedance(looks * below, looks))) if below < np.inf else 0.0
    exceedance = -expm1(ceiling + log(u) / bins)
    return threshold_power(-log(exceedance), looks) / looks, place


@kernel
def draw_alarms(
    model: ReceiverModel,
    beam: Beam,
    segment: int,
    highest: float,
    noisiest: float,
    computed: float,
    alarms: NDArray[Any],
) -> int:
    """Draw noise peaks above the threshold in bins that are not computed, unless the echo hides them with near
    certainty.

    Args:
        highest: power of the echo's highest bin.
        noisiest: maximum mean noise power of the rectangular bins there.
        computed: number of bins that are computed.
        alarms: (MAX_TARGETS,) of TARGET, filled in descending order of power.

    Returns:
        Number of noise peaks.
    """
    # In units of the mean noise power of a windowed bin; the noise elsewhere may be twice as strong as here.
    elsewhere = 2.0 * noisiest
    floor = max(model.threshold, model.group_power_share * highest / (elsewhere * model.noise_power))
    lowest = max(1.0, model.lowest_bin)
    bins = (0.5 * model.fft_length - lowest - computed) * model.independent_share
    if bins < 1.0:
        return 0
    expected = bins * exp(-minus_log_exceedance(model.looks * floor, model.looks))
    if expected <= model.least_false_alarm:
        return 0
    below = np.inf
    for a in range(MAX_TARGETS):
        below, place = noise_peak(model.looks, below, max(1.0, bins - a), beam, MAX_TARGETS * segment + a)
        if below <= model.threshold:
            return a
        k = lowest + place * (0.5 * model.fft_length - 1.0 - lowest)
        if model.peak_method == BIN_CENTRE:
            k = np.rint(k)
        level = noise_level(model.response, 1.0, 1.0, 0.0, k, sin(pi * k / model.fft_length))
        set_random_peak(model, k, below, below * level * model.noise_power, alarms[a])
    return MAX_TARGETS


@kernel
def set_random_peak(
    model: ReceiverModel, k: float, power_over_noise: float, power: float, target: SpectrumTarget
) -> None:
    """Set a target from a peak of noise or haze at bin `k`, between bins that are not computed."""
    rounded = model.peak_method == BIN_CENTRE
    target.frequency_bin = np.rint(k) if rounded else k
    target.variance_bin2 = BIN_VARIANCE if rounded else _VARIANCE_TIMES_SNR / power_over_noise
    target.quadrature_bin = target.quadrature_bin2 = target.drift_bin = target.width_bin2 = 0.0
    target.quadrature_variance_bin2 = _VARIANCE_TIMES_SNR / power_over_noise
    target.power_over_noise = power_over_noise
    target.power = power


@kernel
def insert_alarms(
    model: ReceiverModel, alarms: NDArray[Any], highest: float, targets: NDArray[Any], count: int
) -> int:
    """Insert noise peaks that are near the highest power among the `count` targets; returns the new count."""
    for a in range(len(alarms)):
        if alarms[a].power > model.group_power_share * highest:
            count = _insert(alarms[a], targets, count)
    return count


@kernel
def _insert(alarm: SpectrumTarget, targets: NDArray[Any], count: int) -> int:
    place = count
    while place > 0 and targets[place - 1].power < alarm.power:
        if place < MAX_TARGETS:
            targets[place] = targets[place - 1]
        place -= 1
    if place < MAX_TARGETS:
        targets[place] = alarm
    return min(count + 1, MAX_TARGETS)


@lru_cache(16)
def neighbour_exceedance(window: SpectralWindow, threshold: float) -> float:
    """Probability that the bin after a noise bin above the threshold exceeds it too: windows correlate neighbours.

    For two circular Gaussians with squared correlation ρ², the power of one, given power p of the other, is noncentral
    chi-squared; the excess of p over the threshold is exponential.
    """
    correlation = (2.0 * window.centre * window.side / window.noise_power) ** 2
    if correlation == 0.0:
        return 0.0
    node, weight = np.polynomial.laguerre.laggauss(40)
    scale = 2.0 / (1.0 - correlation)
    return float(weight @ exceedance(0.5 * scale * correlation * (threshold + node), 0.5 * scale * threshold))
