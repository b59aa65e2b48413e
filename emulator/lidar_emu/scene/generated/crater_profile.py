"""The profile of a simple crater, fresh and worn.

Fresh: a parabolic bowl, a rim, and ejecta that thin out with the cube of the distance (McGetchin et al. 1973); the
rim has 0.18 of the depth (Pike 1977: 0.036 of the diameter beside 0.196). Worn: the same after diffusion, which is what
countless small impacts do to a slope (Soderblom 1970; Fassett and Thomson 2014). Diffusion of age t is a blur by a
Gaussian of variance 2 κ t per axis, so that a crater's state is one number, κ t over its radius squared.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray

REACH_RADII = 4.0
"""Distance from the centre at which a crater's layer ends."""
RIM_SHARE = 0.18
"""Height of a fresh rim over depth."""

_LAST_BLUR_RADII = 0.62
"""Standard deviation at wear 1: a fifth of the depth is left, and the eye loses the crater."""
_LEVELS = 32
_STEP = 1 / 32
_EJECTA_END = 3.0


def fresh_profile(radii: FloatArray) -> FloatArray:
    """Height over rim-to-floor depth at distances from the centre in units of the rim's radius."""
    outward = np.maximum(radii, 1.0)
    fade = np.clip((outward - 1.0) / (_EJECTA_END - 1.0), 0.0, 1.0)
    ejecta = RIM_SHARE / outward**3 * (1.0 - fade**2 * (3.0 - 2.0 * fade))
    return np.where(radii < 1.0, radii**2 - (1.0 - RIM_SHARE), ejecta)


def worn_profiles(wear: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Profiles for craters of some wear.

    Args:
        wear: (craters,) from 0 to 1, the share of a crater's life that is over.

    Returns:
        Distances (radii,) in units of the rim's radius, heights (levels, radii) over the fresh depth, and for each
        crater (craters,) which of the levels is its own.
    """
    radii, heights = _table()
    return radii, heights, np.rint(wear * _LEVELS).astype(np.int64)


def depth_left(wear: FloatArray) -> FloatArray:
    """Height of the circle of the rim above the centre, over the depth of the fresh crater."""
    radii, heights, level = worn_profiles(wear)
    rim = int(np.argmin(np.abs(radii - 1.0)))
    return np.asarray(heights[level, rim] - heights[level, 0], dtype=np.float64)


@cache
def _table() -> tuple[FloatArray, FloatArray]:
    radii = np.arange(0.0, REACH_RADII + _STEP / 2, _STEP)
    blur = _LAST_BLUR_RADII * np.sqrt(np.arange(1, _LEVELS + 1) / _LEVELS)
    heights = np.stack([fresh_profile(radii), *(_blurred(radii, sigma) for sigma in blur)])
    # What little diffusion carries to the end fades there, lest the ground has a step.
    inward = np.clip(REACH_RADII - radii, 0.0, 1.0)
    return radii, heights * inward**2 * (3.0 - 2.0 * inward)


def _blurred(radii: FloatArray, sigma: float) -> FloatArray:
    """The fresh crater under a Gaussian of the plane, which for a figure of revolution is an integral with I0."""
    from scipy.special import i0e

    rings = np.arange(_STEP / 8, _EJECTA_END, _STEP / 4)
    apart = (radii[:, None] - rings) / sigma
    kernel = rings / sigma**2 * np.exp(-(apart**2) / 2) * i0e(radii[:, None] * rings / sigma**2)
    return np.asarray((kernel * fresh_profile(rings)).sum(axis=1) * (_STEP / 4), dtype=np.float64)
