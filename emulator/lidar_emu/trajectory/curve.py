"""Piecewise cubic Hermite curves with value, rate and second derivative."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel


class Curve(NamedTuple):
    """A cubic piece between neighbouring knots; the end pieces continue outside."""

    knot_s: FloatArray
    """(k,) Increasing."""
    coefficients: FloatArray
    """(4, k - 1) Coefficients of the powers 0 to 3 of the time since the piece's first knot."""


LEVEL = Curve(np.array([0.0, 1.0]), np.zeros((4, 1)))
"""Zero at all times."""


class Curves:
    """Curves with their own knots, evaluated together."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        # A knot and the piece that begins there share an index; no piece begins at the last knot of a curve.
        self._first = np.cumsum([0, *(len(curve.knot_s) for curve in curves)])
        self._knot_s = np.concatenate([curve.knot_s for curve in curves])
        self._pieces = np.concatenate([np.pad(curve.coefficients.T, ((0, 1), (0, 0))) for curve in curves])

    def at(self, time_s: FloatArray) -> FloatArray:
        """Values, first and second derivatives (3, n, curves) at times (n,); the derivatives are exact, so that speeds
        are consistent with positions."""
        orders = np.empty((3, len(time_s), len(self._first) - 1))
        _read(self._first, self._knot_s, self._pieces, time_s, orders)
        return orders


@kernel(outermost=True)
def _read(
    first: IntArray, knot_s: FloatArray, pieces: FloatArray, time_s: FloatArray, orders: FloatArray
) -> None:
    for c in range(len(first) - 1):
        for k in range(len(time_s)):
            piece = piece_at(knot_s[first[c] : first[c + 1] - 1], time_s[k])
            since_s = time_s[k] - knot_s[first[c] + piece]
            power = pieces[first[c] + piece]
            orders[0, k, c] = ((power[3] * since_s + power[2]) * since_s + power[1]) * since_s + power[0]
            orders[1, k, c] = (3 * power[3] * since_s + 2 * power[2]) * since_s + power[1]
            orders[2, k, c] = 6 * power[3] * since_s + 2 * power[2]


@kernel
def piece_at(start_s: FloatArray, time_s: float) -> int:
    """Index of the last piece that has begun at a time, given their starts (pieces,); 0 before the first."""
    low, high = 0, len(start_s)
    while high - low > 1:
        middle = (low + high) // 2
        if time_s >= start_s[middle]:
            low = middle
        else:
            high = middle
    return low


def hermite(knot_s: FloatArray, value: FloatArray, rate: FloatArray) -> Curve:
    """Curve through values (k,) with given rates (k,) at knots (k,), k at least 2."""
    step_s = np.diff(knot_s)
    slope = np.diff(value) / step_s
    c2 = (3 * slope - 2 * rate[:-1] - rate[1:]) / step_s
    c3 = (rate[:-1] + rate[1:] - 2 * slope) / step_s**2
    return Curve(knot_s, np.stack([value[:-1], rate[:-1], c2, c3]))


def through(knot_s: FloatArray, value: FloatArray) -> Curve:
    """Curve through values (k,) at knots (k,), k at least 2, with rates derived from the values."""
    step_s = np.diff(knot_s)
    return hermite(knot_s, value, knot_rates(step_s, np.diff(value) / step_s))


def knot_rates(step_s: FloatArray, slope: FloatArray) -> FloatArray:
    """Rates (k,) at the knots, from steps (k - 1,) and their mean rates (k - 1,), by the parabola through each knot and
    its neighbours.

    The rates are exact for constant acceleration, which approximates a landing from row to row, and of second order at
    any spacing. Shape-preserving slopes (PCHIP) are neither: they are zero at every extremum, an error in speed of up
    to half a row's acceleration. A spline with a continuous second derivative is smoother, but one outlier or one long
    gap makes all of its neighbours oscillate.
    """
    if len(slope) == 1:
        return np.repeat(slope, 2)
    inner = (step_s[1:] * slope[:-1] + step_s[:-1] * slope[1:]) / (step_s[:-1] + step_s[1:])
    # A parabola's mean rate over a step is the mean of the rates at its ends.
    return np.concatenate([2 * slope[:1] - inner[:1], inner, 2 * slope[-1:] - inner[-1:]])
