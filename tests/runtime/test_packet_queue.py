"""Shots on their way, over a port that sends every packet and reports in order."""

from __future__ import annotations

from collections import deque

import pytest

import lidar_emu
from lidar_emu.device.state import DeviceState
from lidar_emu.runtime.feed.base import PacketQueue
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace
from lidar_emu.runtime.port.status import LinkEvent
from lidar_emu.runtime.summary import Tally
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder


class Port:
    """A stand-in for `PortRunner`."""

    def __init__(self) -> None:
        self.pushed: deque[OutgoingPacket] = deque()
        self.superseded: tuple[int, int] | None = None
        self.last_shot = -1
        self._reports: list[DeliveryReport] = []

    def push(self, packet: OutgoingPacket) -> bool:
        self.pushed.append(packet)
        return True

    def deliver(self, count: int) -> None:
        """Deliver this many packets."""
        for _ in range(count):
            packet = self.pushed.popleft()
            old = self.superseded is not None and packet.generation < self.superseded[0]
            gone = (old and packet.shot >= self.superseded[1]) or packet.shot <= self.last_shot
            status = DeliveryStatus.SUPERSEDED if gone else DeliveryStatus.SENT
            if not gone:
                self.last_shot = packet.shot
            self._reports.append(
                DeliveryReport(
                    packet.shot, packet.due_ns, 1 if gone else packet.due_ns, status, packet.due_ns
                )
            )

    def supersede(self, generation: int, from_shot: int) -> None:
        self.superseded = generation, from_shot

    def reports(self) -> list[DeliveryReport]:
        reports, self._reports = self._reports, []
        return reports

    def take_link_events(self) -> list[LinkEvent]:
        return []

    def take_between_ns(self) -> list[int | None]:
        return []

    def far_end(self) -> bytes:
        return b""


class Kept(Observer):
    def __init__(self) -> None:
        self.shots: list[int] = []
        self.angles_deg: list[float] = []
        self.reported: list[int] = []

    def on_block_sent(self, block: Block) -> None:
        self.shots += block.measurement.shot.tolist()
        self.angles_deg += block.measurement.beam_angle_deg[:, 0].tolist()

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        assert packet.shot == report.shot
        self.reported.append(packet.shot)


def begun() -> tuple[Session, Port, Kept, Tally, PacketQueue]:
    scenario = lidar_emu.load("descent.yaml", {"level": "geometric"})
    session = Session(build_model(scenario), Encoder(scenario.wire, False, False, 4), 10)
    port, kept, tally = Port(), Kept(), Tally(Pace.WALL)
    return session, port, kept, tally, PacketQueue(port, [kept], tally, 100)  # type: ignore[arg-type]


def with_pattern(session: Session, number: int) -> DeviceState:
    settings = session.device.settings._replace(pattern=number)
    return session.device._replace(settings=settings)


def post(session: Session, queue: PacketQueue, shots: int) -> None:
    block = session.shoot(shots)
    assert block is not None
    for packet in queue.announce(block):
        assert queue.push(packet)


def test_blocks_settle_once_all_their_packets_have_met_their_fate() -> None:
    session, port, kept, tally, queue = begun()
    post(session, queue, 5)
    post(session, queue, 5)
    port.deliver(4)
    queue.collect_reports()
    assert (kept.shots, kept.reported, tally.range_error_m.count) == ([], [0, 1, 2, 3], 0)
    port.deliver(3)
    queue.collect_reports()
    assert (kept.shots, tally.range_error_m.count) == ([0, 1, 2, 3, 4], 20)
    queue.close()
    assert (kept.shots, tally.range_error_m.count) == ([0, 1, 2, 3, 4, 5, 6], 28)


@pytest.mark.parametrize("delivered", [2, 4], ids=["none of them", "one, before the port heard of it"])
def test_shots_that_a_command_changes_are_reported_once_as_they_were_sent(delivered: int) -> None:
    session, port, kept, tally, queue = begun()
    post(session, queue, 5)
    post(session, queue, 5)
    port.deliver(delivered)
    session.rewind(3)
    session.use_device(with_pattern(session, 1))
    queue.supersede(3)
    post(session, queue, 4)
    port.deliver(len(port.pushed))
    queue.close()
    assert kept.shots == kept.reported == list(range(7))
    as_before = max(delivered, 3)
    assert kept.angles_deg == [22.5] * as_before + [7.5] * (7 - as_before)
    assert tally.sent == tally.due == 7
    assert tally.range_error_m.count == 28


def test_what_is_reported_never_keeps_changed_shots_waiting() -> None:
    session, port, kept, _, queue = begun()
    for _ in range(4):
        post(session, queue, 10)
    port.deliver(9)
    queue.collect_reports()
    assert kept.shots == list(range(8)), "a long block is reported in parts"
    port.deliver(8)
    queue.collect_reports()
    assert kept.shots == list(range(10))
    session.rewind(18)
    queue.supersede(18)
    post(session, queue, 10)
    port.deliver(1 + 22 + 1)
    queue.collect_reports()
    assert kept.shots == list(range(10)), "changed shots come first"
    for _ in range(5):
        post(session, queue, 10)
    queue.collect_reports()
    assert kept.shots == list(range(18)), "and once they are ahead the others are made up for"


@pytest.mark.parametrize("delivered", [0, 1, 2])
def test_a_shot_that_was_never_computed_is_reported_after_the_shots_before_it(delivered: int) -> None:
    session, port, kept, tally, queue = begun()
    post(session, queue, 2)
    port.deliver(delivered)
    queue.missed(2, 2 * session.period_ns, 3 * session.period_ns)
    assert (kept.reported, tally.late) == ([], 0)
    session.skip_to(3)
    post(session, queue, 1)
    port.deliver(3 - delivered)
    queue.collect_reports()
    assert kept.reported == [0, 1, 2, 3]
    assert (tally.sent, tally.late) == (3, 1)


def test_it_is_not_reported_where_the_run_ends_before_it() -> None:
    """The port process died, or sends nothing after a late packet."""
    session, _, kept, tally, queue = begun()
    post(session, queue, 2)
    queue.missed(2, 2 * session.period_ns, 3 * session.period_ns)
    queue.close()
    assert (kept.reported, tally.due) == ([], 0)
