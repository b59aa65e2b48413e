"""The model's side of the port process: start it, hand it packets, collect reports and received bytes, end it."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from lidar_emu.errors import InputError, RunError
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.port.child import OnStall, PortChild, StallMonitor, standard_error
from lidar_emu.runtime.port.exchange import SharedRing
from lidar_emu.runtime.port.packets import (
    CHANGED,
    PACKET_HEAD_BYTES,
    WAKE_UP,
    DeliveryReport,
    OutgoingPacket,
    Pace,
    ReceivedBytes,
    WhenLate,
)
from lidar_emu.runtime.port.status import LinkEvent, PortStatus
from lidar_emu.transports.pseudo_terminal import unlink_stale
from lidar_emu.transports.pulses import Firing
from lidar_emu.transports.serial_port import loopback_pair
from lidar_emu.transports.spec import Kind, PortSpec

_READ_BYTES = 65536


class LoopbackEnd:
    """The other end of the line. It must be read: an in-memory line can be full, too."""

    def __init__(self) -> None:
        self.device_end, self._socket = loopback_pair()
        """The end of the device; the caller closes it once the child has inherited it."""
        self._socket.setblocking(False)
        self._data = bytearray()

    def fileno(self) -> int:
        """Ready when there is something to drain."""
        return self._socket.fileno()

    def drain(self) -> None:
        """Read the received bytes."""
        try:
            while data := self._socket.recv(_READ_BYTES):
                self._data += data
        except (BlockingIOError, ConnectionResetError):
            return

    def take(self) -> bytes:
        """What was read since the last call."""
        data, self._data = bytes(self._data), bytearray()
        return data

    def close(self) -> None:
        """Close the socket; bytes already read can still be taken."""
        self._socket.close()


_START_LIMIT_NS = 30_000_000_000
_STOP_LIMIT_NS = 2_000_000_000  # the process itself takes half a second for what is still unread
_POLL_NS = 2_000_000
_OPENING_POLL_NS = 100_000_000


class PortRunner:
    """A port in its own process. Leaving the context always ends the process; after an error in this process it sends
    the final message first (see `set_final_message`).

    Order of use: `start`; `begin`, before or after the first `push`; `push` and `reports`; `finish`.

    Args:
        slots: packets that the ring holds: the longest look-ahead.
        packet_bytes: the longest packet.
        on_stall: called when one of the two processes stalls or resumes; see `StallMonitor`.
        keeps_received: whether `take_received` will be called; if not, received bytes are only counted.
        machine: where the process runs; None: the real one.
    """

    def __init__(
        self,
        slots: int = 1024,
        packet_bytes: int = 4096,
        on_stall: OnStall | None = None,
        keeps_received: bool = False,
        machine: Machine | None = None,
    ) -> None:
        self._machine = machine or Machine()
        self._clock = self._machine.clock
        self._stalls = StallMonitor(self._clock, on_stall)
        self._child: PortChild | None = None
        self._pty_link: Path | None = None
        packets_fd = SharedRing.create(slots, PACKET_HEAD_BYTES + packet_bytes)
        # Reports are fetched at least once in `slots` packets, and as many can be under way: twice that is never full.
        reports_fd = SharedRing.create(2 * slots, DeliveryReport.SIZE_BYTES)
        self._packets = SharedRing(packets_fd)
        self._reports = SharedRing(reports_fd)
        self._fetched: deque[DeliveryReport] = deque()
        self._slots, self._uncollected = slots, 0
        doorbell_fd, self._doorbell = os.pipe()
        os.set_blocking(self._doorbell, False)
        self._inherited = {"packets": packets_fd, "reports": reports_fd, "doorbell": doorbell_fd}
        self._keeps_received, self._received = keeps_received, list[ReceivedBytes]()
        self._far_end: LoopbackEnd | None = None
        self._begun = False
        self._closed = False
        self.status = PortStatus()
        """Status of the port and its link."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(orderly=kind is None or issubclass(kind, InputError | KeyboardInterrupt))

    def start(
        self, spec: PortSpec, faults: list[dict[str, Any]] | None = None, may_be_absent: bool = False
    ) -> str:
        """Start the process and open the port; return its description.

        Args:
            faults: faults of the port, each a `PortFault` as a mapping; None: there are none, and none can be injected.
            may_be_absent: whether the other end need not listen yet; `status.connected` shows when it does.

        Raises:
            InputError: the port cannot be opened.
            RunError: the process did not start.
        """
        self._pty_link = Path(spec.path) if spec.kind is Kind.PTY and spec.path else None
        inherited = self._inherited | standard_error()
        if spec.kind is Kind.LOOPBACK:
            self._far_end = LoopbackEnd()
            with self._far_end.device_end as device_end:
                self._child = PortChild(inherited | {"loopback": device_end.fileno()}, self._machine)
        else:
            self._child = PortChild(inherited, self._machine)
        self._child.send(port=spec.to_json(), faults=faults, absent=may_be_absent, **self._child.inherited)
        deadline_ns = self._clock.now_ns() + _START_LIMIT_NS
        while not self.status.description:
            if self._clock.now_ns() > deadline_ns:
                raise RunError(f"opening {spec} took more than {_START_LIMIT_NS // 10**9} s")
            self.wait(self._clock.now_ns() + _OPENING_POLL_NS)
        self.status.start_ns = self._clock.now_ns()
        return self.status.description

    def request_realtime(self) -> None:
        """Let the process request real-time privileges; it takes tens of milliseconds, so do it before `begin`."""
        self._running().send(realtime=True)

    def begin(
        self,
        start_ns: int,
        late_after_ns: int,
        pace: Pace,
        when_late: WhenLate = WhenLate.SKIP,
        poll_ns: int = 0,
    ) -> None:
        """Begin the run.

        Args:
            start_ns: instant of `Clock.now_ns` from which `due_ns` counts.
            late_after_ns: packets later than this are skipped.
            poll_ns: how long a packet waits for `poll`; 0: it is sent when it is due.
        """
        self.status.start_ns, self._begun = start_ns, True
        pacing = {"late_after_ns": late_after_ns, "pace": pace, "when_late": when_late, "poll_ns": poll_ns}
        self._running().send(begin={"start_ns": start_ns, **pacing})
        if pace is Pace.WALL:
            self._stalls.begin(start_ns, poll_ns)

    def push(self, packet: OutgoingPacket) -> bool:
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
        self._stalls.pushed(packet.due_ns)
        self._ring_doorbell()
        return True

    def wake_up(self) -> None:
        """Wake the process: a packet that is due will be pushed within a millisecond."""
        self._ring_doorbell(WAKE_UP)

    def supersede(self, generation: int, from_shot: int) -> None:
        """From shot `from_shot` on, stop sending packets of earlier generations; they are reported as superseded."""
        self._running().send(supersede=[generation, from_shot, self._packets.written])

    def send_now(self, payload: bytes) -> None:
        """Send a payload that is not a shot, between shots; see `take_between_ns`."""
        self._running().send(send=payload.hex())

    def poll(self) -> None:
        """After the payloads of `send_now`, send the last packet that was due, unless it was sent already."""
        self._running().send(poll=True)

    def set_final_message(self, message: bytes) -> None:
        """Set the message that the process sends, instead of the pending packets, if the model process dies."""
        self._running().send(final_message=message.hex())

    def set_pulses(self, first_ns: int, period_ns: int, firing: Sequence[Firing]) -> None:
        """Give a pulse at each of these shots: see `PulseTrain`."""
        self._running().send(pulses=[first_ns, period_ns, firing])

    def inject_fault(self, fault: dict[str, Any]) -> None:
        """Add a fault of the port, if there was a list of them at the start."""
        self._running().send(fault=fault)

    def take_received(self) -> list[ReceivedBytes]:
        """Bytes that arrived on the port since the last call."""
        received, self._received = self._received, []
        return received

    def take_link_events(self) -> list[LinkEvent]:
        """Events of the link since the last call; also after `close`."""
        return self.status.take_events()

    def take_between_ns(self) -> list[int | None]:
        """Times of payloads of `send_now`, see `PortStatus.take_between_ns`; also after `close`."""
        return self.status.take_between_ns()

    def reports(self) -> list[DeliveryReport]:
        """Reports since the last call, in the order of `push`; also after `close`.

        Raises:
            PortDiedError: as `wait`.
        """
        if not self._closed:
            self._collect()
        fetched, self._fetched = list(self._fetched), deque()
        return fetched

    def far_end(self) -> bytes:
        """What the in-memory loopback delivered since the last call; also after `close`.

        It must be read as a host would read: an in-memory line can be full, too.
        """
        if not self._closed:
            self._collect()
        return b"" if self._far_end is None else self._far_end.take()

    @property
    def pid(self) -> int | None:
        """Process id of the port process; None before `start`."""
        return None if self._child is None else self._child.pid

    def wait(self, until_ns: int, readable: Sequence[int] = (), busy_wait: bool = False) -> None:
        """Sleep, or wait busily, until an instant of the monotonic clock, or until the process reports something, the
        loopback delivers or one of the descriptors is ready. After a busy wait that a descriptor ended, messages of the
        process are left for later.

        Raises:
            PortDiedError: the process died. What it had reported before can still be fetched, after `close`.
        """
        descriptors = [*readable, self._running().descriptor]
        if self._far_end is not None:
            descriptors.append(self._far_end.fileno())
        ready, _ = self._clock.wait(until_ns, descriptors, busy_wait=busy_wait)
        if not (busy_wait and set(readable).intersection(ready)):
            self._collect()

    def end_packets(self) -> None:
        """Announce that no more packets follow: `finished` becomes true once the process has completed them.

        Raises:
            RunError: the run has not begun.
        """
        if not self._begun:
            raise RunError("the run has not begun")
        self._running().send(finish=True)
        self._ring_doorbell()

    @property
    def finished(self) -> bool:
        """Whether every packet is sent, skipped or dropped, and what was sent has left the line or, on a pty, is read.

        The other end has 2 s for that, and a serial line also the time that its bit rate requires.
        """
        return self.status.finished

    def finish(self) -> None:
        """`end_packets`, and wait until `finished`.

        Raises:
            RunError: the run has not begun, or the process died.
        """
        self.end_packets()
        while not self.finished:
            self.wait(self._clock.now_ns() + _POLL_NS)

    def close(self, orderly: bool = True) -> None:
        """End the process and release all resources; may be called again.

        In mid-run the other end still has half a second to fetch what counts as sent.

        Args:
            orderly: False: the run fails, and the process sends the final message.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self._child is not None:
                self._stop(self._child, orderly)
            self._fetch()
        finally:
            self._packets.close()
            self._reports.close()
            for descriptor in (*self._inherited.values(), self._doorbell):
                os.close(descriptor)
            if self._far_end is not None:
                self._far_end.close()

    def _stop(self, child: PortChild, orderly: bool) -> None:
        try:
            child.close_control(orderly)
            deadline_ns = self._clock.now_ns() + _STOP_LIMIT_NS
            while not child.ended and self._clock.now_ns() < deadline_ns:
                self._clock.wait(self._clock.now_ns() + _POLL_NS, [child.descriptor])
                self._drain()
                self._handle(child.receive())
        finally:
            # It has ended, or it hangs in a driver.
            child.kill()
            if self._pty_link is not None:
                unlink_stale(self._pty_link)

    def _collect(self) -> None:
        """Take all reports and messages of the process.

        Raises:
            InputError: it could not open the port.
            PortDiedError: it died.
        """
        child = self._running()
        self._fetch()
        self._handle(child.receive())
        if child.ended:
            raise child.death()
        self._stalls.poll()

    def _handle(self, messages: list[dict[str, Any]]) -> None:
        for message in messages:
            if "received" not in message:
                self.status.update(message)
            elif self._keeps_received:
                at_ns, data, pulse_ns = message["received"]
                self._received.append(ReceivedBytes(at_ns, bytes.fromhex(data), pulse_ns))

    def _fetch(self) -> None:
        self._uncollected = 0
        while (entry := self._reports.pop()) is not None:
            self._fetched.append(report := DeliveryReport.from_bytes(entry))
            self._stalls.reported(report.packets)
        self._drain()

    def _drain(self) -> None:
        if self._far_end is not None:
            self._far_end.drain()

    def _running(self) -> PortChild:
        if self._child is None or self._closed:
            raise RunError("the port is not open")
        return self._child

    def _ring_doorbell(self, what: bytes = CHANGED) -> None:
        try:
            os.write(self._doorbell, what)
        except BlockingIOError:
            return  # the pipe is full of earlier rings
