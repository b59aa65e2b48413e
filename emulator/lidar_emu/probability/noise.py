"""Noise alone: what it exceeds, in one bin and in the highest of many.

A false-alarm probability is always given as L = -ln P_fa, which has no smallest value. Powers are sums over M
looks (records averaged), each of unit mean noise power: a sum of noise alone has a gamma distribution of order M.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc, gammaincinv, gammaln

from lidar_emu.numerics.arrays import FloatArray

_STEPS = 50
_NEWTON_FROM = 1.0
"""Below this L the probability itself has all digits."""


def minus_log_exceedance(power: ArrayLike, looks: int = 1) -> FloatArray:
    """L = -ln P of noise alone above a power, with a relative error of 1e-13 at any power.

    Args:
        power: 0 or more, the sum over looks.
        looks: M, from 1.
    """
    power = np.asarray(power, dtype=float)
    # Γ(M, T)/Γ(M) = e^-T Σ_(k<M) T^k/k!; where that is near 1, its complement is the smaller.
    below = gammainc(looks, power)
    total = np.ones_like(power)
    for k in range(looks - 1, 0, -1):
        total = 1.0 + power / k * total
    exceedance: FloatArray = np.where(below < 0.5, -np.log1p(-np.minimum(below, 0.5)), power - np.log(total))
    return exceedance


def threshold_power(minus_log_pfa: ArrayLike, looks: int = 1) -> FloatArray:
    """The power that noise exceeds with probability e^-L: the inverse of `minus_log_exceedance`.

    Newton's method: L is a convex function of the power, so that from its right every step lands between the
    last one and the solution.
    """
    wanted = np.asarray(minus_log_pfa, dtype=float)
    if looks == 1:
        return wanted
    small = wanted < _NEWTON_FROM
    power = looks + wanted
    for _ in range(_STEPS):
        exceeded = minus_log_exceedance(power, looks)
        slope = np.exp((looks - 1) * np.log(power) - power - gammaln(looks) + exceeded)
        power = np.maximum(power + np.where(small, 0.0, (wanted - exceeded) / slope), 1e-3)
    return np.where(small, gammaincinv(looks, -np.expm1(-np.minimum(wanted, _NEWTON_FROM))), power)


def log_false_alarm(minus_log_pfa: ArrayLike, bins: float) -> FloatArray:
    """ln of the probability that the highest of independent noise bins exceeds the threshold of one.

    1 - (1 - e^-L)^N without cancellation, and without underflow: ln N - L where the union bound is exact.
    """
    single = np.asarray(minus_log_pfa, dtype=float)
    union: FloatArray = np.log(bins) - single
    with np.errstate(divide="ignore"):
        exact = np.log(-np.expm1(bins * np.log1p(-np.exp(-single))))
    return np.where(union < -40.0, union, exact)
