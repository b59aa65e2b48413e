"""Which process stalled: a monitor under a clock that the test moves."""

from __future__ import annotations

from typing import Any

import pytest

from lidar_emu.runtime.port.child import StallMonitor

MS = 1_000_000
START_NS = 77_000 * MS


class World:
    """A clock, the shots that are due every 10 ms, and what was noticed."""

    def __init__(self) -> None:
        self.now, self.computed = START_NS - 100 * MS, 0
        self.events: list[tuple[int, str]] = []
        clock: Any = self
        self.monitor = StallMonitor(clock, lambda time_ns, text: self.events.append((time_ns // MS, text)))

    def now_ns(self) -> int:
        return self.now

    def processor_time_ns(self) -> int:
        return self.computed

    def rest(self, ms: int, reports: int) -> None:
        """Wait, with a look every 10 ms and `reports` reports in each."""
        for _ in range(ms // 10):
            self.now += 10 * MS
            self.monitor.reported(reports)
            self.monitor.poll()


@pytest.fixture
def world() -> World:
    """A run of 1000 shots that has gone on for a second, all well."""
    made = World()
    for shot in range(1000):
        made.monitor.pushed(10 * MS * shot)
    made.monitor.begin(START_NS)
    made.rest(100, reports=0)
    made.rest(1000, reports=1)
    assert made.events == []
    return made


def test_silence_is_reported_once_at_its_beginning_and_at_its_end(world: World) -> None:
    world.rest(100, reports=0)
    assert world.events == [], "its packets were due for no more than 100 ms"
    world.rest(500, reports=0)
    assert world.events == [(1120, "the port process does not respond")]
    world.monitor.reported(60)
    world.rest(10, reports=1)
    assert world.events[1:] == [(1610, "the port process responds again, after 600 ms")]
    world.rest(1000, reports=1)
    assert len(world.events) == 2


def test_a_packet_that_was_late_already_when_it_was_pushed_is_no_silence(world: World) -> None:
    world.monitor.reported(899)
    for shot in range(5):
        world.monitor.pushed(10 * MS * shot)
        world.rest(50, reports=0)
        world.monitor.reported(1)
    assert world.events == []


def test_nothing_due_nothing_missed(world: World) -> None:
    world.monitor.reported(899)
    world.rest(5000, reports=0)
    assert world.events == []


def test_superseded_packets_are_reported_together(world: World) -> None:
    world.monitor.reported(899)
    world.monitor.pushed(2000 * MS)
    world.rest(800, reports=0)
    world.rest(10, reports=1)
    assert world.events == []


@pytest.mark.parametrize(
    ("away_ms", "computed_ms", "noticed"), [(90, 0, False), (3000, 2950, False), (130, 0, True)]
)
def test_time_that_was_neither_slept_nor_computed_in(
    world: World, away_ms: int, computed_ms: int, noticed: bool
) -> None:
    world.now += away_ms * MS
    world.computed += computed_ms * MS
    world.monitor.reported(away_ms // 10)
    world.monitor.poll()
    expected = [(1000 + away_ms, f"the model process stalled for {away_ms} ms")] if noticed else []
    assert world.events == expected


def test_without_the_clocks_pace_nobody_is_missed() -> None:
    world = World()
    world.monitor.pushed(0)
    world.now += 10_000 * MS
    world.monitor.poll()
    assert world.events == []


def test_a_packet_that_waits_for_a_poll_is_no_silence() -> None:
    polled = World()
    for shot in range(3):
        polled.monitor.pushed(1000 * MS * shot)
    polled.monitor.begin(START_NS, poll_ns=1000 * MS)
    polled.rest(1050, reports=0)
    assert polled.events == [], "the packet of shot 0 waits until 1000 ms"
    polled.rest(200, reports=0)
    assert [text for _, text in polled.events] == ["the port process does not respond"]
    polled.monitor.reported(1)
    polled.rest(800, reports=0)
    assert len(polled.events) == 2
