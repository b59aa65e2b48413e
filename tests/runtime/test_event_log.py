"""Which of many link events are kept."""

from __future__ import annotations

import pytest

from lidar_emu.runtime.port.status import EventLog, PortStatus


@pytest.mark.parametrize("count", [0, 1, 9, 10, 11, 19, 20, 21, 30, 5000])
def test_the_first_and_the_last_ten_are_kept_in_order(count: int) -> None:
    log = EventLog()
    for number in range(1, count + 1):
        log.add(number, 1000 + number, str(number))
    everything = [(number, str(number)) for number in range(1, count + 1)]
    expected = everything if count <= 20 else everything[:10] + everything[-10:]
    assert [(event.time_ns, event.text) for event in log.since(1000)] == expected
    assert log.count == count


def test_events_that_were_lost_on_the_way_count() -> None:
    log = EventLog()
    log.add(1, 0, "nobody connected")
    log.add(1001, 7, "connected")
    assert log.count == 1001
    assert [event.text for event in log.since(0)] == ["nobody connected", "connected"]


def test_events_that_were_lost_after_the_last_one_count() -> None:
    status = PortStatus()
    status.update({"event": [1, 0, "nobody connected"]})
    status.update({"stopped": status.counts, "events": 4})
    assert status.to_json(None)["link_event_count"] == 4


def test_events_of_the_opening_have_times_of_the_flight() -> None:
    """On a pty, that nobody is connected is known before the instant from which times count."""
    status = PortStatus()
    status.update({"event": [1, 5_000_000_000, "nobody connected"]})
    status.start_ns = 5_500_000_000
    status.update({"event": [2, 5_700_000_000, "connected"]})
    assert [(event.time_ns, event.text) for event in status.take_events()] == [
        (-500_000_000, "nobody connected"),
        (200_000_000, "connected"),
    ]
    assert status.take_events() == []
