"""Detection of a tone that may fade: steady, Swerling's four cases, and several segments with shared fading.

K is the mean power of the signal in its bin divided by the mean noise power there. The powers of M looks are summed and
compared with `threshold_power(L, M)`, where L = -ln P_fa.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.probability.marcum import marcum_q
from lidar_emu.probability.noise import threshold_powers
from lidar_emu.probability.quadrature import nodes_and_weights

Fading = Literal["steady", "swerling_1", "swerling_2", "swerling_3", "swerling_4"]
"""Fading of the signal's power. Swerling 1 and 2: exponential (Rayleigh amplitude, fully developed speckle), equal in
all looks or independent in each. Swerling 3 and 4: gamma of order two, likewise. A steady signal is Swerling's case 0;
its amplitude with noise has a Rice distribution."""

_PANELS = np.linspace(0.0, 1.0, 33)
_BEYOND = 7.0
"""Noise amplitudes above the threshold at which a signal is detected, except for a probability of e^-49."""
_LEAST_SNR = 1e-12
"""SNR below which a fade makes no difference."""


def detection_probability(
    fading: Fading, snr: ArrayLike, minus_log_pfa: ArrayLike, looks: int = 1
) -> FloatArray:
    """Probability that signal and noise exceed the threshold, to an absolute error of 1e-11.

    Args:
        fading: fading of the signal.
        snr: K for one look, 0 or more.
        minus_log_pfa: L of one bin, for the sum over looks. Broadcast with `snr`.
        looks: M, from 1.
    """
    snr, power = np.broadcast_arrays(np.asarray(snr, dtype=float), threshold_powers(minus_log_pfa, looks))
    if fading == "steady":
        return marcum_q(looks, np.sqrt(2.0 * looks * snr), np.sqrt(2.0 * power))
    order = {"swerling_1": 1, "swerling_2": looks, "swerling_3": 2, "swerling_4": 2 * looks}[fading]
    mixed = _mixture if order >= looks else _beside_noise
    return mixed(order, looks, 1.0 + looks * snr / order, power)


def shared_fade_probability(
    rule: Callable[[FloatArray], FloatArray], snr: ArrayLike, minus_log_pfa: float, looks: int = 1
) -> FloatArray:
    """Probability of an event that depends on several segments with shared fading, to an absolute error of 1e-10.

    The segments share the signal's power, which is exponential and independent from look to look; their noise is
    independent.

    Args:
        rule: probability of the event where each segment is detected with the probability given, such as
            p -> p³; rising, with rule(1) = 1.
        snr: K for one look, any shape.
        minus_log_pfa: L of one bin, for the sum over looks.
        looks: M, from 1.
    """
    from scipy.special import gammaincc, gammaln

    mean: FloatArray = np.maximum(np.asarray(snr, dtype=float), _LEAST_SNR)
    # Integrated over the amplitude, in which the detection probability is a smooth step one noise amplitude wide, up to
    # where every signal is detected or no signal is left.
    height = np.sqrt(threshold_powers(minus_log_pfa, looks))
    top = np.minimum(height + _BEYOND, np.sqrt(mean * (looks + 8.0 * np.sqrt(looks) + 45.0)))
    amplitude, weight = nodes_and_weights(top[..., None] * _PANELS)
    event = rule(marcum_q(looks, np.sqrt(2.0) * amplitude, np.sqrt(2.0) * height))
    share = np.square(amplitude) / mean[..., None]
    density = np.exp((looks - 1) * np.log(share) - share - gammaln(looks)) * 2.0 * amplitude / mean[..., None]
    certain: FloatArray = gammaincc(looks, np.square(top) / mean)
    return np.asarray((density * event * weight).sum(axis=-1) + certain)


def _mixture(order: int, looks: int, gain: FloatArray, power: FloatArray) -> FloatArray:
    """Gamma-distributed signal of order k >= M: the sum with the noise is a mixture of gamma distributions.

    Its moment-generating function is (1 + t)^(k - M) / (1 + ct)^k, with c = 1 + MK/k, and 1 + t is ((1 + ct) + (c - 1))
    / c.
    """
    from scipy.special import gammaincc

    spare = order - looks
    total = np.zeros_like(gain)
    for j in range(spare + 1):
        weight = comb(spare, j) * gain**-j * (1.0 - 1.0 / gain) ** (spare - j)
        total += weight * gammaincc(order - j, power / gain)
    return total


def _beside_noise(order: int, looks: int, gain: FloatArray, power: FloatArray) -> FloatArray:
    """Gamma-distributed signal of order k < M: the sum of c times a gamma of order k, and of noise of order M - k."""
    from scipy.special import gammaincc, gammaln

    idle = looks - order
    noise, weight = nodes_and_weights(power[..., None] * _PANELS)
    density = np.exp((idle - 1) * np.log(noise) - noise - gammaln(idle))
    exceeded = gammaincc(order, (power[..., None] - noise) / gain[..., None])
    alone: FloatArray = gammaincc(idle, power)
    return np.asarray((density * exceeded * weight).sum(axis=-1) + alone)
