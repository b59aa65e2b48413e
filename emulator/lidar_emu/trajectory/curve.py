"""Piecewise cubic Hermite curves with value, rate and second derivative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lidar_emu.arrays import FloatArray


@dataclass(frozen=True)
class Curve:
    """A cubic between each two of k knots; the end pieces continue outside."""

    knot_s: FloatArray
    """(k,) Increasing."""
    coefficients: FloatArray
    """(4, k - 1) Of the powers 0 to 3 of the time since the piece's first knot."""

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, first and second derivative at times (n,): the derivatives are those of this very curve, so
        that a speed always belongs to the positions around it."""
        piece = np.clip(np.searchsorted(self.knot_s, time_s, side="right") - 1, 0, len(self.knot_s) - 2)
        c0, c1, c2, c3 = self.coefficients[:, piece]
        since_s = time_s - self.knot_s[piece]
        value = ((c3 * since_s + c2) * since_s + c1) * since_s + c0
        rate = (3 * c3 * since_s + 2 * c2) * since_s + c1
        return value, rate, 6 * c3 * since_s + 2 * c2


def hermite(knot_s: FloatArray, value: FloatArray, rate: FloatArray) -> Curve:
    """The curve through values (k,) with given rates (k,) at knots (k,), k at least 2."""
    step_s = np.diff(knot_s)
    slope = np.diff(value) / step_s
    c2 = (3 * slope - 2 * rate[:-1] - rate[1:]) / step_s
    c3 = (rate[:-1] + rate[1:] - 2 * slope) / step_s**2
    return Curve(knot_s, np.stack([value[:-1], rate[:-1], c2, c3]))


def through(knot_s: FloatArray, value: FloatArray) -> Curve:
    """The curve through values (k,) at knots (k,), k at least 2, with rates derived from the values."""
    step_s = np.diff(knot_s)
    return hermite(knot_s, value, knot_rates(step_s, np.diff(value) / step_s))


def knot_rates(step_s: FloatArray, slope: FloatArray) -> FloatArray:
    """Rates (k,) at the knots of steps (k - 1,) with mean rates (k - 1,): of the parabola through each knot
    and its neighbours.

    Exact for constant acceleration, which is what a landing flies from row to row, and of second order at any
    spacing. Shape-preserving slopes (PCHIP) are neither: they are zero wherever a value turns back, which
    costs the speed up to half a row's worth of acceleration. A spline with a continuous second derivative is
    smoother, but one rough value or one long gap rings through all of its neighbours.
    """
    if len(slope) == 1:
        return np.repeat(slope, 2)
    inner = (step_s[1:] * slope[:-1] + step_s[:-1] * slope[1:]) / (step_s[:-1] + step_s[1:])
    # A parabola's mean rate over a step is the mean of the rates at its ends.
    return np.concatenate([2 * slope[:1] - inner[:1], inner, 2 * slope[-1:] - inner[-1:]])
