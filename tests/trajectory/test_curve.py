"""Curves against scipy's cubic Hermite spline, numpy's gradient, parabolas and a sine."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.trajectory.curves import Curve, Curves, hermite, through

RNG = np.random.default_rng(11)


def read(curve: Curve, time_s: FloatArray) -> FloatArray:
    """Value, first and second derivative (3, n)."""
    return Curves([curve]).at(time_s)[..., 0]


def test_hermite_agrees_with_scipy_inside_and_outside() -> None:
    knot_s = np.cumsum(RNG.uniform(0.1, 3, 30))
    value, rate = RNG.normal(size=(2, 30))
    time_s = np.concatenate([RNG.uniform(knot_s[0] - 1, knot_s[-1] + 1, 500), knot_s])
    expected = CubicHermiteSpline(knot_s, value, rate)
    for order, found in enumerate(read(hermite(knot_s, value, rate), time_s)):
        np.testing.assert_allclose(found, expected(time_s, order), rtol=1e-9, atol=1e-9)


@given(
    st.lists(st.floats(0.05, 30), min_size=2, max_size=12),
    st.floats(-50, 50),
    st.floats(-20, 20),
    st.floats(0, 1),
)
def test_constant_acceleration_is_exact_at_any_spacing(
    steps: list[float], speed: float, acceleration: float, share: float
) -> None:
    knot_s = np.concatenate([[0.0], np.cumsum(steps)])
    time_s = np.array([share * knot_s[-1]])
    value, rate, second = read(through(knot_s, (speed + acceleration * knot_s / 2) * knot_s), time_s)
    scale = 1 + np.abs(speed) * knot_s[-1] + np.abs(acceleration) * knot_s[-1] ** 2
    shortest = min(steps)
    np.testing.assert_allclose(value, (speed + acceleration * time_s / 2) * time_s, atol=1e-13 * scale)
    np.testing.assert_allclose(rate, speed + acceleration * time_s, atol=1e-13 * scale / shortest)
    np.testing.assert_allclose(second, acceleration, atol=1e-12 * scale / shortest**2)


def test_two_rows_make_a_straight_line() -> None:
    line = through(np.array([1.0, 3.0]), np.array([5.0, 9.0]))
    value, rate, second = read(line, np.array([0.0, 2.0, 4.0]))
    np.testing.assert_allclose(value, [3, 7, 11])
    np.testing.assert_allclose(rate, 2)
    np.testing.assert_allclose(second, 0, atol=1e-15)


def test_curves_with_knots_of_their_own_are_read_together() -> None:
    """Each like alone, before, at and after its knots."""
    curves = []
    for count in (2, 7, 30):
        knot_s = np.cumsum(RNG.uniform(0.1, 3, count))
        curves.append(hermite(knot_s, *RNG.normal(size=(2, count))))
    time_s = np.concatenate([np.linspace(-5, 60, 200), *(curve.knot_s for curve in curves)])
    together = Curves(curves).at(time_s)
    for k, curve in enumerate(curves):
        np.testing.assert_array_equal(together[..., k], read(curve, time_s))
