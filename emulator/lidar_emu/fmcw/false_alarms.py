"""Noise where no bins are computed: its highest peaks, drawn without drawing the rest."""

from __future__ import annotations

from math import exp, expm1, log, log1p

import numpy as np

from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import uniform_pair


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
