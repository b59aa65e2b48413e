"""Quantile functions of the distributions of a campaign."""

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


def values_at(distribution: Distribution, probability: FloatArray) -> list[Any]:
    """Map probabilities (n,) within (0, 1) to the values of a scenario key."""
    match distribution:
        case Choice():
            return [distribution.of[i] for i in _chosen(distribution, probability)]
        case Integer():
            count = distribution.high - distribution.low + 1
            return [distribution.low + min(int(u * count), count - 1) for u in probability.tolist()]
        case _:
            return [float(value) for value in _numbers(distribution, probability)]


def _numbers(distribution: Uniform | Normal | Lognormal | Triangular, probability: FloatArray) -> FloatArray:
    from scipy.special import ndtri

    match distribution:
        case Uniform():
            return distribution.low + probability * (distribution.high - distribution.low)
        case Normal(low=None, high=None):
            return distribution.mean + distribution.sigma * np.asarray(ndtri(probability))
        case Normal():
            return _truncated(distribution, probability)
        case Lognormal():
            return distribution.median * np.exp(distribution.sigma_log * np.asarray(ndtri(probability)))
    return _triangular(distribution, probability)


def _truncated(normal: Normal, probability: FloatArray) -> FloatArray:
    from scipy.stats import truncnorm

    low = -math.inf if normal.low is None else normal.low
    high = math.inf if normal.high is None else normal.high
    bounds = (low - normal.mean) / normal.sigma, (high - normal.mean) / normal.sigma
    values = normal.mean + normal.sigma * np.asarray(truncnorm.ppf(probability, *bounds))
    return np.clip(values, low, high)  # against rounding errors


def _triangular(triangular: Triangular, probability: FloatArray) -> FloatArray:
    low, mode, high = triangular.low, triangular.mode, triangular.high
    rising = low + np.sqrt(probability * (high - low) * (mode - low))
    falling = high - np.sqrt((1 - probability) * (high - low) * (high - mode))
    return np.where(probability * (high - low) < mode - low, rising, falling)


def _chosen(choice: Choice, probability: FloatArray) -> list[int]:
    weights = np.array(choice.weights or [1.0] * len(choice.of))
    ends = np.cumsum(weights) / weights.sum()
    # By rounding, the last end may be less than 1; a probability above it belongs to the last value with a weight.
    return [
        int(i)
        for i in np.minimum(np.searchsorted(ends, probability, side="right"), np.flatnonzero(weights)[-1])
    ]
