"""The sender: takes packets from the ring, and sends, retries, skips or drops each. Time comes from its clock alone."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.exchange import SharedRing
from lidar_emu.runtime.port.packets import (
    Action,
    DeliveryReport,
    DeliveryStatus,
    OutgoingPacket,
    Pace,
    Pacing,
    WhenLate,
)
from lidar_emu.transports.link import Link

_PACKETS_PER_STEP = 16


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
    """Moves each packet from the ring to the link, and its report to the ring of reports.

    The ring of reports must hold a report for every packet that the model process has not collected yet.
    """

    def __init__(
        self,
        packets: SharedRing,
        reports: SharedRing,
        link: Link,
        clock: Clock,
        start_ns: int,
        pacing: Pacing,
    ) -> None:
        self._packets, self._reports, self._link = packets, reports, link
        self._clock, self._start_ns, self._pacing = clock, start_ns, pacing
        self._backpressure = BackpressurePolicy(link)
        self._next: OutgoingPacket | None = None
        self._aborted = False
        self._superseded: list[tuple[int, int, int]] = []
        self._last_shot = -1
        self._between: deque[bytes | None] = deque()
        self._held: tuple[OutgoingPacket, int] | None = None
        self.sent_bytes = 0
        self.dropped_between = 0
        """Payloads between the shots that the line did not take."""
        self.between_ns: list[int | None] = []
        """Instants at which payloads between the shots were sent, None if one was not; the caller takes them."""
        self.completed = 0
        """Packets whose delivery status is final."""

    def step(self) -> Wait:
        """Process the packets that are due now, a bounded number at a time."""
        if (wait := self._send_between()) is not None:
            return wait
        if (given_up_ns := self._given_up_ns()) is not None and self._clock.now_ns() >= given_up_ns:
            self._give_up()
        for _ in range(_PACKETS_PER_STEP):
            if self._aborted:
                return Wait(for_packets=True)
            if self._next is None and (entry := self._packets.pop()) is not None:
                self._next = OutgoingPacket.from_bytes(entry)
            packet = self._next
            if packet is None:
                return Wait(self._given_up_ns(), for_packets=True)
            now_ns = self._clock.now_ns()
            if (count := self._superseded_from(packet)) > 0:
                self._give_up()
                report = DeliveryReport(packet.shot, packet.due_ns, count, DeliveryStatus.SUPERSEDED)
                self._report(report, count)
                self._next = None
                continue
            match self._pacing.action(now_ns - self._start_ns, packet.due_ns):
                case Action.WAIT:
                    due_ns = self._start_ns + packet.due_ns
                    return Wait(min(due_ns, self._given_up_ns() or due_ns))
                case _ if not packet.payload:  # a packet that is not sent cannot be late
                    self._give_up()
                    self._complete(packet, DeliveryStatus.SUPPRESSED, now_ns)
                case Action.SKIP:
                    self._give_up()
                    self._complete(packet, DeliveryStatus.LATE, now_ns)
                    self._aborted = self._pacing.when_late is WhenLate.ABORT
                case Action.SEND if self._pacing.poll_ns:
                    self._give_up()
                    self._held, self._last_shot = (packet, now_ns), packet.shot
                case Action.SEND:
                    status = self._link.send(packet.payload, now_ns)
                    if (wait := self._retry(status, now_ns)) is not None:
                        return wait
                    self._complete(packet, status, now_ns)
            self._next = None
        return Wait(until_ns=self._clock.now_ns())

    def send_between(self, payload: bytes) -> None:
        """Send a payload that is not a shot at the next step; there is no report."""
        self._between.append(payload)

    def poll(self) -> None:
        """Send the packet that waits for it at the next step, after the payloads between the shots."""
        self._between.append(None)

    def _given_up_ns(self) -> int | None:
        """When the packet that waits for a poll is given up; None: there is none."""
        if self._held is None:
            return None
        return self._start_ns + self._held[0].due_ns + self._pacing.poll_ns

    def _give_up(self) -> None:
        """Give up the packet that waits for a poll, if there is one."""
        if self._held is not None:
            packet, woke_ns = self._held
            self._held = None
            self._complete(packet, DeliveryStatus.NOT_POLLED, woke_ns)

    def _send_between(self) -> Wait | None:
        """Send or drop the payloads between the shots; what to wait for before the rest."""
        while self._between:
            now_ns = self._clock.now_ns()
            if (payload := self._between[0]) is None:
                self._between.popleft()
                if self._held is not None:
                    (packet, woke_ns), self._held = self._held, None
                    self._complete(packet, self._link.send(packet.payload, now_ns), woke_ns)
                continue
            status = self._link.send(payload, now_ns)
            if (wait := self._retry(status, now_ns)) is not None:
                return wait
            self._between.popleft()
            if status is DeliveryStatus.SENT:
                self.sent_bytes += len(payload)
                self.between_ns.append(self._clock.now_ns())
            else:
                self.dropped_between += 1
                self.between_ns.append(None)
        return None

    def supersede(self, generation: int, from_shot: int, end: int) -> None:
        """From shot `from_shot` on, stop sending packets of earlier generations; they lie before entry `end`."""
        self._superseded.append((generation, from_shot, end))

    def _superseded_from(self, packet: OutgoingPacket) -> int:
        """Number of packets, from this one on, that must not be sent; they leave the ring at once.

        A shot whose packet is complete already is not sent again: the command came too late for it.
        """
        if self._superseded:
            # A mark that is not newer than this packet affects no later packet either.
            self._superseded = [mark for mark in self._superseded if mark[0] > packet.generation]
            ends = [end for _, shot, end in self._superseded if packet.shot >= shot]
            if ends:
                return 1 + self._packets.skip_to(max(ends))
        return int(packet.shot <= self._last_shot)

    def _retry(self, status: DeliveryStatus, now_ns: int) -> Wait | None:
        if self._pacing.pace is Pace.WALL:
            return None
        until_ns = self._backpressure.retry_until(status, now_ns)
        return None if until_ns is None else Wait(until_ns, for_room=status is DeliveryStatus.DROPPED_FULL)

    def _complete(self, packet: OutgoingPacket, status: DeliveryStatus, woke_ns: int) -> None:
        sent_ns = -1
        if status is DeliveryStatus.SENT:
            # As fast as the link takes it, a packet may go out before the start, even centuries before it.
            sent_ns = max(0, self._clock.now_ns() - self._start_ns)
            self.sent_bytes += len(packet.payload)
        self._last_shot = packet.shot
        woke_ns = max(-1, woke_ns - self._start_ns)
        self._report(DeliveryReport(packet.shot, packet.due_ns, sent_ns, status, woke_ns), 1)

    def _report(self, report: DeliveryReport, count: int) -> None:
        if not self._reports.push(report.to_bytes()):
            raise RuntimeError("the ring of reports is too small")
        self.completed += count


_WARN_AFTER_NS = 5_000_000_000
_GIVE_UP_AFTER_NS = 30_000_000_000


class BackpressurePolicy:
    """Decides for each packet that the link refuses whether to retry or to drop it; see `Pace.MAX`.

    The time limits restart with every packet that the link takes, and whenever the other end has fetched something:
    a slow line may have no room for seconds and still make progress.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._was_connected = False
        self._stalled: tuple[DeliveryStatus, int] | None = None
        self._since_ns = 0
        self._warned_ns = 0

    def retry_until(self, status: DeliveryStatus, now_ns: int) -> int | None:
        """Instant until which to wait before the packet is tried again; None: the status is final.

        Args:
            status: delivery status of the last attempt.
            now_ns: instant of the monotonic clock.
        """
        is_full, no_reader = status is DeliveryStatus.DROPPED_FULL, status is DeliveryStatus.DROPPED_NOBODY
        self._was_connected |= is_full or status is DeliveryStatus.SENT
        if not (is_full or (no_reader and not self._was_connected)):
            self._stalled = None
            return None
        stalled = status, self._link.unread
        if stalled != self._stalled:
            self._stalled, self._since_ns, self._warned_ns = stalled, now_ns, 0
        stalled_ns = now_ns - self._since_ns
        if is_full:
            self._warn(stalled_ns, now_ns)
        if stalled_ns >= _GIVE_UP_AFTER_NS:
            return None
        return self._since_ns + (_WARN_AFTER_NS if stalled_ns < _WARN_AFTER_NS else _GIVE_UP_AFTER_NS)

    def _warn(self, stalled_ns: int, now_ns: int) -> None:
        for limit_ns, consequence in ((_WARN_AFTER_NS, ""), (_GIVE_UP_AFTER_NS, ": packets are dropped")):
            if self._warned_ns < limit_ns <= stalled_ns:
                self._warned_ns = limit_ns
                self._link.add_event(
                    f"the line has taken nothing for {limit_ns // 10**9} s{consequence}", now_ns
                )
