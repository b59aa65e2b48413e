"""Lateness by the second against numpy on the same values."""

from __future__ import annotations

import numpy as np

from lidar_emu.runtime.summary import RollingLateness

SECOND_NS = 1_000_000_000


def test_seconds_of_a_run_with_a_bad_one() -> None:
    random = np.random.default_rng(3)
    lateness = [random.lognormal(10, 1, 100).astype(np.int64) for _ in range(41)]
    lateness[17] += 5_000_000
    windows = RollingLateness()
    for second, values in enumerate(lateness):
        for shot, value in enumerate(values.tolist()):
            windows.add(second * SECOND_NS + shot * SECOND_NS // 100, value)
    p99 = [int(np.quantile(values, 0.99, method="inverted_cdf")) for values in lateness]
    reported = windows.summary()
    assert (reported["count"], reported["worst_at_s"]) == (41, 17)
    for name, exact in (("p99_worst_ns", max(p99)), ("p99_median_ns", sorted(p99)[20])):
        value = reported[name]
        assert value is not None
        assert exact <= value <= exact * (1 + 1 / 128) ** 2


def test_seconds_without_packets_do_not_count() -> None:
    windows = RollingLateness()
    windows.add(3 * SECOND_NS, 50)
    windows.add(10**6 * SECOND_NS, 70)
    assert windows.summary() == {"count": 2, "p99_median_ns": 50, "p99_worst_ns": 70, "worst_at_s": 10**6}


def test_no_packets_no_figures() -> None:
    reported = RollingLateness().summary()
    assert reported == {"count": 0, "p99_median_ns": None, "p99_worst_ns": None, "worst_at_s": None}
