"""Rectangular bins of tones that are close together and far from 0 and N/2: the common case, at a third of the cost.

The kernel of `spectrum` is split into its pole and a remainder that is a polynomial over the few bins in question,

    csc(πx/N)/N = 1/(πx) + πx/6N² + 7π³x³/360N⁴ + ...,

and the image, a distant pole, is expanded in a Taylor series. Remainder and image then follow from five moments of the
tones, and only the poles are summed tone by tone, with one division for four of them.
"""

from __future__ import annotations

from math import copysign, pi

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST, sin_pi
from lidar_emu.receiver.spectrum import BIN

TONES_PER_DIVISION = 4
"""Tones are padded to a multiple of it with tones of zero weight."""

_LANES = 4
"""Numbers in a vector register."""

_Five = tuple[float, float, float, float, float]

_TRUNCATION = 3e-13
"""Largest U⁵/D⁶ for tones and bins within U of their middle and the image at D; π times the first neglected term."""


@kernel
def are_close(length: float, grid: FloatArray, count: int) -> bool:
    """Whether `set_close_tones` is exact to 1e-13 of the tones' weight, for tones among these bins."""
    reach = 0.5 * (grid[BIN, count - 1] - grid[BIN, 0]) + 1.0
    middle = _middle(grid, count)
    image = 2.0 * min(middle, 0.5 * length - middle)
    return image > 0.0 and (2.0 * reach) ** 5 <= _TRUNCATION * image**6


@kernel
def _middle(grid: FloatArray, count: int) -> float:
    return float(0.5 * (grid[BIN, 0] + grid[BIN, count - 1]))


@kernel(fastmath=FAST)
def set_close_tones(
    tones: FloatArray, length: float, grid: FloatArray, count: int, bins: FloatArray, scratch: FloatArray
) -> None:
    """Set the first `count` bins to the sum of tones that `are_close`.

    Args:
        tones: (4, tones) n, δ with |δ| <= 1/2, real and imaginary part of the weight; a multiple of
            TONES_PER_DIVISION.
        length: N.
        grid: grid from `lay_bins`.
        count: bins in use.
        bins: (2, capacity) receives real and imaginary parts.
        scratch: (2, tones or more) overwritten.
    """
    middle = _middle(grid, count)
    residues = scratch
    whole, rests, weight_re, weight_im = tones[0], tones[1], tones[2], tones[3]
    residue_re, residue_im = residues[0], residues[1]
    for i in range(len(whole)):
        odd = whole[i] - 2.0 * np.floor(0.5 * whole[i])
        share = (1.0 - 2.0 * odd) * sin_pi(_off(rests[i])) / pi
        residue_re[i], residue_im[i] = share * weight_re[i], share * weight_im[i]
    # In whole vectors where there are enough columns; columns beyond `count` are never read.
    wide = min(-(-count // _LANES) * _LANES, grid.shape[1], bins.shape[1])
    _sum_poles(tones, residues, grid, wide, bins)
    _add_remainder(tones, residues, length, middle, grid, wide, bins)


@kernel(fastmath=FAST)
def _sum_poles(
    tones: FloatArray, residues: FloatArray, grid: FloatArray, count: int, bins: FloatArray
) -> None:
    numbers, re, im = grid[BIN, :count], bins[0, :count], bins[1, :count]
    re[:] = 0.0
    im[:] = 0.0
    for i in range(0, tones.shape[1], TONES_PER_DIVISION):
        n1, n2, n3, n4 = tones[0, i], tones[0, i + 1], tones[0, i + 2], tones[0, i + 3]
        d1, d2 = _off(tones[1, i]), _off(tones[1, i + 1])
        d3, d4 = _off(tones[1, i + 2]), _off(tones[1, i + 3])
        a1, a2, a3, a4 = residues[0, i], residues[0, i + 1], residues[0, i + 2], residues[0, i + 3]
        b1, b2, b3, b4 = residues[1, i], residues[1, i + 1], residues[1, i + 2], residues[1, i + 3]
        for j in range(count):
            x1, x2 = (n1 - numbers[j]) + d1, (n2 - numbers[j]) + d2
            x3, x4 = (n3 - numbers[j]) + d3, (n4 - numbers[j]) + d4
            left, right = x1 * x2, x3 * x4
            inverse = 1.0 / (left * right)
            re[j] += ((a1 * x2 + a2 * x1) * right + (a3 * x4 + a4 * x3) * left) * inverse
            im[j] += ((b1 * x2 + b2 * x1) * right + (b3 * x4 + b4 * x3) * left) * inverse


@kernel(fastmath=FAST, forceinline=True)
def _off(rest: float) -> float:
    """δ kept away from zero, so that a tone on its bin has a pole beside it."""
    return rest + copysign(1e-18, rest)


@kernel(fastmath=FAST)
def _add_remainder(
    tones: FloatArray,
    residues: FloatArray,
    length: float,
    middle: float,
    grid: FloatArray,
    count: int,
    bins: FloatArray,
) -> None:
    places, rests = tones[0], tones[1]
    residue_re, residue_im = residues[0], residues[1]
    a0 = a1 = a2 = a3 = a4 = 0.0
    b0 = b1 = b2 = b3 = b4 = 0.0
    # Ten sums at once, since the order of each is fixed.
    for i in range(tones.shape[1]):
        e = (places[i] - middle) + rests[i]
        a, b = residue_re[i], residue_im[i]
        a0, b0 = a0 + a, b0 + b
        a, b = a * e, b * e
        a1, b1 = a1 + a, b1 + b
        a, b = a * e, b * e
        a2, b2 = a2 + a, b2 + b
        a, b = a * e, b * e
        a3, b3 = a3 + a, b3 + b
        a, b = a * e, b * e
        a4, b4 = a4 + a, b4 + b
    image = _image_series(2.0 * middle, length)
    p0, p1, p2, p3, p4 = _remainder(image, 1.0, length, a0, a1, a2, a3, a4)
    q0, q1, q2, q3, q4 = _remainder(image, -1.0, length, b0, b1, b2, b3, b4)
    numbers, re, im = grid[BIN, :count], bins[0, :count], bins[1, :count]
    for j in range(count):
        k = numbers[j] - middle
        re[j] += p0 + k * (p1 + k * (p2 + k * (p3 + k * p4)))
        im[j] += q0 + k * (q1 + k * (q2 + k * (q3 + k * q4)))


@kernel(fastmath=FAST, forceinline=True)
def _remainder(
    image: _Five, sign: float, length: float, m0: float, m1: float, m2: float, m3: float, m4: float
) -> _Five:
    f0, f1, f2, f3, f4 = (sign * image[0], sign * image[1], sign * image[2], sign * image[3], sign * image[4])
    first = pi * pi / (6.0 * length * length)
    third = 7.0 * pi**4 / (360.0 * length**4)
    return (
        f0 * m0 + f1 * m1 + f2 * m2 + f3 * m3 + f4 * m4 + first * m1 + third * m3,
        f1 * m0 + 2 * f2 * m1 + 3 * f3 * m2 + 4 * f4 * m3 - first * m0 - 3 * third * m2,
        f2 * m0 + 3 * f3 * m1 + 6 * f4 * m2 + 3 * third * m1,
        f3 * m0 + 4 * f4 * m1 - third * m0,
        f4 * m0,
    )


@kernel(fastmath=FAST)
def _image_series(place: float, length: float) -> _Five:
    """Taylor coefficients of (π/N) csc(πs/N) about s = `place`."""
    step = pi / length
    csc = 1.0 / sin_pi(place / length if place <= 0.5 * length else 1.0 - place / length)
    cot = csc * sin_pi(0.5 - place / length)
    square = cot * cot
    scale = step * csc
    return (
        scale,
        -scale * step * cot,
        scale * step**2 * (1.0 + 2.0 * square) / 2.0,
        -scale * step**3 * cot * (5.0 + 6.0 * square) / 6.0,
        scale * step**4 * (5.0 + square * (28.0 + 24.0 * square)) / 24.0,
    )
