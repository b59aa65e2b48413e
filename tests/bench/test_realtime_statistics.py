"""The figures of `bench realtime` on made-up instants, against numpy and by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.bench.realtime import in_order_of
from lidar_emu.bench.realtime_statistics import (
    NEVER,
    SecondComparison,
    Side,
    counts_between,
    figures,
    histogram_edges_ns,
    late_without_control,
    median_excess_ns,
    windows,
)

SECOND_NS = 1_000_000_000
VALUES = st.lists(st.integers(0, 10**10), min_size=1, max_size=200)


def side(lateness_ns: np.ndarray, rate_hz: int, late: list[int] | None = None) -> Side:
    """Due `rate_hz` times a second; skipped shots were woken up for, and never written."""
    due = np.arange(len(lateness_ns)) * (SECOND_NS // rate_hz)
    skipped = np.isin(np.arange(len(due)), late or [])
    written = np.where(skipped, NEVER, due + lateness_ns)
    return Side(due, due + lateness_ns // 2, written, written, skipped)


@given(VALUES)
def test_figures_are_numpys_quantiles(values):
    reported = figures(np.array(values))
    assert reported["count"] == len(values)
    for name, fraction in (("p50_ns", 0.5), ("p99_ns", 0.99), ("p99_9_ns", 0.999), ("max_ns", 1.0)):
        assert reported[name] == sorted(values)[max(0, int(np.ceil(fraction * len(values) - 1e-9)) - 1)]


def test_seconds_stand_beside_each_other():
    rng = np.random.default_rng(2)
    emulator = side(rng.integers(20_000, 90_000, 1050), 100, late=[3, 250, 251, 999])
    control = side(rng.integers(10_000, 50_000, 1050), 100, late=[255])
    reported = windows(emulator, control)
    assert [window.at_s for window in reported] == list(range(11))  # half of the last second is there
    assert [window.late for window in reported] == [1, 0, 2, 0, 0, 0, 0, 0, 0, 1, 0]
    assert [window.control_late for window in reported] == [0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0]
    assert late_without_control(reported) == 2
    excess = []
    for second in range(11):
        p99 = []
        for one in (emulator, control):
            part = slice(100 * second, 100 * (second + 1))
            written = one.written_ns[part] != NEVER
            lateness = (one.written_ns[part] - one.due_ns[part])[written]
            p99.append(np.quantile(lateness, 0.99, method="inverted_cdf"))
        assert (reported[second].p99_ns, reported[second].control_p99_ns) == tuple(p99)
        excess.append(p99[0] - p99[1])
    assert median_excess_ns(reported) == np.median(excess)


def test_a_second_that_was_cut_off_is_left_out():
    short = side(np.full(140, 9_000), 100)
    assert [window.at_s for window in windows(short, short)] == [0]


def test_a_second_of_skipped_shots_has_no_p99_but_counts():
    of = [SecondComparison(0, None, 5, 100, 0), SecondComparison(1, 30, 10, 0, 0)]
    assert median_excess_ns(of) == 20
    assert late_without_control(of) == 100


def test_skipped_shots_were_woken_up_for_all_the_same():
    one = side(np.full(10, 8_000), 100, late=[4])
    assert one.wake_up_ns().tolist() == [4_000] * 10
    assert one.due_to_written_ns().tolist() == one.due_to_received_ns().tolist() == [8_000] * 9


def test_receptions_go_to_the_packets_that_were_sent():
    sent = np.array([10, NEVER, 30, 40, NEVER, 60])
    assert in_order_of(sent, np.array([11, 31, 41])).tolist() == [11, NEVER, 31, 41, NEVER, NEVER]
    assert in_order_of(sent, np.array([11, 31, 41, 61, 71])).tolist() == [11, NEVER, 31, 41, NEVER, 61]


@given(VALUES, VALUES)
def test_no_value_falls_out_of_the_histogram(values, others):
    one, other = np.array(values), np.array(others)
    edges = histogram_edges_ns(one, other)
    assert (np.diff(edges) > 0).all()
    assert counts_between(one, edges).sum() == len(one)
    assert counts_between(other, edges).sum() == len(other)
