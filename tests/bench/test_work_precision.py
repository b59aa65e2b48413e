"""The Pareto front and the choice of a setting on made-up points, and the distance of spreads."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from lidar_emu.bench.errors_against_truth import bias, difference, rms, spread
from lidar_emu.bench.work_precision import cheapest, pareto_front


def test_front_of_known_points():
    points = [(1.0, 9.0), (2.0, 9.0), (2.0, 5.0), (3.0, 7.0), (4.0, 1.0), (4.0, 1.0), (5.0, 0.0), (9.0, 0.0)]
    assert pareto_front(points) == [0, 2, 4, 6]
    assert pareto_front([(1.0, np.nan), (2.0, 3.0)]) == [1]
    assert pareto_front([]) == []


POINT = st.tuples(st.integers(0, 9).map(float), st.integers(0, 9).map(float))


@given(st.lists(POINT, min_size=1, max_size=12))
def test_front_is_what_nothing_dominates(points):
    def beaten(i):
        t, e = points[i]
        return any(
            u <= t and f <= e and ((u, f) != (t, e) or j < i) for j, (u, f) in enumerate(points) if j != i
        )

    front = pareto_front(points)
    assert sorted(front) == [i for i in range(len(points)) if not beaten(i)]
    assert [points[i][0] for i in front] == sorted(points[i][0] for i in front)


def test_cheapest_meets_every_target():
    times = [1.0, 2.0, 3.0, 4.0]
    errors = [(9.0, 1.0), (2.0, 8.0), (2.0, 2.0), (0.0, 0.0)]
    assert cheapest(times, errors, (2.0, np.inf)) == 1
    assert cheapest(times, errors, (np.inf, 2.0)) == 0
    assert cheapest(times, errors, (2.0, 2.0)) == 2
    assert cheapest(times, errors, (1.0, 1.0)) == 3
    assert cheapest(times[:3], errors[:3], (1.0, 1.0)) is None
    assert cheapest([1.0], [(np.nan, 0.0)], (1.0, 1.0)) is None


def normal_errors(mean: float, sigma: float) -> np.ndarray:
    return norm.ppf((np.arange(20_000) + 0.5) / 20_000, mean, sigma)[:, None]


def test_distance_of_two_normal_spreads():
    """Quantiles differ by (m1 - m2) + (s1 - s2) z, z over the central 98 %: its mean square there is 0.908."""
    every = np.ones((20_000, 1), dtype=bool)
    one = spread(normal_errors(0.1, 0.3), normal_errors(0, 1), every)
    other = spread(normal_errors(0.2, 0.5), normal_errors(0, 1), every)
    shares = norm.ppf(np.arange(0.01, 0.995, 0.01))
    expected = np.sqrt(0.1**2 + 0.2**2 * np.mean(shares**2))
    apart = difference(one, other)
    assert apart.range_m == pytest.approx(expected, rel=1e-3)
    assert apart.speed_mps == 0.0
    assert bias(one.range_m) == pytest.approx(0.1, rel=1e-3)
    assert rms(other.speed_mps) == pytest.approx(np.sqrt(np.mean(shares**2)), rel=1e-3)


def test_dropouts_count_only_where_a_measurement_could_be():
    error = np.array([[0.1, np.nan], [np.nan, np.nan]])
    expected = np.array([[True, False], [True, True]])
    assert spread(error, error, expected).dropout == pytest.approx(2 / 3)
    assert spread(error, error, expected).count == 3
    nothing = spread(np.full((2, 1), np.nan), np.full((2, 1), np.nan), np.ones((2, 1), dtype=bool))
    assert np.isnan(nothing.range_m).all()
    assert nothing.dropout == 1.0
