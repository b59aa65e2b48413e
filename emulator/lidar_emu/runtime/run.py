"""The model's side of the port process: start it, feed it, learn what became of each packet, end it."""

from __future__ import annotations

import os
import socket
from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.child import PortChild
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.events import EventLog, LinkEvent
from lidar_emu.runtime.pacing import Pace, WhenLate
from lidar_emu.runtime.packets import Outgoing, Report
from lidar_emu.runtime.ring import Ring
from lidar_emu.transports.serial_port import loopback_pair
from lidar_emu.transports.spec import Kind, PortSpec

_START_LIMIT_NS = 30_000_000_000
_STOP_LIMIT_NS = 2_000_000_000  # the process itself takes half a second for what is still unread
_POLL_NS = 2_000_000
_OPENING_POLL_NS = 100_000_000
_READ_BYTES = 65536


class PortRunner:
    """A port in a process of its own. Leaving its context ends the process, whatever happened.

    Order of use: `start`; `begin`, before or after the first `push`; `push` and `reports`; `finish`.

    Args:
        slots: packets that the ring holds: the longest look-ahead.
        packet_bytes: the longest packet.
    """

    def __init__(self, slots: int = 1024, packet_bytes: int = 4096) -> None:
        self._clock = Clock()
        self._child: PortChild | None = None
        packets_fd = Ring.create(slots, Outgoing.HEAD_BYTES + packet_bytes)
        # Reports are fetched before each push, so about `slots` can be waiting: twice that is never full.
        reports_fd = Ring.create(2 * slots, Report.SIZE_BYTES)
        self._packets = Ring(packets_fd)
        self._reports = Ring(reports_fd)
        self._fetched: deque[Report] = deque()
        doorbell_fd, self._doorbell = os.pipe()
        os.set_blocking(self._doorbell, False)
        self._passed = (packets_fd, reports_fd, doorbell_fd)
        self._far_end: socket.socket | None = None
        self._far_end_bytes = bytearray()
        self._events = EventLog()
        self._start_ns = 0
        self._begun = False
        self._finished = False
        self._closed = False
        self.description = ""
        """Name of the port; of a pty, the path that the host opens."""
        self.sent_bytes: int | None = None
        """Known after `finish` or `close`; None if the process died before it could tell."""
        self.received_bytes: int | None = None
        """What arrived on the port; known when `sent_bytes` is."""
        self.granted: list[str] = []
        """What the system gave towards punctuality; see `Punctuality`."""
        self.missing: dict[str, str] = {}
        """What it refused, each with the command that would give it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, spec: PortSpec) -> str:
        """Start the process and open the port; returns `description`.

        Raises:
            InputError: the port cannot be opened.
            RunError: the process did not start.
        """
        if spec.kind is Kind.LOOPBACK:
            device_end, self._far_end = loopback_pair()
            self._far_end.setblocking(False)
            with device_end:
                self._child = PortChild((*self._passed, device_end.fileno()))
        else:
            self._child = PortChild(self._passed)
        packets_fd, reports_fd, doorbell_fd, *loopback_fds = self._child.inherited
        self._child.tell(
            port=spec.to_json(),
            packets=packets_fd,
            reports=reports_fd,
            doorbell=doorbell_fd,
            loopback=next(iter(loopback_fds), None),
        )
        deadline_ns = self._clock.now_ns() + _START_LIMIT_NS
        while not self.description:
            if self._clock.now_ns() > deadline_ns:
                raise RunError(f"opening {spec} took more than {_START_LIMIT_NS // 10**9} s")
            self.wait(self._clock.now_ns() + _OPENING_POLL_NS)
        return self.description

    def begin(
        self, start_ns: int, late_after_ns: int, pace: Pace, when_late: WhenLate = WhenLate.SKIP
    ) -> None:
        """Say when the run starts.

        Args:
            start_ns: instant of `Clock.now_ns` from which `due_ns` counts.
            late_after_ns: packets later than this are skipped.
            pace: see `Pace`.
            when_late: see `WhenLate`.
        """
        self._start_ns, self._begun = start_ns, True
        begin = {"start_ns": start_ns, "late_after_ns": late_after_ns, "pace": pace, "when_late": when_late}
        self._running().tell(begin=begin)

    def push(self, packet: Outgoing) -> bool:
        """Hand over a packet, in the order of the due times; False if the ring is full (see `wait`).

        Raises:
            ValueError: the packet is longer than `packet_bytes`.
            RunError: the process died.
        """
        self._collect()
        if not self._packets.push(packet.to_bytes()):
            return False
        self._ring()
        return True

    def reports(self) -> list[Report]:
        """What became of packets since the last call, in the order of `push`; also after `close`.

        Raises:
            RunError: the process died.
        """
        if not self._closed:
            self._collect()
        fetched, self._fetched = list(self._fetched), deque()
        return fetched

    def far_end(self) -> bytes:
        """What the in-memory loopback delivered since the last call; also after `close`.

        It must be fetched as a host would read: an in-memory line can be full, too.
        """
        if not self._closed:
            self._collect()
        data, self._far_end_bytes = bytes(self._far_end_bytes), bytearray()
        return data

    @property
    def pid(self) -> int | None:
        """The port process; None before `start`."""
        return None if self._child is None else self._child.pid

    @property
    def events(self) -> list[LinkEvent]:
        """What happened to the link so far: of more than 20 events the first and the last ten."""
        return self._events.since(self._start_ns)

    @property
    def event_count(self) -> int:
        """How many events there were, with those that `events` leaves out."""
        return self._events.count

    def wait(self, until_ns: int, readable: Sequence[int] = ()) -> None:
        """Sleep until an instant of the monotonic clock, or until the process says something, the loopback delivers
        or one of the descriptors is ready.

        Raises:
            RunError: the process died.
        """
        descriptors = [self._running().descriptor, *readable]
        if self._far_end is not None:
            descriptors.append(self._far_end.fileno())
        self._clock.wait(until_ns, descriptors)
        self._collect()

    def last_packet_pushed(self) -> None:
        """No more packets will come: `finished` turns true once the process is through with them.

        Raises:
            RunError: the run has not begun, or the process died.
        """
        if not self._begun:
            raise RunError("the run has not begun")
        self._running().tell(finish=True)
        self._ring()

    @property
    def finished(self) -> bool:
        """Every packet was sent, skipped or dropped, and what was sent has left the line or, on a pty, was read;
        for that the other end has 2 s, and a serial line the time that its bit rate makes it take besides."""
        return self._finished

    def finish(self) -> None:
        """`last_packet_pushed`, and wait until `finished`.

        Raises:
            RunError: the run has not begun, or the process died.
        """
        self.last_packet_pushed()
        while not self._finished:
            self.wait(self._clock.now_ns() + _POLL_NS)

    def close(self) -> None:
        """End the process and give everything back; may be called again.

        In mid-run the other end still has half a second to fetch what counts as sent.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self._child is not None:
                self._stop(self._child)
            self._fetch()
        finally:
            self._packets.close()
            self._reports.close()
            for descriptor in (*self._passed, self._doorbell):
                os.close(descriptor)
            if self._far_end is not None:
                self._far_end.close()

    def _stop(self, child: PortChild) -> None:
        try:
            child.hang_up()
            deadline_ns = self._clock.now_ns() + _STOP_LIMIT_NS
            while not child.ended and self._clock.now_ns() < deadline_ns:
                self._clock.wait(self._clock.now_ns() + _POLL_NS, [child.descriptor])
                self._drain_far_end()
                self._understand(child.hear())
        finally:
            # It has ended, or it hangs in a driver.
            child.kill()

    def _collect(self) -> None:
        """Take everything that the process has for us.

        Raises:
            InputError: it could not open the port.
            RunError: it died.
        """
        child = self._running()
        self._fetch()
        self._understand(child.hear())
        if child.ended:
            raise child.death()

    def _fetch(self) -> None:
        while (entry := self._reports.pop()) is not None:
            self._fetched.append(Report.from_bytes(entry))
        self._drain_far_end()

    def _drain_far_end(self) -> None:
        if self._far_end is None:
            return
        try:
            while data := self._far_end.recv(_READ_BYTES):
                self._far_end_bytes += data
        except (BlockingIOError, ConnectionResetError):
            return

    def _understand(self, answers: list[dict[str, Any]]) -> None:
        for answer in answers:
            match answer:
                case {"refused": refusal}:
                    raise InputError(*refusal)
                case {"ready": description}:
                    self.description = description
                case {"granted": granted, "missing": missing}:
                    self.granted, self.missing = granted, missing
                case {"event": [number, time_ns, text]}:
                    self._events.add(number, time_ns, text)
                case {"finished": counts} | {"stopped": counts}:
                    self._finished = True
                    self.sent_bytes, self.received_bytes = counts["sent_bytes"], counts["received_bytes"]

    def _running(self) -> PortChild:
        if self._child is None or self._closed:
            raise RunError("the port is not open")
        return self._child

    def _ring(self) -> None:
        try:
            os.write(self._doorbell, b"\0")
        except BlockingIOError:
            return  # it has rung often enough to be heard
