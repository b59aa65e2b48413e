"""The histogram against numpy on the same values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.runtime.summary import LatenessHistogram, RollingLateness, steal_ticks

SECOND_NS = 1_000_000_000
NANOSECONDS = st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=50)


def filled(values: list[int]) -> LatenessHistogram:
    histogram = LatenessHistogram()
    for value in values:
        histogram.add(value)
    return histogram


def assert_just_above(bound_ns: int | None, exact_ns: int) -> None:
    assert bound_ns is not None
    assert exact_ns <= bound_ns <= exact_ns + exact_ns // 128


@given(NANOSECONDS, st.sampled_from([0.01, 0.25, 0.5, 0.9, 1.0]))
def test_quantiles_of_anything(values: list[int], fraction: float) -> None:
    exact = int(np.quantile(np.array(values), fraction, method="inverted_cdf"))
    assert_just_above(filled(values).quantile_ns(fraction), exact)


def test_one_long_stall_stays_visible() -> None:
    summary = filled([20_000] * 9_980 + [37_000_000] * 20).summary()
    assert summary["max_ns"] == 37_000_000
    assert_just_above(summary["p50_ns"], 20_000)
    assert_just_above(summary["p99_9_ns"], 37_000_000)


def test_nothing_counted_is_nothing_known() -> None:
    summary = LatenessHistogram().summary()
    assert summary == {"count": 0, "p50_ns": None, "p99_ns": None, "p99_9_ns": None, "max_ns": None}


@pytest.mark.parametrize("value", [-1, 2**63])
def test_what_is_no_lateness_is_refused(value: int) -> None:
    with pytest.raises(ValueError, match="lateness"):
        LatenessHistogram().add(value)


@pytest.mark.parametrize(
    ("text", "ticks"),
    [("cpu  1 2 3 4 5 6 7 812 9 10\ncpu0 1 2 3 4 5 6 7 8 9 10\n", 812), ("cpu 1 2 3\n", None), ("", None)],
)
def test_steal_is_the_eighth_field(tmp_path: Path, text: str, ticks: int | None) -> None:
    stat = tmp_path / "stat"
    stat.write_text(text)
    assert steal_ticks(stat) == ticks


def test_steal_is_unknown_without_the_file(tmp_path: Path) -> None:
    assert steal_ticks(tmp_path / "none") is None


def test_seconds_without_packets_do_not_count() -> None:
    windows = RollingLateness()
    windows.add(3 * SECOND_NS, 50)
    windows.add(10**6 * SECOND_NS, 70)
    assert windows.summary() == {"count": 2, "p99_median_ns": 50, "p99_worst_ns": 70, "worst_at_s": 10**6}


def test_no_packets_no_figures() -> None:
    reported = RollingLateness().summary()
    assert reported == {"count": 0, "p99_median_ns": None, "p99_worst_ns": None, "worst_at_s": None}
