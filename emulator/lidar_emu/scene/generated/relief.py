"""Fractal relief: an exact sample of a fractional Brownian surface, without the period of the Fourier transform.

Heights at points r apart differ by a Gaussian of variance s² r^2H. Stein (2002), "Fast and exact simulation of
fractional Brownian surfaces", adds a parabola to that variogram, which makes it the variogram of a stationary field
with compact covariance; such a field is exact on a sufficiently large torus, and a random tilt removes the parabola
again. Less than half of the torus is kept, so that opposite edges are independent.
"""

from __future__ import annotations

import math

import numpy as np

from lidar_emu.numerics.arrays import FloatArray

_ROWS_AT_ONCE = 64
"""Rows transformed at once: enough for speed, without holding the whole torus in memory."""
_ROUGH_REACH, _SMOOTH_REACH = 1.0, 1.5
"""Distance at which the covariance ends, in sides of the square, for H up to 3/4 and above. Stein has 2 for the latter;
from 1.4 on the spectrum was nonnegative on every grid tried."""


def fractional_surface(side: int, hurst: float, rng: np.random.Generator) -> FloatArray:
    """Draw a fractional Brownian surface on a square grid.

    Args:
        side: samples per side.
        hurst: H, above 0 and below 1.
        rng: random generator.

    Returns:
        Heights (side, side) of mean 0. Points r apart, in units of the square's side and at most 1, differ by the
        variance 2 r^2H before the mean is subtracted, which does not change differences.
    """
    spectrum, parabola = torus_spectrum(side, hurst)
    height = _field(spectrum, side, rng)
    tilt = rng.standard_normal(2) * math.sqrt(2 * parabola)
    place = np.arange(side) / (side - 1)
    height += tilt[0] * place[:, None] + tilt[1] * place
    return np.asarray(height - height.mean(), dtype=np.float64)


def torus_spectrum(side: int, hurst: float) -> tuple[FloatArray, float]:
    """Eigenvalues of the covariance on the torus, and the coefficient of the parabola added to the variogram.

    Returns:
        (m + 1, m + 1) of one quadrant, symmetric, for a torus of 2 m by 2 m samples; and c in 2 r^2H - 2 c r².
    """
    from scipy import fft

    reach = _ROUGH_REACH if hurst <= 0.75 else _SMOOTH_REACH
    half = fft.next_fast_len(math.ceil(reach * (side - 1)), real=True)
    distance = np.arange(half + 1) / (side - 1)
    covariance, parabola = _covariance(np.hypot(distance[:, None], distance), 2 * hurst, reach)
    return np.maximum(fft.dctn(covariance, type=1, overwrite_x=True), 0.0), parabola


def _covariance(r: FloatArray, power: float, reach: float) -> tuple[FloatArray, float]:
    """Stein's covariance, twice differentiable where it joins its tail, and the coefficient of its parabola."""
    tail = 0.0 if reach == 1.0 else power * (2 - power) / (3 * reach * (reach**2 - 1))
    parabola = (power - tail * (reach - 1) ** 2 * (reach + 2)) / 2
    constant = tail * (reach - 1) ** 3 + 1 - parabola
    inner = constant - r**power + parabola * r**2
    outer = tail * np.maximum(reach - r, 0.0) ** 3 / np.maximum(r, 1.0)
    return np.where(r <= 1.0, inner, outer), parabola


def _field(spectrum: FloatArray, side: int, rng: np.random.Generator) -> FloatArray:
    """Corner (side, side) of a Gaussian field with that spectrum on its torus."""
    from scipy import fft

    half = len(spectrum) - 1
    # Amplitudes are symmetric: wave numbers 0 to half, then half - 1 down to 1.
    mirrored = np.concatenate([np.arange(half + 1), np.arange(half - 1, 0, -1)])
    waves = np.empty((half + 1, side), dtype=np.complex128)
    for first in range(0, half + 1, _ROWS_AT_ONCE):
        amplitude = np.sqrt(spectrum[first : first + _ROWS_AT_ONCE, mirrored])
        noise = rng.standard_normal((2, *amplitude.shape))
        block = fft.fft((noise[0] + 1j * noise[1]) * amplitude, axis=1, overwrite_x=True)
        waves[first : first + _ROWS_AT_ONCE] = block[:, :side] / math.sqrt(2)
    # The two wave numbers that are their own mirror images have real coefficients.
    for own in (0, half):
        waves[own] = waves[own].real * math.sqrt(2)
    height = np.empty((side, side))
    for first in range(0, side, _ROWS_AT_ONCE):
        block = fft.irfft(waves[:, first : first + _ROWS_AT_ONCE].T, n=2 * half, axis=1)
        height[first : first + _ROWS_AT_ONCE] = block[:, :side]
    return height
