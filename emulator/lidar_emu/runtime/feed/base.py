"""Base class of all feeds: passes packets to the port, and changes to the session."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

from lidar_emu.runtime.change_queue import ChangeQueue
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, payload_of
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.run_status import POLL_NS, RunStatus
from lidar_emu.runtime.summary import Tally
from lidar_emu.session import Block, Session

_SHOTS_PER_PART = 8
"""Shots passed to observers at a time: a recorder takes milliseconds for them."""
_AHEAD = 64
"""Recomputed shots are no longer urgent once this many packets, or half of the room, are in the ring."""
_DEFERRED_PARTS = 32


class PacketQueue:
    """Packets between their announcement and their report.

    Args:
        port: sends them.
        observers: called in the loop of the run: they must be quick.
        tally: counts them.
        room: packets that may be on their way at a time. The port must hold twice as many, for superseded packets stay
            in its ring until the ones before them are sent.
    """

    def __init__(self, port: PortRunner, observers: Sequence[Observer], tally: Tally, room: int) -> None:
        self.port = port
        """Sends the packets."""
        self._observers = observers
        self._tally = tally
        self._announced: dict[tuple[int, int], tuple[Block, int]] = {}
        self._in_flight: deque[tuple[OutgoingPacket, Block, int]] = deque()
        self._missed: deque[DeliveryReport] = deque()
        self._open_part: tuple[Block, int, int] | None = None
        self._finished_parts: deque[Block] = deque()
        self._is_urgent = False
        self._generation = 0
        self._room = self._left = room

    def announce(self, block: Block) -> list[OutgoingPacket]:
        """Announce shots just computed; return their packets, which are to be pushed in this order."""
        for observer in self._observers:
            observer.on_block_computed(block)
        packets = list(outgoing_packets(block, self._generation))
        for row, packet in enumerate(packets):
            self._announced[packet.generation, packet.shot] = block, row
        return packets

    def push(self, packet: OutgoingPacket) -> bool:
        """Hand a packet to the port; False if there is no room before the port has sent some."""
        if self._left <= 0 or not self.port.push(packet):
            return False
        self._left -= 1
        self._is_urgent = self._is_urgent and self._room - self._left < min(_AHEAD, self._room // 2)
        self._in_flight.append((packet, *self._announced.pop((packet.generation, packet.shot))))
        return True

    def supersede(self, from_shot: int) -> None:
        """Withdraw the announced packets from this shot on: the shots will be announced again.

        A packet that the port has sent already stays sent, and its successor is not sent.
        """
        self._generation += 1
        self._is_urgent = True
        self.port.supersede(self._generation, from_shot)
        for observer in self._observers:
            observer.on_superseded(self._generation, from_shot)
        self._left = self._room - sum(packet.shot < from_shot for packet, _, _ in self._in_flight)
        self._announced = {key: value for key, value in self._announced.items() if key[1] < from_shot}

    def collect_reports(self) -> list[DeliveryReport]:
        """Count the reported packets, pass events and far-end data to the observers; return the reports.

        While recomputed shots are urgent, observers receive the blocks later.
        """
        reports = list[DeliveryReport]()
        for report in self.port.reports():
            if report.status is DeliveryStatus.SUPERSEDED:
                for _ in range(report.packets):
                    self._in_flight.popleft()
                reports.append(report)
                continue
            packet, block, row = self._in_flight.popleft()
            self._left = min(self._room, self._left + 1)
            if report.status is DeliveryStatus.SUPPRESSED and packet.shot in block.held:
                report = replace(report, status=DeliveryStatus.HELD)
            reports.append(report)
            self._tally.add_report(report, block.silent)
            for observer in self._observers:
                observer.on_report(packet, report)
            self._add_to_part(block, row)
            self._report_missed()
        for event in self.port.take_link_events():
            for observer in self._observers:
                observer.on_event("link", event.time_ns, event.text)
        for between_ns in self.port.take_between_ns():
            for observer in self._observers:
                observer.on_sent_between(between_ns)
        if data := self.port.far_end():
            for observer in self._observers:
                observer.on_far_end_data(data)
        if not self._is_urgent or len(self._finished_parts) > _DEFERRED_PARTS:
            self._pass_parts_on()
        return reports

    def close(self) -> None:
        """After the last report: pass on the shots of a block that was cut off."""
        self.collect_reports()
        self._finish_part()
        self._pass_parts_on()

    def missed(self, shot: int, due_ns: int, now_ns: int) -> None:
        """Count a shot that was too late to be computed, unless the run ends before it; times from its start."""
        self._missed.append(DeliveryReport(shot, due_ns, -1, DeliveryStatus.LATE, now_ns))
        self._report_missed()

    def _report_missed(self) -> None:
        """Report missed shots, each after the packets before it: observers count on the order of the shots."""
        while self._missed and not (self._in_flight and self._in_flight[0][0].shot < self._missed[0].shot):
            report = self._missed.popleft()
            self._tally.add_report(report)
            for observer in self._observers:
                observer.on_report(OutgoingPacket(report.shot, report.due_ns, b""), report)

    @property
    def empty(self) -> bool:
        """Whether the delivery status of every packet is known."""
        return not self._in_flight

    def _add_to_part(self, block: Block, row: int) -> None:
        """Add a shot to the part that observers receive next: of a superseded block, only shots that were sent."""
        if self._open_part is None or self._open_part[0] is not block:
            self._finish_part()
            self._open_part = block, row, row
        first = self._open_part[1]
        self._open_part = block, first, row + 1
        if row + 1 in (len(block.packets), first + _SHOTS_PER_PART):
            self._finish_part()

    def _finish_part(self) -> None:
        if self._open_part is not None:
            self._finished_parts.append(self._open_part[0].part(*self._open_part[1:]))
            self._open_part = None

    def _pass_parts_on(self) -> None:
        while self._finished_parts:
            part = self._finished_parts.popleft()
            self._tally.add_measurement(part.measurement)
            self._tally.faults.update(fault.kind for fault in part.faults)
            for observer in self._observers:
                observer.on_block_sent(part)


def outgoing_packets(block: Block, generation: int = 0) -> Iterator[OutgoingPacket]:
    """The packets of shots, as the port process takes them."""
    shots = block.measurement.shot.tolist()
    for shot, due_ns, packet in zip(shots, block.due_ns, block.packets, strict=True):
        yield OutgoingPacket(shot, due_ns, payload_of(packet), generation)


class Feed(ABC):
    """Where the shots of a run come from.

    Args:
        status: beginning and end of the run.
        session: computes the shots.
        packets: packets on their way through the port.
        changes: commands and injected faults to apply to upcoming shots.
    """

    def __init__(
        self, status: RunStatus, session: Session, packets: PacketQueue, changes: ChangeQueue
    ) -> None:
        self._status, self._clock = status, status.clock
        self._session, self._changes = session, changes
        self._packets, self._port = packets, packets.port

    @abstractmethod
    def run(self) -> None:
        """Feed the port until the end of the flight, or until the run is stopped."""

    def _push(self, packet: OutgoingPacket) -> None:
        while not self._packets.push(packet):
            self._wait_for_reports()
            if self._status.stopped:
                return

    def _wait_for_reports(self) -> list[DeliveryReport]:
        self._port.wait(self._clock.now_ns() + POLL_NS)
        return self._packets.collect_reports()

    def _finish(self) -> None:
        if not self._status.stopped:
            self._port.end_packets()
        while not (self._port.finished or self._status.stopped):
            self._wait_for_reports()
