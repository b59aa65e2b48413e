"""Rectangular bins of tones: the exact sum, and a quick one for tones far from 0 and N/2.

There the kernel of `spectrum` is the pole 1/(π(n - k + δ)), and the image, a distant pole, one number for all bins:
`tones_are_close` bounds what that leaves out.
"""

from __future__ import annotations

from math import copysign, pi, sqrt

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST, sin_pi, single_sin_pi
from lidar_emu.receiver.spectrum import BIN, whole_vectors

_LEAST_OFFSET = np.float32(1e-6)
"""δ is kept this far from 0, so that a tone on its bin has a pole beside it."""

_HALF, _UNIT, _TWO, _PER_PI = np.float32(0.5), np.float32(1.0), np.float32(2.0), np.float32(1.0 / pi)

_MOST_LEFT_OUT = 0.01
"""Amplitude that `set_close_tones` may leave out of a bin, relative to its noise: 1e-4 of the noise's power."""

_LARGEST_FADE = 20.0
"""Power of an echo over its mean which speckle exceeds with a probability of 2e-9."""


@kernel
def tones_are_close(length: float, grid: SingleArray, count: int, snr: float) -> bool:
    """Whether `set_close_tones` leaves out less than a hundredth of the noise's amplitude, of tones among these bins.

    For tones and bins within U of their middle at x, an image of the amplitude A/(2πx) changes by 2U/(2x) of its own,
    and the remainder of the kernel, csc(πu/N)/N - 1/(πu), is πu/6N².

    Args:
        snr: mean power of the tones over the noise of a rectangular bin.
    """
    reach = 0.5 * np.float64(grid[BIN, count - 1] - grid[BIN, 0]) + 1.0
    middle = 0.5 * np.float64(grid[BIN, 0] + grid[BIN, count - 1])
    distance = min(middle, 0.5 * length - middle)
    if distance <= 2.0 * reach:
        return False
    amplitude = sqrt(_LARGEST_FADE * snr)
    left_out = reach / (2.0 * pi * distance * distance) + pi * reach / (3.0 * length * length)
    return bool(amplitude * left_out < _MOST_LEFT_OUT)


@kernel
def set_close_tones(
    tones: SingleArray,
    columns: int,
    length: float,
    grid: SingleArray,
    count: int,
    bins: SingleArray,
    scratch: SingleArray,
) -> None:
    """Set the first `count` bins to the sum of tones for which `tones_are_close`; see `set_tones`.

    Args:
        scratch: (2, tones or more) overwritten.
    """
    residue_re, residue_im = scratch[0], scratch[1]
    _set_residues(columns, tones[0], tones[1], tones[2], tones[3], residue_re, residue_im)
    sum_re = sum_im = np.float32(0.0)
    for i in range(columns):
        sum_re, sum_im = sum_re + residue_re[i], sum_im + residue_im[i]
    twice = np.float64(grid[BIN, 0] + grid[BIN, count - 1])
    inverse = np.float32(pi / length / sin_pi(min(twice, length - twice) / length))
    wide, re, im = whole_vectors(count), bins[0], bins[1]
    for j in range(wide):
        re[j], im[j] = sum_re * inverse, -sum_im * inverse
    _add_poles(columns, tones[0], tones[1], residue_re, residue_im, wide, grid[BIN], re, im)


@kernel(fastmath=FAST)
def _set_residues(
    columns: int,
    whole: SingleArray,
    rest: SingleArray,
    weight_re: SingleArray,
    weight_im: SingleArray,
    residue_re: SingleArray,
    residue_im: SingleArray,
) -> None:
    """(-1)^n sin(πδ)/π times the weight; δ is kept away from zero."""
    for i in range(columns):
        rest[i] = np.copysign(max(abs(rest[i]), _LEAST_OFFSET), rest[i])
        odd = whole[i] - _TWO * np.floor(_HALF * whole[i])
        share = (_PER_PI - _TWO * _PER_PI * odd) * single_sin_pi(rest[i])
        residue_re[i], residue_im[i] = share * weight_re[i], share * weight_im[i]


@kernel(fastmath=FAST)
def _add_poles(
    columns: int,
    whole: SingleArray,
    rest: SingleArray,
    residue_re: SingleArray,
    residue_im: SingleArray,
    wide: int,
    number: SingleArray,
    re: SingleArray,
    im: SingleArray,
) -> None:
    """Add residue/(n - k + δ) of each tone, with one division for four of them."""
    for i in range(0, columns, 4):
        n1, n2, n3, n4 = whole[i], whole[i + 1], whole[i + 2], whole[i + 3]
        d1, d2, d3, d4 = rest[i], rest[i + 1], rest[i + 2], rest[i + 3]
        a1, a2, a3, a4 = residue_re[i], residue_re[i + 1], residue_re[i + 2], residue_re[i + 3]
        b1, b2, b3, b4 = residue_im[i], residue_im[i + 1], residue_im[i + 2], residue_im[i + 3]
        for j in range(wide):
            k = number[j]
            x1, x2 = (n1 - k) + d1, (n2 - k) + d2
            x3, x4 = (n3 - k) + d3, (n4 - k) + d4
            left, right = x1 * x2, x3 * x4
            inverse = _UNIT / (left * right)
            re[j] += ((a1 * x2 + a2 * x1) * right + (a3 * x4 + a4 * x3) * left) * inverse
            im[j] += ((b1 * x2 + b2 * x1) * right + (b3 * x4 + b4 * x3) * left) * inverse


@kernel(fastmath=FAST)
def set_tones(
    tones: SingleArray,
    columns: int,
    length: float,
    grid: SingleArray,
    count: int,
    bins: SingleArray,
    wide: FloatArray,
) -> None:
    """Set the first `count` bins, from 0 to N/2, to the sum of tones, at any frequency.

    With a = π(n + δ)/N and b = πk/N the two terms of a tone (see the module) share their denominator:

        1/sin(a - b) + 1/sin(a + b) = 2 sin(a) cos(b) / (sin(a - b) sin(a + b)),
        1/sin(a - b) - 1/sin(a + b) = 2 cos(a) sin(b) / (sin(a - b) sin(a + b)).

    There is no cancellation: a - b is evaluated as (n - k) + δ, the sum for sin(a + b) has no negative term, and
    cosines are sines of the distance to N/2.

    Args:
        tones: (4, columns or more) n, δ with |δ| <= 1/2, real and imaginary part of the weight.
        columns: number of tones.
        length: N.
        grid: grid from `lay_bins`.
        count: bins in use.
        bins: (2, capacity) receives real and imaginary parts.
        wide: (4, capacity) overwritten.
    """
    per_length = 1.0 / length
    half = 0.5 * length
    number, cosines, sines = grid[BIN, :count], wide[0, :count], wide[1, :count]
    re, im = wide[2, :count], wide[3, :count]
    for j in range(count):
        cosines[j], sines[j] = sin_pi((half - number[j]) * per_length), sin_pi(number[j] * per_length)
        re[j] = im[j] = 0.0
    for i in range(columns):
        n = np.float64(tones[0, i])
        rest = copysign(max(abs(np.float64(tones[1, i])), 1e-18), np.float64(tones[1, i]))
        sine = sin_pi((n + rest) * per_length)
        cosine = sin_pi(((half - n) - rest) * per_length)
        sign = -2.0 if int(n) & 1 else 2.0
        scale = sign * sin_pi(rest) * per_length
        share_re = scale * sine * tones[2, i]
        share_im = scale * cosine * tones[3, i]
        for j in range(count):
            difference = sin_pi(((n - number[j]) + rest) * per_length)
            kernel = 1.0 / (difference * (sine * cosines[j] + cosine * sines[j]))
            re[j], im[j] = re[j] + share_re * kernel, im[j] + share_im * kernel
    to_re, to_im = bins[0, :count], bins[1, :count]
    for j in range(count):
        to_re[j], to_im[j] = np.float32(re[j] * cosines[j]), np.float32(im[j] * sines[j])
