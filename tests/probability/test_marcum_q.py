"""Marcum's Q against 50 digits of its definition, published values and the noncentral chi-squared distribution."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp, mpf
from scipy.stats import ncx2

from lidar_emu.receiver.probability import log_q, marcum_q

REFERENCE = json.loads(Path(__file__).with_name("marcum_reference.json").read_text())
LENGTH = st.floats(0.0, 1e4)


def relative_error(value, reference):
    """A probability that has no double beside 1 or 0 counts as 1 or 0."""
    if abs(reference) < mpf("1e-300"):
        return float(abs(value))
    return float(abs(mpf(float(value)) / reference - 1))


@pytest.mark.parametrize(("a", "b", "ln_q"), [(a, b, ln_q) for a, b, ln_q, _ in REFERENCE])
def test_both_tails_have_twelve_digits(a, b, ln_q):
    with mp.workdps(40):
        assert relative_error(log_q(a, b), mpf(ln_q)) < 1e-12


def test_arrays_give_what_single_values_give():
    a, b, *_ = (np.array(column, dtype=object) for column in zip(*REFERENCE, strict=True))
    a, b = a.astype(float), b.astype(float)
    np.testing.assert_array_equal(log_q(a, b), [float(log_q(*pair)) for pair in zip(a, b, strict=True)])
    assert log_q(a[:, None], b[None, :3]).shape == (len(a), 3)


def test_no_threshold_is_always_exceeded():
    assert log_q([0.0, 3.0, 1e4], 0.0).tolist() == [0.0, 0.0, 0.0]


def test_without_signal_it_is_rayleighs():
    b = np.array([1e-200, 1e-9, 0.5, 0.999, 1.0, 20.0])
    np.testing.assert_allclose(log_q(0.0, b), -b * b / 2, rtol=1e-14)


@given(LENGTH, LENGTH)
def test_reflection(a, b):
    """Q(a, b) + Q(b, a) = 1 + e^-(a² + b²)/2 I_0(ab), an identity between both branches."""
    from scipy.special import i0e

    both = np.exp(log_q(a, b)) + np.exp(log_q(b, a))
    assert both == pytest.approx(1.0 + np.exp(-0.5 * (a - b) ** 2) * i0e(a * b), abs=1e-13)


@pytest.mark.parametrize("edge", [24.999999, 25.000001])
def test_forms_meet(edge):
    a = np.geomspace(1e-3, 1e3, 200)
    middle = log_q(a, 25.0 / a)
    rate = np.abs(log_q(a, 25.0 / a * (1 + 1e-6)) - log_q(a, 25.0 / a * (1 - 1e-6)))
    assert (np.abs(log_q(a, edge / a) - middle) <= rate + 1e-12 * np.abs(middle)).all()


@pytest.mark.parametrize("order", [1, 2, 5, 16, 64])
def test_higher_orders_are_noncentral_chi_squared(order):
    a = np.geomspace(1e-3, 100.0, 60)[:, None]
    b = np.abs(np.sqrt(a * a + 2 * order) + np.linspace(-6.0, 6.0, 13))
    with np.errstate(all="ignore"):
        reference = ncx2.sf(b * b, 2 * order, a * a)
    np.testing.assert_allclose(marcum_q(order, a, b), reference, rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", [2, 5, 16, 64])
@pytest.mark.parametrize(
    ("a", "shift"), [(0.0, 1.0), (1e-3, -1.0), (5.0, 0.5), (35.3, 0.0), (300.0, -2.0), (3e3, 1.0)]
)
def test_higher_orders_by_definition(order, a, shift):
    b = float(np.sqrt(a * a + 2 * order) + shift)
    with mp.workdps(30):
        # x (x/a)^(M-1) e^-(x² + a²)/2 I_(M-1)(ax), from b.
        def density(x):
            if a == 0:
                return 2 * x * (x * x / 2) ** (order - 1) * mp.exp(-x * x / 2) / (2 * mp.factorial(order - 1))
            return (
                x * (x / a) ** (order - 1) * mp.exp(-(x * x + mpf(a) ** 2) / 2) * mp.besseli(order - 1, a * x)
            )

        reference = mp.quad(density, [mpf(b) + k for k in range(0, 21, 2)], method="gauss-legendre")
    assert float(marcum_q(order, a, b)) == pytest.approx(float(reference), abs=1e-12)
