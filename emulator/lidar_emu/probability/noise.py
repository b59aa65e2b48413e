"""Noise alone: its exceedance probability, in one bin and in the highest of many.

A false-alarm probability is always given as L = -ln P_fa, which cannot underflow. Powers are sums over M looks
(averaged records), each of unit mean noise power: a sum of noise alone has a gamma distribution of order M.
"""

from __future__ import annotations

from math import exp, log, log1p, sqrt

import numpy as np
from numpy.typing import ArrayLike

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import interpreted, kernel

_HALVINGS = 60


@kernel
def minus_log_exceedance(power: float, looks: int) -> float:
    """L = -ln P of noise alone above a power, with a relative error of 1e-13 at any power.

    P = Γ(M, T)/Γ(M) = e^-T Σ_(k<M) T^k/k!; where that is near 1, its complement e^-T Σ_(k>=M) T^k/k! is the smaller.

    Args:
        power: T, 0 or more, the sum over looks.
        looks: M, from 1.
    """
    if looks == 1:
        return power
    term, total = 1.0, 1.0
    for k in range(1, looks):
        term *= power / k
        total += term
    if exp(-power) * total < 0.5:
        return power - log(total)
    k, below = looks, 0.0
    while term > 1e-17 * below:
        term *= power / k
        below += term
        k += 1
    return -log1p(-exp(-power) * below)


@kernel
def threshold_power(minus_log_pfa: float, looks: int) -> float:
    """The power that noise exceeds with probability e^-L: the inverse of `minus_log_exceedance`, by bisection.

    It is at most M + sqrt(2ML) + L (Laurent and Massart, Annals of Statistics 28, 2000, lemma 1).
    """
    if looks == 1:
        return minus_log_pfa
    low, high = 0.0, looks + sqrt(2.0 * looks * minus_log_pfa) + minus_log_pfa
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if minus_log_exceedance(middle, looks) < minus_log_pfa:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def threshold_powers(minus_log_pfa: ArrayLike, looks: int = 1) -> FloatArray:
    """`threshold_power` of each L."""
    return np.asarray(np.vectorize(interpreted(threshold_power), otypes=[float])(minus_log_pfa, looks))


def log_false_alarm(minus_log_pfa: ArrayLike, bins: float) -> FloatArray:
    """ln of the probability that the highest of independent noise bins exceeds the threshold of one bin.

    This is 1 - (1 - e^-L)^N without cancellation, and without underflow: ln N - L where the union bound is exact.
    """
    single = np.asarray(minus_log_pfa, dtype=float)
    union: FloatArray = np.log(bins) - single
    with np.errstate(divide="ignore"):
        exact = np.log(-np.expm1(bins * np.log1p(-np.exp(-single))))
    return np.where(union < -40.0, union, exact)
