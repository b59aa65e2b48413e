"""Pace and sender on a clock that costs no time."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.exchange import SharedRing
from lidar_emu.runtime.port.packets import (
    PACKET_HEAD_BYTES,
    Action,
    DeliveryReport,
    DeliveryStatus,
    OutgoingPacket,
    Pace,
    Pacing,
    WhenLate,
)
from lidar_emu.runtime.port.sender import Sender, Wait

START_NS = 5_000_000_000_000
SECOND_NS = 1_000_000_000


class VirtualClock(Clock):
    """Time passes by waiting alone."""

    def __init__(self) -> None:
        self.time_ns = START_NS - SECOND_NS

    def now_ns(self) -> int:
        return self.time_ns

    def wait(
        self,
        until_ns: int | None,
        readable: Sequence[int] = (),  # noqa: ARG002
        writable: Sequence[int] = (),  # noqa: ARG002
    ) -> tuple[list[int], list[int]]:
        assert until_ns is not None
        self.time_ns = max(self.time_ns, until_ns)
        return [], []


class Line:
    """Remembers what it took and when; refuses at chosen times."""

    def __init__(self) -> None:
        self.taken: list[tuple[int, bytes]] = []
        self.status = DeliveryStatus.SENT
        self.unread = 0
        self.notes: list[tuple[int, str]] = []
        self.busy: tuple[VirtualClock, int] | None = None

    def add_event(self, text: str, now_ns: int) -> None:
        self.notes.append((now_ns, text))

    def send_takes(self, clock: VirtualClock, duration_ns: int) -> None:
        self.busy = (clock, duration_ns)

    def send(self, payload: bytes, now_ns: int) -> DeliveryStatus:
        if self.status is DeliveryStatus.SENT:
            self.taken.append((now_ns, payload))
        if self.busy is not None:
            clock, duration_ns = self.busy
            clock.time_ns += duration_ns
        return self.status


class Rig:
    """A sender between two rings, a line and a virtual clock."""

    def __init__(
        self,
        pace: Pace,
        late_after_ns: int,
        slots: int = 4096,
        when_late: WhenLate = WhenLate.SKIP,
        poll_ns: int = 0,
    ) -> None:
        self.descriptors = [SharedRing.create(slots, 32), SharedRing.create(slots, DeliveryReport.SIZE_BYTES)]
        self.packets, self.reports = (SharedRing(descriptor) for descriptor in self.descriptors)
        self.line, self.clock = Line(), VirtualClock()
        self.sender = Sender(
            self.packets,
            self.reports,
            self.line,
            self.clock,
            START_NS,
            Pacing(pace, late_after_ns, when_late, poll_ns),
        )
        self.seen: list[DeliveryReport] = []

    def push(self, shot: int, due_ns: int) -> None:
        assert self.packets.push(OutgoingPacket(shot, due_ns, shot.to_bytes(4, "big")).to_bytes())

    def run_until_empty(self) -> None:
        while not (wait := self.sender.step()).for_packets:
            self.clock.wait(wait.until_ns)
        self.seen += self.fetch()

    def fetch(self) -> list[DeliveryReport]:
        entries = iter(self.reports.pop, None)
        return [DeliveryReport.from_bytes(entry) for entry in entries]

    def run_until(self, time_ns: int) -> None:
        while (until_ns := self.sender.step().until_ns) is not None and until_ns <= time_ns:
            self.clock.wait(until_ns)

    def close(self) -> None:
        self.packets.close()
        self.reports.close()
        for descriptor in self.descriptors:
            os.close(descriptor)


@pytest.fixture
def wall() -> Iterator[Rig]:
    rig = Rig(Pace.WALL, late_after_ns=SECOND_NS // 1111)
    yield rig
    rig.close()


@pytest.fixture
def full_speed() -> Iterator[Rig]:
    rig = Rig(Pace.MAX, late_after_ns=0)
    yield rig
    rig.close()


STEPS_OF_A_POLLED_LINE = st.lists(
    st.sampled_from(["shot", "silent shot", "poll", "poll", "line full", "line free", "stall"]), max_size=60
)


@given(STEPS_OF_A_POLLED_LINE)
def test_a_poll_sends_the_last_packet_that_was_due_once_and_each_is_reported_in_order(
    steps: list[str],
) -> None:
    rig = Rig(Pace.WALL, late_after_ns=SECOND_NS, poll_ns=10 * SECOND_NS)
    shot, waiting, expected = 0, None, dict[int, DeliveryStatus]()
    rig.clock.time_ns = START_NS
    for step in steps:
        if step == "poll":
            rig.sender.poll()
            rig.sender.step()
            if waiting is not None:
                expected[waiting] = rig.line.status
            waiting = None
        elif step.startswith("line"):
            rig.line.status = DeliveryStatus.SENT if step == "line free" else DeliveryStatus.DROPPED_FULL
        else:
            rig.clock.time_ns += 3 * SECOND_NS
            due_ns = rig.clock.time_ns - START_NS - (2 * SECOND_NS if step == "stall" else 0)
            payload = b"" if step == "silent shot" else shot.to_bytes(4, "big")
            assert rig.packets.push(OutgoingPacket(shot, due_ns, payload).to_bytes())
            rig.sender.step()
            if waiting is not None:
                expected[waiting] = DeliveryStatus.NOT_POLLED
            waiting = shot if step == "shot" else None
            if step != "shot":
                expected[shot] = DeliveryStatus.LATE if step == "stall" else DeliveryStatus.SUPPRESSED
            shot += 1
    rig.clock.time_ns += 10 * SECOND_NS
    rig.sender.step()
    if waiting is not None:
        expected[waiting] = DeliveryStatus.NOT_POLLED
    assert [(report.shot, report.status) for report in rig.fetch()] == list(expected.items())
    assert rig.sender.completed == shot
    taken = [int.from_bytes(payload, "big") for _, payload in rig.line.taken]
    assert taken == [number for number, status in expected.items() if status is DeliveryStatus.SENT]
    rig.close()


def test_a_packet_that_nobody_polls_is_given_up_after_its_time() -> None:
    rig = Rig(Pace.WALL, late_after_ns=SECOND_NS, poll_ns=2 * SECOND_NS)
    rig.clock.time_ns = START_NS
    rig.push(0, 0)
    wait = rig.sender.step()
    assert wait == Wait(START_NS + 2 * SECOND_NS, for_packets=True)
    assert rig.fetch() == []
    rig.push(1, 5 * SECOND_NS)
    assert rig.sender.step() == Wait(START_NS + 2 * SECOND_NS)
    rig.clock.wait(wait.until_ns)
    assert rig.sender.step() == Wait(START_NS + 5 * SECOND_NS)
    assert [report.status for report in rig.fetch()] == [DeliveryStatus.NOT_POLLED]
    rig.sender.poll()
    rig.sender.step()
    assert rig.line.taken == []
    rig.close()


def test_an_empty_packet_meets_its_fate_at_its_time_and_the_line_sees_nothing(wall: Rig) -> None:
    wall.push(0, 0)
    assert wall.packets.push(OutgoingPacket(1, 1000, b"").to_bytes())
    wall.push(2, 2000)
    wall.run_until_empty()
    assert [report.status for report in wall.seen] == [
        DeliveryStatus.SENT,
        DeliveryStatus.SUPPRESSED,
        DeliveryStatus.SENT,
    ]
    assert (wall.seen[1].sent_ns, wall.seen[1].woke_ns) == (-1, 1000)
    assert [int.from_bytes(payload, "big") for _, payload in wall.line.taken] == [0, 2]


def test_an_empty_packet_is_never_late() -> None:
    """Nor does it end a run that may have no late packet."""
    rig = Rig(Pace.WALL, late_after_ns=1000, when_late=WhenLate.ABORT)
    assert rig.packets.push(OutgoingPacket(0, 0, b"").to_bytes())
    rig.push(1, SECOND_NS)
    rig.clock.time_ns = START_NS + SECOND_NS // 2
    rig.run_until_empty()
    assert [report.status for report in rig.seen] == [DeliveryStatus.SUPPRESSED, DeliveryStatus.SENT]
    rig.close()


def test_a_stall_of_ten_seconds_is_skipped_without_a_burst(wall: Rig) -> None:
    period_ns = SECOND_NS // 1111
    stalls_at, wakes_ns = 500, 500 * period_ns + 10 * SECOND_NS
    shots = 15_000
    for first in range(0, shots, 500):
        if first == stalls_at:
            wall.clock.time_ns = START_NS + wakes_ns
        for shot in range(first, first + 500):
            wall.push(shot, shot * period_ns)
        wall.run_until_empty()
    # Late are those with due < wake - late_after; shot s is due at s * period.
    first_in_time = -(-(wakes_ns - period_ns) // period_ns)
    late = [report.shot for report in wall.seen if report.status is DeliveryStatus.LATE]
    assert late == list(range(stalls_at, first_in_time))
    assert all(report.sent_ns == -1 for report in wall.seen if report.status is DeliveryStatus.LATE)
    assert len(wall.line.taken) == shots - len(late)
    assert max(Counter(time_ns for time_ns, _ in wall.line.taken).values()) <= 2


def test_where_a_late_packet_ends_the_run_it_was_the_last_one() -> None:
    rig = Rig(Pace.WALL, late_after_ns=1000, when_late=WhenLate.ABORT)
    for shot in range(5):
        rig.push(shot, shot * SECOND_NS)
    rig.run_until(START_NS + SECOND_NS // 2)
    assert [report.status for report in rig.fetch()] == [DeliveryStatus.SENT]
    rig.clock.time_ns = START_NS + SECOND_NS + 1001
    rig.run_until_empty()
    assert rig.seen == [DeliveryReport(1, SECOND_NS, -1, DeliveryStatus.LATE, SECOND_NS + 1001)]
    assert [payload for _, payload in rig.line.taken] == [b"\0\0\0\0"]
    rig.close()


def test_reports_report_when_the_process_had_woken_up(wall: Rig) -> None:
    wall.push(0, SECOND_NS)
    wall.clock.time_ns = START_NS + SECOND_NS + 700
    wall.line.send_takes(wall.clock, 30)
    wall.run_until_empty()
    assert wall.seen == [DeliveryReport(0, SECOND_NS, SECOND_NS + 730, DeliveryStatus.SENT, SECOND_NS + 700)]


def test_a_shot_that_was_sent_before_its_command_came_is_not_sent_again(wall: Rig) -> None:
    """The model recomputes shots 2 to 4 while shot 2 goes out; the sender has no mark for the new generation yet."""
    for shot in range(3):
        wall.push(shot, shot * 1000)
    wall.run_until_empty()
    for shot in range(2, 5):
        packet = OutgoingPacket(shot, shot * 1000, b"new" + bytes([shot]), generation=1)
        assert wall.packets.push(packet.to_bytes())
    wall.run_until_empty()
    sent = [payload for _, payload in wall.line.taken]
    assert sent == [b"\0\0\0\0", b"\0\0\0\1", b"\0\0\0\2", b"new\3", b"new\4"]
    assert [(report.shot, report.status, report.packets) for report in wall.seen[3:]] == [
        (2, DeliveryStatus.SUPERSEDED, 1),
        (3, DeliveryStatus.SENT, 1),
        (4, DeliveryStatus.SENT, 1),
    ]
    assert wall.sender.completed == 6


def test_a_full_line_drops_the_new_packet_at_its_time(wall: Rig) -> None:
    wall.line.status = DeliveryStatus.DROPPED_FULL
    wall.push(0, 0)
    wall.run_until_empty()
    wall.line.status = DeliveryStatus.SENT
    wall.push(1, SECOND_NS)
    wall.run_until_empty()
    assert [report.status for report in wall.seen] == [DeliveryStatus.DROPPED_FULL, DeliveryStatus.SENT]
    assert [payload for _, payload in wall.line.taken] == [b"\0\0\0\1"]


def test_full_speed_waits_for_room_and_for_nothing_else(full_speed: Rig) -> None:
    for shot in range(10):
        full_speed.push(shot, shot * SECOND_NS)
    full_speed.line.status = DeliveryStatus.DROPPED_FULL
    wait = full_speed.sender.step()
    assert wait == Wait(full_speed.clock.time_ns + 5 * SECOND_NS, for_room=True)
    assert full_speed.reports.pop() is None
    full_speed.line.status = DeliveryStatus.SENT
    full_speed.run_until_empty()
    assert [report.shot for report in full_speed.seen] == list(range(10))
    assert full_speed.clock.time_ns < START_NS


@pytest.mark.parametrize("refusal", [DeliveryStatus.DROPPED_FULL, DeliveryStatus.DROPPED_NOBODY])
def test_full_speed_waits_half_a_minute_in_all_and_then_drops(
    full_speed: Rig, refusal: DeliveryStatus
) -> None:
    for shot in range(100):
        full_speed.push(shot, 0)
    full_speed.line.status = refusal
    began_ns = full_speed.clock.time_ns
    full_speed.run_until_empty()
    assert [report.status for report in full_speed.seen] == [refusal] * 100
    assert full_speed.clock.time_ns == began_ns + 30 * SECOND_NS
    assert full_speed.sender.sent_bytes == 0
    reported = [(began_ns + 5 * SECOND_NS, "the line has taken nothing for 5 s"),
            (began_ns + 30 * SECOND_NS, "the line has taken nothing for 30 s: packets are dropped")]  # fmt: skip
    assert full_speed.line.notes == (reported if refusal is DeliveryStatus.DROPPED_FULL else [])


def test_at_full_speed_what_goes_between_the_shots_waits_for_room_too(full_speed: Rig) -> None:
    full_speed.line.status = DeliveryStatus.DROPPED_FULL
    full_speed.push(0, 0)
    full_speed.sender.send_between(b"between")
    assert full_speed.sender.step().for_room
    full_speed.line.status = DeliveryStatus.SENT
    full_speed.sender.send_between(b"and again")
    full_speed.run_until_empty()
    assert [payload for _, payload in full_speed.line.taken] == [b"between", b"and again", bytes(4)]
    assert full_speed.sender.sent_bytes == len(b"betweenand again") + 4
    assert full_speed.sender.dropped_between == 0


def test_by_the_clock_what_goes_between_the_shots_is_dropped_where_there_is_no_room(wall: Rig) -> None:
    wall.line.status = DeliveryStatus.DROPPED_FULL
    wall.sender.send_between(b"between")
    assert not wall.sender.step().for_room
    assert wall.sender.dropped_between == 1
    wall.line.status = DeliveryStatus.SENT
    wall.run_until_empty()
    assert wall.line.taken == []
    wall.sender.send_between(b"later")
    wall.run_until_empty()
    ((sent_ns, _),) = wall.line.taken
    assert wall.sender.between_ns == [None, sent_ns]


def test_a_line_that_moves_again_is_borne_anew(full_speed: Rig) -> None:
    full_speed.line.status = DeliveryStatus.DROPPED_FULL
    full_speed.push(0, 0)
    full_speed.run_until_empty()
    full_speed.line.status = DeliveryStatus.SENT
    full_speed.push(1, 0)
    full_speed.run_until_empty()
    full_speed.line.status = DeliveryStatus.DROPPED_FULL
    full_speed.push(2, 0)
    assert full_speed.sender.step() == Wait(full_speed.clock.time_ns + 5 * SECOND_NS, for_room=True)
    assert len(full_speed.line.notes) == 2


def test_a_line_that_works_on_what_it_has_is_not_given_up(full_speed: Rig) -> None:
    full_speed.line.status, full_speed.line.unread = DeliveryStatus.DROPPED_FULL, 4096
    full_speed.push(0, 0)
    for _ in range(1000):
        assert full_speed.sender.step().for_room
        full_speed.clock.time_ns += 4 * SECOND_NS
        full_speed.line.unread -= 1
    assert full_speed.line.notes == []


def test_only_the_first_reader_is_waited_for(full_speed: Rig) -> None:
    full_speed.line.status = DeliveryStatus.DROPPED_NOBODY
    full_speed.push(0, 0)
    wait = full_speed.sender.step()
    assert wait.until_ns is not None
    assert not wait.for_room
    full_speed.line.status = DeliveryStatus.SENT
    full_speed.run_until_empty()
    full_speed.line.status = DeliveryStatus.DROPPED_NOBODY
    full_speed.push(1, 0)
    began_ns = full_speed.clock.time_ns
    full_speed.run_until_empty()
    assert [report.status for report in full_speed.seen] == [
        DeliveryStatus.SENT,
        DeliveryStatus.DROPPED_NOBODY,
    ]
    assert full_speed.clock.time_ns == began_ns


def test_by_the_clock_nobody_is_waited_for(wall: Rig) -> None:
    wall.line.status = DeliveryStatus.DROPPED_NOBODY
    wall.push(0, 0)
    wall.run_until_empty()
    assert (wall.clock.time_ns, len(wall.seen)) == (START_NS, 1)


def test_a_start_in_another_century_does_not_matter_at_full_speed(full_speed: Rig) -> None:
    full_speed.clock.time_ns = START_NS - 8000 * 365 * 86_400 * SECOND_NS
    full_speed.push(0, 0)
    full_speed.run_until_empty()
    assert [(report.status, report.sent_ns) for report in full_speed.seen] == [(DeliveryStatus.SENT, 0)]


def test_a_step_is_bounded(full_speed: Rig) -> None:
    for shot in range(1000):
        full_speed.push(shot, 0)
    assert full_speed.sender.step().until_ns == full_speed.clock.now_ns()
    assert 0 < len(full_speed.line.taken) < 1000


@given(st.integers(0, 10**18), st.integers(0, 10**18), st.integers(0, 10**12))
def test_the_rule_of_pace(now_ns: int, due_ns: int, late_after_ns: int) -> None:
    action = Pacing(Pace.WALL, late_after_ns).action(now_ns, due_ns)
    lateness_ns = now_ns - due_ns
    assert (action is Action.WAIT) == (lateness_ns < 0)
    assert (action is Action.SEND) == (0 <= lateness_ns <= late_after_ns)
    assert (action is Action.SKIP) == (lateness_ns > late_after_ns)
    assert Pacing(Pace.MAX, late_after_ns).action(now_ns, due_ns) is Action.SEND


@given(
    st.integers(0, 2**63 - 1),
    st.integers(-(2**63), 2**63 - 1),
    st.integers(-1, 2**63 - 1),
    st.sampled_from(DeliveryStatus),
    st.binary(),
    st.integers(-1, 2**63 - 1),
)
def test_packets_and_reports_survive_the_ring(
    shot: int, due_ns: int, sent_ns: int, status: DeliveryStatus, payload: bytes, woke_ns: int
) -> None:
    packet, report = (
        OutgoingPacket(shot, due_ns, payload),
        DeliveryReport(shot, due_ns, sent_ns, status, woke_ns),
    )
    assert OutgoingPacket.from_bytes(packet.to_bytes()) == packet
    assert DeliveryReport.from_bytes(report.to_bytes()) == report
    assert len(report.to_bytes()) == DeliveryReport.SIZE_BYTES
    assert len(packet.to_bytes()) == PACKET_HEAD_BYTES + len(payload)
