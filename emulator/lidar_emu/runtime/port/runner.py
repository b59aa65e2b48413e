"""The model's side of the port process: start it, feed it, learn what became of each packet, end it."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.port.child import PortChild, complaints
from lidar_emu.runtime.port.events import LinkEvent
from lidar_emu.runtime.port.loopback import LoopbackEnd
from lidar_emu.runtime.port.pacing import Pace, WhenLate
from lidar_emu.runtime.port.packets import ALERT, NEWS, Outgoing, Report
from lidar_emu.runtime.port.ring import Ring
from lidar_emu.runtime.port.stall_monitor import Notice, Watch
from lidar_emu.runtime.port.status import Arrival, PortStatus
from lidar_emu.transports.spec import Kind, PortSpec

_START_LIMIT_NS = 30_000_000_000
_STOP_LIMIT_NS = 2_000_000_000  # the process itself takes half a second for what is still unread
_POLL_NS = 2_000_000
_OPENING_POLL_NS = 100_000_000


class PortRunner:
    """A port in a process of its own. Leaving its context ends the process, whatever happened; where that is an error
    of ours, after its final message (see `prepare`).

    Order of use: `start`; `begin`, before or after the first `push`; `push` and `reports`; `finish`.

    Args:
        slots: packets that the ring holds: the longest look-ahead.
        packet_bytes: the longest packet.
        notice: told when one of the two processes stood still; see `Watch`.
    """

    def __init__(self, slots: int = 1024, packet_bytes: int = 4096, notice: Notice | None = None) -> None:
        self._clock = Clock()
        self._watch = Watch(self._clock, notice)
        self._child: PortChild | None = None
        packets_fd = Ring.create(slots, Outgoing.HEAD_BYTES + packet_bytes)
        # Reports are fetched at least once in `slots` packets, and as many can be under way: twice that is never full.
        reports_fd = Ring.create(2 * slots, Report.SIZE_BYTES)
        self._packets = Ring(packets_fd)
        self._reports = Ring(reports_fd)
        self._fetched: deque[Report] = deque()
        self._slots, self._uncollected = slots, 0
        doorbell_fd, self._doorbell = os.pipe()
        os.set_blocking(self._doorbell, False)
        self._passed = {"packets": packets_fd, "reports": reports_fd, "doorbell": doorbell_fd}
        self._far_end: LoopbackEnd | None = None
        self._begun = False
        self._closed = False
        self.told = PortStatus()
        """What the process has said about itself, the port and the link."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(in_order=kind is None or issubclass(kind, InputError | KeyboardInterrupt))

    def start(self, spec: PortSpec, faults: list[dict[str, Any]] | None = None) -> str:
        """Start the process and open the port; returns its description.

        Args:
            spec: the port.
            faults: of the port, each a `PortFault` as a mapping; None: there are none, nor will be.

        Raises:
            InputError: the port cannot be opened.
            RunError: the process did not start.
        """
        passed = self._passed | complaints()
        if spec.kind is Kind.LOOPBACK:
            self._far_end = LoopbackEnd()
            with self._far_end.device_end as device_end:
                self._child = PortChild(passed | {"loopback": device_end.fileno()})
        else:
            self._child = PortChild(passed)
        self._child.tell(port=spec.to_json(), faults=faults, **self._child.inherited)
        deadline_ns = self._clock.now_ns() + _START_LIMIT_NS
        while not self.told.description:
            if self._clock.now_ns() > deadline_ns:
                raise RunError(f"opening {spec} took more than {_START_LIMIT_NS // 10**9} s")
            self.wait(self._clock.now_ns() + _OPENING_POLL_NS)
        self.told.start_ns = self._clock.now_ns()
        return self.told.description

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
        self.told.start_ns, self._begun = start_ns, True
        begin = {"start_ns": start_ns, "late_after_ns": late_after_ns, "pace": pace, "when_late": when_late}
        self._running().tell(begin=begin)
        if pace is Pace.WALL:
            self._watch.begin(start_ns)

    def push(self, packet: Outgoing) -> bool:
        """Hand over a packet, in the order of the due times; False if the ring is full (see `wait`).

        Raises:
            ValueError: the packet is longer than `packet_bytes`.
            PortDiedError: as `wait`.
        """
        self._running()
        self._uncollected += 1
        if self._uncollected >= self._slots:
            self._collect()
        if not self._packets.push(packet.to_bytes()):
            self._collect()
            return False
        self._watch.pushed(packet.due_ns)
        self._ring()
        return True

    def alert(self) -> None:
        """A packet that is due will be pushed within a millisecond: the process had better be awake by then."""
        self._ring(ALERT)

    def supersede(self, generation: int, from_shot: int) -> None:
        """Packets of earlier generations are not to be sent any more, from this shot on; they are reported as such."""
        self._running().tell(supersede=[generation, from_shot, self._packets.written])

    def send_now(self, payload: bytes) -> None:
        """Send what is no shot, between shots; there is no report."""
        self._running().tell(send=payload.hex())

    def prepare(self, final_message: bytes) -> None:
        """What the process is to send, instead of whatever it was given, should ours die; each time anew."""
        self._running().tell(final_message=final_message.hex())

    def order_fault(self, order: dict[str, Any]) -> None:
        """One more fault of the port, if there was a list of them at the start."""
        self._running().tell(fault=order)

    def arrivals(self) -> list[Arrival]:
        """What arrived on the port since the last call."""
        arrived, self.told.arrived = self.told.arrived, []
        return arrived

    def link_events(self) -> list[LinkEvent]:
        """What happened to the link since the last call; also after `close`."""
        happened, self.told.happened = self.told.happened, []
        return happened

    def reports(self) -> list[Report]:
        """What became of packets since the last call, in the order of `push`; also after `close`.

        Raises:
            PortDiedError: as `wait`.
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
        return b"" if self._far_end is None else self._far_end.take()

    @property
    def pid(self) -> int | None:
        """The port process; None before `start`."""
        return None if self._child is None else self._child.pid

    def wait(self, until_ns: int, readable: Sequence[int] = (), awake: bool = False) -> None:
        """Sleep, or stay awake, until an instant of the monotonic clock, or until the process says something, the
        loopback delivers or one of the descriptors is ready. Who stays awake is in a hurry: the process is heard later.

        Raises:
            PortDiedError: the process died. What it had reported before can still be fetched, after `close`.
        """
        descriptors = [*readable, self._running().descriptor]
        if self._far_end is not None:
            descriptors.append(self._far_end.fileno())
        ready, _ = self._clock.wait(until_ns, descriptors, awake=awake)
        if not (awake and set(readable).intersection(ready)):
            self._collect()

    def last_packet_pushed(self) -> None:
        """No more packets will come: `finished` turns true once the process is through with them.

        Raises:
            RunError: the run has not begun.
        """
        if not self._begun:
            raise RunError("the run has not begun")
        self._running().tell(finish=True)
        self._ring()

    @property
    def finished(self) -> bool:
        """Every packet was sent, skipped or dropped, and what was sent has left the line or, on a pty, was read;
        for that the other end has 2 s, and a serial line the time that its bit rate makes it take besides."""
        return self.told.finished

    def finish(self) -> None:
        """`last_packet_pushed`, and wait until `finished`.

        Raises:
            RunError: the run has not begun, or the process died.
        """
        self.last_packet_pushed()
        while not self.told.finished:
            self.wait(self._clock.now_ns() + _POLL_NS)

    def close(self, in_order: bool = True) -> None:
        """End the process and give everything back; may be called again.

        In mid-run the other end still has half a second to fetch what counts as sent.

        Args:
            in_order: False: the run fails, and the process says its final message.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self._child is not None:
                self._stop(self._child, in_order)
            self._fetch()
        finally:
            self._packets.close()
            self._reports.close()
            for descriptor in (*self._passed.values(), self._doorbell):
                os.close(descriptor)
            if self._far_end is not None:
                self._far_end.close()

    def _stop(self, child: PortChild, in_order: bool) -> None:
        try:
            child.hang_up(in_order)
            deadline_ns = self._clock.now_ns() + _STOP_LIMIT_NS
            while not child.ended and self._clock.now_ns() < deadline_ns:
                self._clock.wait(self._clock.now_ns() + _POLL_NS, [child.descriptor])
                self._drain()
                self.told.understand(child.hear())
        finally:
            # It has ended, or it hangs in a driver.
            child.kill()

    def _collect(self) -> None:
        """Take everything that the process has for us.

        Raises:
            InputError: it could not open the port.
            PortDiedError: it died.
        """
        child = self._running()
        self._fetch()
        self.told.understand(child.hear())
        if child.ended:
            raise child.death()
        self._watch.look()

    def _fetch(self) -> None:
        self._uncollected = 0
        while (entry := self._reports.pop()) is not None:
            self._fetched.append(report := Report.from_bytes(entry))
            self._watch.reported(report.packets)
        self._drain()

    def _drain(self) -> None:
        if self._far_end is not None:
            self._far_end.drain()

    def _running(self) -> PortChild:
        if self._child is None or self._closed:
            raise RunError("the port is not open")
        return self._child

    def _ring(self, what: bytes = NEWS) -> None:
        try:
            os.write(self._doorbell, what)
        except BlockingIOError:
            return  # it has rung often enough to be heard
