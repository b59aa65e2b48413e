"""Takes packets from the ring and sends, skips or drops each; knows no time but its clock's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.backpressure import BackpressurePolicy, BlockedLink
from lidar_emu.runtime.port.pacing import Action, Pace, Pacing, WhenLate
from lidar_emu.runtime.port.packets import DeliveryStatus, Outgoing, Report
from lidar_emu.runtime.port.ring import Ring

_PACKETS_PER_STEP = 16


class Sink(BlockedLink, Protocol):
    """Where packets go: a `Link`."""

    def send(self, payload: bytes, now_ns: int) -> DeliveryStatus:
        """Take the whole packet or drop it."""


@dataclass(frozen=True)
class Wait:
    """What the sender waits for."""

    until_ns: int | None = None
    """An instant of the monotonic clock."""
    for_packets: bool = False
    """The ring is empty."""
    for_room: bool = False
    """The line is full, and the pace is the link's."""


class Sender:
    """The way of each packet from the ring to its report.

    The ring of reports must hold all packets of which the other process has not yet fetched a report.
    """

    def __init__(
        self, packets: Ring, reports: Ring, link: Sink, clock: Clock, start_ns: int, pacing: Pacing
    ) -> None:
        self._packets = packets
        self._reports = reports
        self._link = link
        self._clock = clock
        self._start_ns = start_ns
        self._pacing = pacing
        self._patience = BackpressurePolicy(link)
        self._next: Outgoing | None = None
        self._given_up = False
        self._superseded: list[tuple[int, int, int]] = []
        self._last_shot = -1
        self.sent_bytes = 0
        self.settled = 0
        """Packets whose delivery status is known."""

    def step(self) -> Wait:
        """Do what is due now, a bounded part of it at a time."""
        for _ in range(_PACKETS_PER_STEP):
            if self._given_up:
                return Wait(for_packets=True)
            packet = self._take()
            if packet is None:
                return Wait(for_packets=True)
            now_ns = self._clock.now_ns()
            if (count := self._superseded_from(packet)) > 0:
                self._report(Report(packet.shot, packet.due_ns, count, DeliveryStatus.SUPERSEDED), count)
                continue
            match self._pacing.action(now_ns - self._start_ns, packet.due_ns):
                case Action.WAIT:
                    return Wait(until_ns=self._start_ns + packet.due_ns)
                case _ if not packet.payload:  # what is not sent is not late either
                    self._finish(packet, DeliveryStatus.SUPPRESSED, now_ns)
                case Action.SKIP:
                    self._finish(packet, DeliveryStatus.LATE, now_ns)
                    self._given_up = self._pacing.when_late is WhenLate.ABORT
                case Action.SEND:
                    status = self._link.send(packet.payload, now_ns)
                    until_ns = self._patience_ends_ns(status, now_ns)
                    if until_ns is not None:
                        return Wait(until_ns, for_room=status is DeliveryStatus.DROPPED_FULL)
                    self._finish(packet, status, now_ns)
        return Wait(until_ns=self._clock.now_ns())

    def supersede(self, generation: int, from_shot: int, end: int) -> None:
        """Packets of earlier generations are not sent any more, from this shot on; they lie before entry `end`."""
        self._superseded.append((generation, from_shot, end))

    def _superseded_from(self, packet: Outgoing) -> int:
        """How many packets from this one on are not to be sent; they leave the ring at once.

        A shot whose delivery status is known already is also passed over: news of the command came too late for it.
        """
        if self._superseded:
            # Those that no packet is older than any more concern nobody.
            self._superseded = [mark for mark in self._superseded if mark[0] > packet.generation]
            ends = [end for _, shot, end in self._superseded if packet.shot >= shot]
            if ends:
                return 1 + self._packets.skip_to(max(ends))
        return int(packet.shot <= self._last_shot)

    def _patience_ends_ns(self, status: DeliveryStatus, now_ns: int) -> int | None:
        """Until when the packet is kept; None: its delivery status is final."""
        return self._patience.wait_until(status, now_ns) if self._pacing.pace is not Pace.WALL else None

    def _take(self) -> Outgoing | None:
        if self._next is None:
            entry = self._packets.pop()
            self._next = None if entry is None else Outgoing.from_bytes(entry)
        return self._next

    def _finish(self, packet: Outgoing, status: DeliveryStatus, woke_ns: int) -> None:
        sent_ns = -1
        if status is DeliveryStatus.SENT:
            # As fast as the link takes it, a packet may go out before the start, even centuries before it.
            sent_ns = max(0, self._clock.now_ns() - self._start_ns)
            self.sent_bytes += len(packet.payload)
        self._last_shot = packet.shot
        self._report(
            Report(packet.shot, packet.due_ns, sent_ns, status, max(-1, woke_ns - self._start_ns)), 1
        )

    def _report(self, report: Report, count: int) -> None:
        self._next = None
        if not self._reports.push(report.to_bytes()):
            raise RuntimeError("the ring of reports is too small")
        self.settled += count
