"""The profile of a simple crater, fresh and degraded.

A fresh crater has a parabolic bowl, a rim, and ejecta whose thickness falls with the cube of the distance (McGetchin et
al. 1973); the rim's height is 0.18 of the depth (Pike 1977: 0.036 of the diameter with a depth of 0.196). Degradation
is diffusion, as countless small impacts cause it (Soderblom 1970; Fassett and Thomson 2014). Diffusion over an age t is
a convolution with a Gaussian of variance 2 κ t per axis, so that the state of a crater is one number, κ t over its
radius squared.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray

REACH_RADII = 4.0
"""Distance from the centre at which a crater's layer ends, in radii."""
RIM_SHARE = 0.18
"""Height of a fresh rim, as a fraction of the depth."""

_LAST_BLUR_RADII = 0.62
"""Standard deviation of the Gaussian at degradation 1, in radii: a fifth of the depth is left, and the crater is no
longer visible."""
_LEVELS = 32
_STEP = 1 / 32
_EJECTA_END = 3.0


def fresh_profile(radii: FloatArray) -> FloatArray:
    """Height over rim-to-floor depth at distances from the centre in units of the rim's radius."""
    outward = np.maximum(radii, 1.0)
    fade = np.clip((outward - 1.0) / (_EJECTA_END - 1.0), 0.0, 1.0)
    ejecta = RIM_SHARE / outward**3 * (1.0 - fade**2 * (3.0 - 2.0 * fade))
    return np.where(radii < 1.0, radii**2 - (1.0 - RIM_SHARE), ejecta)


def degraded_profiles(degradation: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Profiles of craters with given degradation.

    Args:
        wear: (craters,) from 0 to 1, the share of a crater's life that is over.

    Returns:
        Distances (radii,) in units of the rim's radius, heights (levels, radii) over the fresh depth, and for each
        crater (craters,) which of the levels is its own.
    """
    radii, heights = _table()
    return radii, heights, np.rint(degradation * _LEVELS).astype(np.int64)


def depth_left(degradation: FloatArray) -> FloatArray:
    """Height of the rim's circle above the centre, as a fraction of the fresh depth."""
    radii, heights, level = degraded_profiles(degradation)
    rim = int(np.argmin(np.abs(radii - 1.0)))
    return np.asarray(heights[level, rim] - heights[level, 0], dtype=np.float64)


@cache
def _table() -> tuple[FloatArray, FloatArray]:
    radii = np.arange(0.0, REACH_RADII + _STEP / 2, _STEP)
    blur = _LAST_BLUR_RADII * np.sqrt(np.arange(1, _LEVELS + 1) / _LEVELS)
    heights = np.stack([fresh_profile(radii), *(_blurred(radii, sigma) for sigma in blur)])
    # Diffusion reaches slightly beyond the end: the profile is tapered there to avoid a step in the ground.
    inward = np.clip(REACH_RADII - radii, 0.0, 1.0)
    return radii, heights * inward**2 * (3.0 - 2.0 * inward)


def _blurred(radii: FloatArray, sigma: float) -> FloatArray:
    """Fresh profile convolved with a Gaussian in the plane; for a figure of revolution this is an integral with I0."""
    from scipy.special import i0e

    rings = np.arange(_STEP / 8, _EJECTA_END, _STEP / 4)
    apart = (radii[:, None] - rings) / sigma
    kernel = rings / sigma**2 * np.exp(-(apart**2) / 2) * i0e(radii[:, None] * rings / sigma**2)
    return np.asarray((kernel * fresh_profile(rings)).sum(axis=1) * (_STEP / 4), dtype=np.float64)
