"""Shots on their way through the port: handed over in order, counted and shown once their delivery status is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import DeliveryStatus, Outgoing, Report
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.port.status import Arrival
from lidar_emu.runtime.summary import Tally
from lidar_emu.session import Block
from lidar_emu.transports.frames import Frame, pack_frames
from lidar_emu.wire import Packet

_TOLD_AT_ONCE = 8
"""Shots: a recorder is busy with as many for milliseconds."""
_AHEAD = 64
"""Packets in the port's hands, or half of the room, with which shots that a command changed are no longer urgent."""
_PUT_OFF_AT_MOST = 32
"""Parts of blocks."""


class PacketQueue:
    """Between whoever computes shots and the port's process.

    Args:
        observers: told of everything: they must be quick.
        room: packets that may be on their way at a time. The port must hold twice as many, for those that commands have
            superseded stay in its ring until the ones before them are sent.
    """

    def __init__(self, port: PortRunner, observers: Sequence[Observer], tally: Tally, room: int) -> None:
        self._port = port
        self._observers = observers
        self._tally = tally
        self._announced: dict[tuple[int, int], tuple[Block, int]] = {}
        self._in_flight: deque[tuple[Outgoing, Block, int]] = deque()
        self._settling: tuple[Block, int, int] | None = None
        self._settled: deque[Block] = deque()
        self._is_urgent = False
        self._generation = 0
        self._room = self._left = room

    def announce(self, block: Block) -> list[Outgoing]:
        """Tell of shots just computed; returns their packets, which are to be pushed in this order."""
        for observer in self._observers:
            observer.on_block_computed(block)
        packets = list(outgoing(block, self._generation))
        for row, packet in enumerate(packets):
            self._announced[packet.generation, packet.shot] = block, row
        return packets

    def push(self, packet: Outgoing) -> bool:
        """Hand a packet over; False where there is no room before the port has sent some."""
        if self._left <= 0 or not self._port.push(packet):
            return False
        self._left -= 1
        self._is_urgent = self._is_urgent and self._room - self._left < min(_AHEAD, self._room // 2)
        self._in_flight.append((packet, *self._announced.pop((packet.generation, packet.shot))))
        return True

    def alert(self) -> None:
        """A packet that is due will be pushed at once, see `PortRunner.alert`."""
        self._port.alert()

    def supersede(self, from_shot: int) -> None:
        """From this shot on, what was announced is not to be sent: shots from there on will be announced anew.

        A packet that the port has sent before it hears of it stays sent, and that of the new announcement is not.
        """
        self._generation += 1
        self._is_urgent = True
        self._port.supersede(self._generation, from_shot)
        for observer in self._observers:
            observer.on_superseded(self._generation, from_shot)
        self._left = self._room - sum(packet.shot < from_shot for packet, _, _ in self._in_flight)
        self._announced = {key: value for key, value in self._announced.items() if key[1] < from_shot}

    def send_now(self, payload: bytes) -> None:
        """Send what is no shot."""
        self._port.send_now(payload)

    def settle(self) -> list[Report]:
        """Count what became of packets and pass on what arrived; returns the packets' reports.

        While shots that a command has changed are urgent, observers hear of settled ones later.
        """
        reports = self._port.reports()
        for report in reports:
            if report.status is DeliveryStatus.SUPERSEDED:
                for _ in range(report.packets):
                    self._in_flight.popleft()
                continue
            packet, block, row = self._in_flight.popleft()
            self._left = min(self._room, self._left + 1)
            self._tally.report(report, block.silent)
            for observer in self._observers:
                observer.on_report(packet, report)
            self._met_fate(block, row)
        for event in self._port.link_events():
            for observer in self._observers:
                observer.on_link_event(event.time_ns, event.text)
        if data := self._port.far_end():
            for observer in self._observers:
                observer.on_far_end_data(data)
        if not self._is_urgent or len(self._settled) > _PUT_OFF_AT_MOST:
            self._tell_settled()
        return reports

    def close(self) -> None:
        """After the last report: the shots of a block that was cut off."""
        self.settle()
        self._part_settled()
        self._tell_settled()

    def missed(self, shot: int, due_ns: int, now_ns: int) -> None:
        """Count a shot that was too late to be computed; times from the start of the run."""
        self._tally.missed()
        report = Report(shot, due_ns, -1, DeliveryStatus.LATE, now_ns)
        for observer in self._observers:
            observer.on_report(Outgoing(shot, due_ns, b""), report)

    @property
    def empty(self) -> bool:
        """Whether the delivery status of every packet is known."""
        return not self._in_flight

    @property
    def through(self) -> bool:
        """Whether the port is through with the last packet, see `PortRunner.finished`."""
        return self._port.finished

    def wait(self, until_ns: int, readable: Sequence[int] = (), awake: bool = False) -> None:
        """Sleep, or wait `awake`, until an instant of the monotonic clock, or until the port or one of the descriptors
        has news."""
        self._port.wait(until_ns, readable, awake)

    def arrivals(self) -> list[Arrival]:
        """What arrived on the port since the last call."""
        return self._port.arrivals()

    def last_packet_pushed(self) -> None:
        """No more will come."""
        self._port.last_packet_pushed()

    def _met_fate(self, block: Block, row: int) -> None:
        """Shots are told of a few at a time; of a block that a command cut, those that were sent."""
        if self._settling is None or self._settling[0] is not block:
            self._part_settled()
            self._settling = block, row, row
        first = self._settling[1]
        self._settling = block, first, row + 1
        if row + 1 in (len(block.packets), first + _TOLD_AT_ONCE):
            self._part_settled()

    def _part_settled(self) -> None:
        if self._settling is not None:
            self._settled.append(self._settling[0].part(*self._settling[1:]))
            self._settling = None

    def _tell_settled(self) -> None:
        while self._settled:
            part = self._settled.popleft()
            self._tally.measured(part.measurement)
            self._tally.faults.update(fault.kind for fault in part.faults)
            for observer in self._observers:
                observer.on_block_sent(part)


def outgoing(block: Block, generation: int = 0) -> Iterator[Outgoing]:
    """The packets of shots, as the port's process takes them."""
    shots = block.measurement.shot.tolist()
    for shot, due_ns, packet in zip(shots, block.due_ns, block.packets, strict=True):
        yield Outgoing(shot, due_ns, payload_of(packet), generation)


def payload_of(packet: Packet) -> bytes:
    """A packet as the port process takes it."""
    if isinstance(packet, bytes):
        return packet
    return pack_frames([Frame(f.can_id, f.data, f.is_fd, f.bitrate_switch) for f in packet])
