"""False locks: the strongest bin of a spectrum is a noise bin."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.probability.fading import Fading, detection_probability
from lidar_emu.probability.quadrature import nodes_and_weights

_NEGLIGIBLE = 40.0
"""-ln of the probability left out at either end of the integral."""
_PANELS = np.linspace(0.0, 1.0, 25)


def false_lock_probability(
    fading: Fading, snr: ArrayLike, minus_log_pfa: float, bins: float, looks: int = 1
) -> FloatArray:
    """Probability that the highest of N noise bins exceeds both the signal's bin and the threshold.

    Expressed as L, the -ln P of noise above it, the power of a noise bin is exponential with mean 1 for any number of
    looks. The signal is below a noise bin at L with the miss probability of a threshold at L:

        ∫ P_miss(L) N (1 - e^-L)^(N-1) e^-L dL   from the threshold's own L,

    to an absolute error of 1e-11.

    Args:
        fading: fading of the signal.
        snr: mean power of the signal in its bin over the mean noise power, for one look; any shape.
        minus_log_pfa: L of the threshold; 0: no threshold.
        bins: N independent bins.
        looks: M, from 1.
    """
    lowest = max(minus_log_pfa, -np.log(-np.expm1(-_NEGLIGIBLE / bins)))
    highest = max(lowest, np.log(bins)) + _NEGLIGIBLE
    level, weight = nodes_and_weights(lowest + (highest - lowest) * _PANELS)
    density = bins * np.exp((bins - 1.0) * np.log1p(-np.exp(-level)) - level)
    ratio = np.asarray(snr, dtype=float)[..., None]
    missed = 1.0 - detection_probability(fading, ratio, level, looks)
    return np.asarray((missed * density * weight).sum(axis=-1))
