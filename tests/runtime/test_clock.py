"""The clock's waits, none of which waits here."""

from __future__ import annotations

import os
from collections.abc import Iterator
from datetime import timedelta

import pytest

from lidar_emu.runtime import clock as clock_module
from lidar_emu.runtime.clock import Clock


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for descriptor in ends:
        os.close(descriptor)


class SteppedClock(Clock):
    """Shows a list of times, one at each look."""

    def __init__(self, *times_ns: int) -> None:
        self.times_ns = list(times_ns)

    def now_ns(self) -> int:
        return self.times_ns.pop(0)


def test_an_instant_in_the_past_is_not_waited_for(pipe: tuple[int, int]) -> None:
    assert SteppedClock(1000).wait(999, [pipe[0]]) == ([], [])


def test_a_ready_descriptor_ends_a_wait_without_end(pipe: tuple[int, int]) -> None:
    assert Clock().wait(None, [pipe[0]], [pipe[1]]) == ([], [pipe[1]])
    os.write(pipe[1], b"x")
    assert Clock().wait(None, [pipe[0]]) == ([pipe[0]], [])


def test_a_wait_is_taken_up_again_until_its_time_has_come(monkeypatch: pytest.MonkeyPatch) -> None:
    timeouts: list[float] = []

    def select(_: object, __: object, ___: object, timeout: float) -> tuple[list[int], list[int], list[int]]:
        timeouts.append(timeout)
        return [], [], []

    monkeypatch.setattr(clock_module.select, "select", select)
    clock = SteppedClock(0, 9_000_010, 9_999_999, 10_000_001)
    assert clock.wait(10_000_000) == ([], [])
    assert timeouts == pytest.approx([9e-3, 0.99999e-3, 1e-9, 0.0])
    assert clock.times_ns == []


def test_the_wall_clock_is_utc() -> None:
    assert Clock().utc_now().utcoffset() == timedelta(0)
