"""From a share between 0 and 1 to the value that this share of a distribution lies below."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.campaign import (
    Choice,
    Distribution,
    Integer,
    Lognormal,
    Normal,
    Triangular,
    Uniform,
)


def values_at(distribution: Distribution, share: FloatArray) -> list[Any]:
    """The values, as a scenario takes them, at shares (n,) within (0, 1)."""
    match distribution:
        case Choice():
            return [distribution.of[i] for i in _chosen(distribution, share)]
        case Integer():
            count = distribution.high - distribution.low + 1
            return [distribution.low + min(int(u * count), count - 1) for u in share.tolist()]
        case _:
            return [float(value) for value in _numbers(distribution, share)]


def _numbers(distribution: Uniform | Normal | Lognormal | Triangular, share: FloatArray) -> FloatArray:
    from scipy.special import ndtri

    match distribution:
        case Uniform():
            return distribution.low + share * (distribution.high - distribution.low)
        case Normal(low=None, high=None):
            return distribution.mean + distribution.sigma * np.asarray(ndtri(share))
        case Normal():
            return _truncated(distribution, share)
        case Lognormal():
            return distribution.median * np.exp(distribution.sigma_log * np.asarray(ndtri(share)))
    return _triangular(distribution, share)


def _truncated(normal: Normal, share: FloatArray) -> FloatArray:
    from scipy.stats import truncnorm

    low = -math.inf if normal.low is None else normal.low
    high = math.inf if normal.high is None else normal.high
    bounds = (low - normal.mean) / normal.sigma, (high - normal.mean) / normal.sigma
    values = normal.mean + normal.sigma * np.asarray(truncnorm.ppf(share, *bounds))
    return np.clip(values, low, high)  # which rounding may pass


def _triangular(triangular: Triangular, share: FloatArray) -> FloatArray:
    low, mode, high = triangular.low, triangular.mode, triangular.high
    rising = low + np.sqrt(share * (high - low) * (mode - low))
    falling = high - np.sqrt((1 - share) * (high - low) * (high - mode))
    return np.where(share * (high - low) < mode - low, rising, falling)


def _chosen(choice: Choice, share: FloatArray) -> list[int]:
    weights = np.array(choice.weights or [1.0] * len(choice.of))
    ends = np.cumsum(weights) / weights.sum()
    # The last one's end may fall short of 1 by rounding; what has no weight begins where it ends.
    return [
        int(i) for i in np.minimum(np.searchsorted(ends, share, side="right"), np.flatnonzero(weights)[-1])
    ]
