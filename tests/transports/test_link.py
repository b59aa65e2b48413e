"""A link that breaks and comes back, on times that the test chooses."""

from __future__ import annotations

from collections import Counter

import pytest

from lidar_emu.errors import InputError
from lidar_emu.transports.link import (
    DeliveryStatus,
    DriverFeatures,
    HostAbsentError,
    Link,
    LinkDiagnostics,
    LinkLostError,
    PortChannel,
)

MS = 1_000_000


class Cable:
    """A port on the test's side: what it can do at the moment, and what happened to it."""

    def __init__(self) -> None:
        self.plugged = True
        self.working = True
        self.somebody = True
        self.room = True
        self.attempts = 0
        self.carried: list[bytes] = []
        self.noticed = LinkDiagnostics()

    def open(self) -> Plug:
        self.attempts += 1
        if not self.plugged:
            raise InputError("--port", None, "cable", "there is no such port")
        return Plug(self)


class Plug(PortChannel):
    """The channel of a `Cable`."""

    driver_features = DriverFeatures(("low_latency",))
    readable: int | None = 7
    writable: int | None = 7

    def __init__(self, cable: Cable) -> None:
        super().__init__("cable")
        self._cable = cable

    def _check(self) -> None:
        if not (self._cable.plugged and self._cable.working):
            raise LinkLostError("pulled")

    def connected(self) -> bool:
        return self._cable.somebody

    def send(self, payload: bytes) -> bool:
        self._check()
        taken = self._cable.room and self._cable.somebody
        if taken:
            self._cable.carried.append(payload)
        return taken

    def receive(self) -> bytes:
        self._check()
        return b"hello"

    def take_diagnostics(self) -> LinkDiagnostics:
        return self._cable.noticed

    def unread(self) -> int:
        return 3


def texts(link: Link) -> list[tuple[int, str]]:
    return [(time_ns // MS, text) for time_ns, text in link.take_events()]


def test_a_pulled_cable_is_reported_once_and_opened_again_with_back_off() -> None:
    cable = Cable()
    link = Link(cable.open)
    assert link.send(b"a", 0) is DeliveryStatus.SENT
    cable.plugged = False
    assert [link.send(b"b", 10 * MS), link.send(b"c", 20 * MS)] == [DeliveryStatus.DROPPED_BROKEN] * 2
    attempts_at_ms = []
    for now_ms in range(20, 8000):
        before = cable.attempts
        link.service(now_ms * MS)
        if cable.attempts > before:
            attempts_at_ms.append(now_ms)
    assert attempts_at_ms == [110, 310, 710, 1510, 3110, 5110, 7110]
    assert link.wake_ns(8000 * MS, needs_room=False) == 9110 * MS
    cable.plugged = True
    link.service(9110 * MS)
    assert link.send(b"d", 9120 * MS) is DeliveryStatus.SENT
    assert cable.carried == [b"a", b"d"]
    assert texts(link) == [(10, "link broken: pulled"), (9110, "reopened")]


def test_a_port_that_opens_but_fails_at_once_is_left_in_peace() -> None:
    cable = Cable()
    link = Link(cable.open)
    cable.working = False
    for now_ms in range(10_000):
        link.service(now_ms * MS)
        link.send(b"", now_ms * MS)
    assert cable.attempts < 10


def test_a_break_seen_while_reading_counts_as_well() -> None:
    cable = Cable()
    link = Link(cable.open)
    assert link.receive(0) == b"hello"
    cable.plugged = False
    assert link.receive(5 * MS) == b""
    assert link.readable == link.writable == []
    assert texts(link) == [(5, "link broken: pulled")]


def test_nobody_connected_is_reported_when_it_changes() -> None:
    cable = Cable()
    link = Link(cable.open)
    assert link.send(b"w", 0) is DeliveryStatus.SENT
    cable.somebody = False
    link.service(0)
    statuses = [link.send(b"x", now_ms * MS) for now_ms in range(3)]
    assert statuses == [DeliveryStatus.DROPPED_NOBODY] * 3
    assert (link.readable, link.unread) == ([], 0)
    # The descriptor of a pty without a reader is always readable: it must be looked at by time.
    assert link.wake_ns(3 * MS, needs_room=False) is not None
    cable.somebody = True
    assert link.send(b"y", 4 * MS) is DeliveryStatus.SENT
    assert (link.readable, link.unread) == ([7], 3)
    assert texts(link) == [(0, "nobody connected"), (4, "connected")]
    assert texts(link) == []


def test_what_others_know_about_the_link_is_reported_in_its_turn() -> None:
    cable = Cable()
    link = Link(cable.open)
    link.add_event("slow", 3 * MS)
    cable.plugged = False
    link.send(b"x", 4 * MS)
    assert texts(link) == [(3, "slow"), (4, "link broken: pulled")]


def test_what_the_channel_noticed_is_reported_and_added_up_before_a_break_and_after() -> None:
    cable = Cable()
    link = Link(cable.open)
    cable.noticed = LinkDiagnostics(["error passive"], Counter(error_frames=2))
    link.receive(1 * MS)
    cable.plugged = False
    cable.noticed = LinkDiagnostics(counts=Counter(error_frames=1, lost_frames=5))
    link.receive(2 * MS)
    assert texts(link) == [(1, "error passive"), (2, "link broken: pulled")]
    assert link.counts == {"error_frames": 3, "lost_frames": 5}


def test_a_host_that_does_not_listen_yet_is_called_again_until_it_does() -> None:
    cable = Cable()

    def open_channel() -> Plug:
        if not cable.somebody:
            raise HostAbsentError("--port", None, "cable", "connection refused")
        return cable.open()

    cable.somebody = False
    with pytest.raises(HostAbsentError):
        Link(open_channel)
    link = Link(open_channel, absent="cable")
    assert (link.description, link.connected) == ("cable", False)
    link.service(0)
    cable.somebody = True
    link.service(50 * MS)
    assert not link.connected, "the first call was at 0, the next one follows after 100 ms"
    link.service(100 * MS)
    assert link.connected
    assert link.take_events() == [(100 * MS, "connected")]
    assert link.send(b"packet", 101 * MS) is DeliveryStatus.SENT


def test_a_port_that_cannot_be_opened_is_refused_whoever_is_absent() -> None:
    cable = Cable()
    cable.plugged = False
    with pytest.raises(InputError, match="no such port"):
        Link(cable.open, absent="cable")
