"""Chance by counter: any number of any shot can be drawn alone, whatever was drawn before.

Philox4x32-10 of Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC11. The key is the run's
seed; the counter says what the number is for: shot, beam, purpose and index.
"""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from lidar_emu.fmcw.sine import FAST, sin_pi
from lidar_emu.kernels import njit

_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_LOW = np.uint64(0xFFFFFFFF)
_WORD = np.uint64(32)
_SHIFT_26 = np.uint64(26)
_SHIFT_16 = np.uint64(16)
_SHIFT_5 = np.uint64(5)
_SHIFT_6 = np.uint64(6)

_Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]


@njit(cache=True)
def philox4x32(
    c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64
) -> _Words:
    """Ten rounds of Philox: four random words from a counter of four words and a key of two.

    All words are below 2**32, held in uint64 since the products need that width.
    """
    for _ in range(10):
        left = _MULTIPLIER_0 * c0
        right = _MULTIPLIER_1 * c2
        c0, c1, c2, c3 = (
            (right >> _WORD) ^ c1 ^ k0,
            right & _LOW,
            (left >> _WORD) ^ c3 ^ k1,
            left & _LOW,
        )
        k0 = (k0 + _WEYL_0) & _LOW
        k1 = (k1 + _WEYL_1) & _LOW
    return c0, c1, c2, c3


@njit(cache=True)
def uniform_pair(seed: np.uint64, shot: int, beam: int, purpose: int, index: int) -> tuple[float, float]:
    """Two independent uniforms, strictly between 0 and 1, of 53 bits each.

    `beam` and `purpose` are below 2**16, `index` below 2**32; `seed` and `shot` are 64 bits wide.
    """
    number = np.uint64(shot)
    a, b, c, d = philox4x32(
        number & _LOW,
        number >> _WORD,
        (np.uint64(purpose) << _SHIFT_16) | np.uint64(beam),
        np.uint64(index),
        seed & _LOW,
        seed >> _WORD,
    )
    return _unit_interval(a, b), _unit_interval(c, d)


@njit(cache=True)
def complex_normal(seed: np.uint64, shot: int, beam: int, purpose: int, index: int) -> tuple[float, float]:
    """Real and imaginary part of a circular complex Gaussian of unit mean power (Box-Muller)."""
    u, turn = uniform_pair(seed, shot, beam, purpose, index)
    radius = sqrt(-log(u))
    cosine, sine = unit_phasor(turn)
    return radius * cosine, radius * sine


@njit(cache=True, fastmath=FAST)
def unit_phasor(turn: float) -> tuple[float, float]:
    """Cosine and sine of 2 pi `turn` - pi, for `turn` from 0 to 1."""
    x = 2.0 * turn - 1.0
    nearest = x if abs(x) <= 0.5 else (1.0 - x if x > 0.0 else -1.0 - x)
    return sin_pi(0.5 - abs(x)), sin_pi(nearest)


@njit(cache=True)
def _unit_interval(high: np.uint64, low: np.uint64) -> float:
    bits = ((high >> _SHIFT_5) << _SHIFT_26) | (low >> _SHIFT_6)
    return (np.float64(bits) + 0.5) * 2.0**-53
