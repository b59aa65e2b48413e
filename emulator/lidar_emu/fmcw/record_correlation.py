"""Correlation of errors by speckle between the records of several looks."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

_Numbers = TypeVar("_Numbers", float, FloatArray)


@kernel
def record_correlation(looks: float, decay: _Numbers, segments: float) -> _Numbers:
    """Covariance of the means over looks of two segments' errors by speckle, times the looks, relative to the variance
    of one record's.

    In a circular Gaussian process with the correlation r(t) the rate of the phase, times the power, has the covariance
    (r'² - r r'')/2: for a Gaussian r it falls as r², the correlation of the power, here exp(-decay n²) over n segments.
    The rate of the power itself is anticorrelated instead, and its mean covariance is 0.

    Args:
        looks: number of looks M, three segments apart.
        decay: -ln of the power's correlation in neighbouring records; an array where interpreted.
        segments: distance between the two segments in a cycle.

    Returns:
        Σ (1 - |n|/M) exp(-decay (3n + segments)²) over -M < n < M.
    """
    total: _Numbers = 0.0 * decay
    for look in range(1 - int(looks), int(looks)):
        total = total + (1.0 - abs(look) / looks) * np.exp(-decay * (3.0 * look + segments) ** 2)
    return total


@kernel
def centre_wander(looks: float, decay: _Numbers, segments: float) -> _Numbers:
    """Covariance of the centres of power of two segments' looks, in looks²: what speckle weighs more counts more.

    To first order in the power's changes, ΣΣ exp(-decay (3(l - k) + segments)²) l k/M² with l and k from the middle of
    the looks; the sum of l (l + n) over the pairs n apart is m (m² - 1)/12 - m n²/4, m = M - |n|. Arguments as in
    `record_correlation`.
    """
    total: _Numbers = 0.0 * decay
    for look in range(1 - int(looks), int(looks)):
        pairs = looks - abs(look)
        products = pairs * (pairs * pairs - 1.0) / 12.0 - pairs * look * look / 4.0
        total = total + products / looks**2 * np.exp(-decay * (3.0 * look + segments) ** 2)
    return total
