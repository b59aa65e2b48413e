"""The Pareto front, its picture and the choice of a setting on made-up points, and the distance of spreads."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.transforms import Bbox
from scipy.stats import norm

from lidar_emu.bench.accuracy import AccuracyReport, SettingResult, cheapest, marks, pareto_front
from lidar_emu.bench.settings import (
    REFERENCE,
    DistributionDifference,
    ErrorSpread,
    Setting,
    bias,
    difference,
    false_locks,
    outcome_noise,
    rms,
    spread,
)
from lidar_emu.receiver.returns import Echoes, Returns
from lidar_emu.report.statistics_plots import Mark, plot_work_precision


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
    one = spread(normal_errors(0.1, 0.3), normal_errors(0, 1), ~every, every)
    other = spread(normal_errors(0.2, 0.5), normal_errors(0, 1), ~every, every)
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
    none = np.zeros((2, 2), dtype=bool)
    assert spread(error, error, none, expected).dropout == pytest.approx(2 / 3)
    assert spread(error, error, none, expected).count == 3
    nothing = spread(
        np.full((2, 1), np.nan), np.full((2, 1), np.nan), none[:, :1], np.ones((2, 1), dtype=bool)
    )
    assert np.isnan(nothing.range_m).all()
    assert nothing.dropout == 1.0


def test_false_locks_are_an_outcome_and_not_an_error():
    """A lock 900 m off would otherwise set the root mean square; distance of (.6, .1, .3) and (.5, .3, .2) by hand."""
    every = np.ones((10, 1), dtype=bool)

    def outcomes(false: int, lost: int):
        error = np.full((10, 1), 0.1)
        error[:false], error[10 - lost :] = 900.0, np.nan
        return spread(error, error, np.arange(10)[:, None] < false, every)

    one, other = outcomes(1, 3), outcomes(3, 2)
    assert (one.false_lock, one.dropout) == (0.1, pytest.approx(0.3))
    assert rms(one.range_m) == pytest.approx(0.1)
    # The shares of correct locks and dropouts are larger by 0.1 each, the share of false locks is smaller by 0.2.
    assert difference(one, other).outcome == pytest.approx(0.2)
    assert difference(other, one).outcome == pytest.approx(0.2)
    # Of the shares (2 + 1)/12, (2.5 + 1)/12 and their sum the last varies most.
    assert outcome_noise(one, other) == pytest.approx((2 * (6.5 / 12) * (5.5 / 12) / 10) ** 0.5)


def test_an_outcome_that_was_never_seen_is_not_impossible():
    every = np.ones((15, 1), dtype=bool)
    always = spread(np.zeros((15, 1)), np.zeros((15, 1)), ~every, every)
    assert outcome_noise(always, always) > 0.1


def test_false_locks_lie_outside_the_footprint():
    """Beamlets from 100 to 130 m and 5 m/s; bins of 1 m and 0.1 m/s."""
    range_m = np.array([[99.0, 115.0, 141.0, 139.0, 115.0, 115.0, 500.0]])
    speed_mps = np.array([[5.0, 5.0, 5.0, 5.0, 6.1, 4.1, 5.0]])
    valid = np.array([[True, True, True, True, True, True, False]])
    nowhere = np.full((1, 7, 3), np.nan)
    echoes = Echoes(*[nowhere] * len(Echoes._fields))._replace(
        range_m=np.broadcast_to([100.0, 130.0, np.nan], nowhere.shape),
        closing_speed_mps=np.broadcast_to([5.0, 5.0, np.nan], nowhere.shape),
    )
    returns = Returns.with_columns((1, 7), range_m=range_m, closing_speed_mps=speed_mps, range_valid=valid)
    assert false_locks(returns, echoes, 1.0, 0.1).tolist() == [
        [False, False, True, False, True, False, False]
    ]


def test_each_error_has_its_own_front():
    """Of three settings the slowest has the least range error, the fastest the least speed error."""

    def made_up(setting, time_s, *errors):
        nothing = ErrorSpread(np.zeros(99), np.zeros(99), 0.0, 0.0, 1)
        return SettingResult(setting, time_s, 0.0, nothing, DistributionDifference(*errors))

    fast, middle, slow = (Setting("spectral", count) for count in (1, 19, 127))
    results = [
        made_up(fast, 1e-5, 0.3, 1e-3, 0.2), made_up(middle, 2e-5, 0.2, 3e-3, 0.1),
        made_up(slow, 3e-5, 0.1, 2e-3, 0.1), made_up(REFERENCE, 1e-1, 0.0, 0.0, 0.0),
    ]  # fmt: skip
    report = AccuracyReport("x", 10, 10, DistributionDifference(1e-9, 1e-9, 1e-9), results)
    fronts = [[mark.time_s for mark in marked if mark.on_front] for marked in marks(report)]
    assert fronts == [[1e-5, 2e-5, 3e-5, 1e-1], [1e-5, 1e-1], [1e-5, 2e-5, 1e-1]]


def test_labels_meet_neither_marks_nor_labels_and_no_line_leads_to_the_reference(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(
        "lidar_emu.report.statistics_plots.write_plot", lambda figure, _: drawn.append(figure)
    )
    crowd = [Mark("a", "127", 1e-5 * 1.02**k, 0.1 * 0.97**k, True, k == 0) for k in range(4)]
    exact = Mark("exact", "", 1.0, 0.0, True, False)
    plot_work_precision([("error (m)", [*crowd, exact], 0.05)], "x", tmp_path / "x.png")
    (figure,) = drawn
    (axes,) = figure.axes
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text() == "127"]
    boxes += [Bbox([at - 3, at + 3]) for at in axes.transData.transform([mark[2:4] for mark in crowd])]
    assert len(boxes) == 8
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    front = next(line for line in axes.lines if line.get_label() == "Pareto front")
    assert max(front.get_xdata()) == crowd[-1].time_s
