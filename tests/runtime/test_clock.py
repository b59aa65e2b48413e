"""The clock's waits, none of which waits here."""

from __future__ import annotations

import os
import select
from datetime import timedelta
from typing import Any

import pytest

from lidar_emu.runtime import clock as clock_module
from lidar_emu.runtime.clock import Clock


class SteppedClock(Clock):
    """Shows a list of times, one at each look."""

    def __init__(self, *times_ns: int) -> None:
        self.times_ns = list(times_ns)

    def now_ns(self) -> int:
        return self.times_ns.pop(0)


def test_an_instant_in_the_past_is_not_waited_for(pipe: tuple[int, int]) -> None:
    assert SteppedClock(1000, 1001).wait(999, [pipe[0]]) == ([], [])


def test_an_instant_in_the_past_hides_no_ready_descriptor(pipe: tuple[int, int]) -> None:
    os.write(pipe[1], b"x")
    assert SteppedClock(1000).wait(999, [pipe[0]]) == ([pipe[0]], [])


def test_a_ready_descriptor_ends_a_wait_without_end(pipe: tuple[int, int]) -> None:
    assert Clock().wait(None, [pipe[0]], [pipe[1]]) == ([], [pipe[1]])
    os.write(pipe[1], b"x")
    assert Clock().wait(None, [pipe[0]]) == ([pipe[0]], [])


@pytest.fixture
def timeouts(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Timeouts of all waits from here on; each ends at once without a ready descriptor."""
    asked: list[float] = []

    def select(_: object, __: object, ___: object, timeout: float) -> tuple[list[int], list[int], list[int]]:
        asked.append(timeout)
        return [], [], []

    monkeypatch.setattr(clock_module.select, "select", select)
    return asked


def test_a_wait_is_taken_up_again_until_its_time_has_come(timeouts: list[float]) -> None:
    clock = SteppedClock(0, 9_000_010, 9_999_999, 10_000_001)
    assert clock.wait(10_000_000) == ([], [])
    assert timeouts == pytest.approx([9e-3, 0.99999e-3, 1e-9])
    assert clock.times_ns == []


def test_awake_it_asks_again_without_sleeping(timeouts: list[float]) -> None:
    clock = SteppedClock(0, 3_000, 6_000, 10_000)
    assert clock.wait(10_000, busy_wait=True) == ([], [])
    assert timeouts == [0.0, 0.0, 0.0]


def test_an_instant_in_another_century_is_waited_for_by_the_hour(monkeypatch: pytest.MonkeyPatch) -> None:
    eight_thousand_years_ns = 8000 * 365 * 86_400 * 10**9
    waited = select.select
    times_s: list[float] = []

    def wait_not_at_all(*args: Any) -> Any:
        *descriptors, timeout_s = args
        times_s.append(timeout_s)
        with pytest.raises(OverflowError):
            waited(*descriptors, eight_thousand_years_ns * 1e-9)
        return waited(*descriptors, 0.0)

    monkeypatch.setattr(clock_module.select, "select", wait_not_at_all)
    hour_ns = 3600 * 10**9
    clock = SteppedClock(0, hour_ns, eight_thousand_years_ns)
    assert clock.wait(eight_thousand_years_ns) == ([], [])
    assert times_s == [3600.0, 3600.0]


def test_the_wall_clock_is_utc() -> None:
    assert Clock().utc_now().utcoffset() == timedelta(0)
