"""Shots on their way, over a port that sends what it is told to and reports in order."""

from __future__ import annotations

from collections import deque

import lidar_emu
from lidar_emu.device.state import DeviceState
from lidar_emu.runtime.feed.packet_queue import PacketQueue
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.events import LinkEvent
from lidar_emu.runtime.port.pacing import Pace
from lidar_emu.runtime.port.packets import DeliveryStatus, Outgoing, Report
from lidar_emu.runtime.summary import Tally
from lidar_emu.session import Block, Session
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder


class Port:
    """A stand-in for `PortRunner`."""

    def __init__(self) -> None:
        self.pushed: deque[Outgoing] = deque()
        self.superseded: tuple[int, int] | None = None
        self.last_shot = -1
        self._reports: list[Report] = []

    def push(self, packet: Outgoing) -> bool:
        self.pushed.append(packet)
        return True

    def meet(self, count: int) -> None:
        """Deliver this many packets."""
        for _ in range(count):
            packet = self.pushed.popleft()
            old = self.superseded is not None and packet.generation < self.superseded[0]
            gone = (old and packet.shot >= self.superseded[1]) or packet.shot <= self.last_shot
            status = DeliveryStatus.SUPERSEDED if gone else DeliveryStatus.SENT
            if not gone:
                self.last_shot = packet.shot
            self._reports.append(
                Report(packet.shot, packet.due_ns, 1 if gone else packet.due_ns, status, packet.due_ns)
            )

    def supersede(self, generation: int, from_shot: int) -> None:
        self.superseded = generation, from_shot

    def reports(self) -> list[Report]:
        reports, self._reports = self._reports, []
        return reports

    def link_events(self) -> list[LinkEvent]:
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

    def on_report(self, packet: Outgoing, report: Report) -> None:
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


def post(session: Session, outbox: PacketQueue, shots: int) -> None:
    block = session.shoot(shots)
    assert block is not None
    for packet in outbox.announce(block):
        assert outbox.push(packet)


def test_blocks_settle_once_all_their_packets_have_met_their_fate() -> None:
    session, port, kept, tally, outbox = begun()
    post(session, outbox, 5)
    post(session, outbox, 5)
    port.meet(4)
    outbox.settle()
    assert (kept.shots, kept.reported, tally.range_error_m.count) == ([], [0, 1, 2, 3], 0)
    port.meet(3)
    outbox.settle()
    assert (kept.shots, tally.range_error_m.count) == ([0, 1, 2, 3, 4], 20)
    outbox.close()
    assert (kept.shots, tally.range_error_m.count) == ([0, 1, 2, 3, 4, 5, 6], 28)


def test_shots_that_a_command_changes_are_told_once_as_they_were_sent() -> None:
    session, port, kept, tally, outbox = begun()
    post(session, outbox, 5)
    post(session, outbox, 5)
    port.meet(2)
    outbox.settle()
    session.rewind(3)
    session.use_device(with_pattern(session, 1))
    outbox.supersede(3)
    post(session, outbox, 4)
    port.meet(len(port.pushed))
    outbox.close()
    assert kept.shots == kept.reported == list(range(7))
    assert kept.angles_deg == [22.5] * 3 + [7.5] * 4
    assert tally.sent == tally.due == 7
    assert tally.range_error_m.count == 28


def test_what_is_told_never_keeps_changed_shots_waiting() -> None:
    session, port, kept, _, outbox = begun()
    for _ in range(4):
        post(session, outbox, 10)
    port.meet(9)
    outbox.settle()
    assert kept.shots == list(range(8)), "a long block is told of in parts"
    port.meet(8)
    outbox.settle()
    assert kept.shots == list(range(10))
    session.rewind(18)
    outbox.supersede(18)
    post(session, outbox, 10)
    port.meet(1 + 22 + 1)
    outbox.settle()
    assert kept.shots == list(range(10)), "changed shots come first"
    for _ in range(5):
        post(session, outbox, 10)
    outbox.settle()
    assert kept.shots == list(range(18)), "and once they are ahead the others are made up for"


def test_going_back_computes_the_same_again() -> None:
    session, *_ = begun()
    whole = session.shoot(8)
    assert whole is not None
    for shot in (5, 0, 7, 3):
        session.rewind(shot)
        again = session.shoot(8 - shot)
        assert again is not None
        assert again.packets == whole.packets[shot:]


def test_a_packet_that_was_sent_before_the_port_heard_of_a_command_is_told_as_it_was_sent() -> None:
    session, port, kept, tally, outbox = begun()
    post(session, outbox, 5)
    port.meet(4)  # shot 3 goes out while the model is at it
    session.rewind(3)
    session.use_device(with_pattern(session, 1))
    outbox.supersede(3)
    post(session, outbox, 4)
    port.meet(len(port.pushed))
    outbox.close()
    assert kept.shots == kept.reported == list(range(7))
    assert kept.angles_deg == [22.5] * 4 + [7.5] * 3
    assert tally.due == 7
