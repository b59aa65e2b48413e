"""A port under the packets of a scenario: errors, transit and turnaround, and the lateness of each write.

A plug joins transmitter and receiver of one port, or a cable or a bus two ports. The packets go the way of a run's,
through the port's own process; the host's end is a thread of Python, whose delays are in transit and turnaround.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.bench.realtime_statistics import counts_between, figures, histogram_edges_ns
from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import IntArray
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.options import RunOptions, StartEvent
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace, payload_of
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.prepare import PreparedRun, prepare
from lidar_emu.runtime.signals import on_signals
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.shots.model import build_model
from lidar_emu.transports.frames import Frame, unpack_frames
from lidar_emu.transports.messages import Decoder, command_payload
from lidar_emu.transports.opening import ByteHost, CanHost, open_host
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import (
    Acknowledge,
    CanCommandReader,
    Command,
    CommandReader,
    Host,
    Message,
)
from lidar_protocol.commands import FromHost

_POOL_SHOTS = 128
_LEAD_NS = 200_000_000
_POLL_NS = 5_000_000
_READ_S = 0.005
_COMMAND_EVERY_NS = 100_000_000
_QUIET_NS = 2_000_000_000
"""Without anything new for this long, what is missing is lost: a starved host reads its last packets late."""
_SLOTS = 1024
_DAMAGES = ("bad_crc", "bad_length", "bad_stuffing", "foreign", "incomplete", "orphans")


@dataclass(frozen=True)
class LinkReport:
    """Figures of a check."""

    scenario: str
    ports: list[str]
    wire_load: float | None
    packet: str
    """Size of the longest packet."""
    rate_hz: float
    reports: list[DeliveryReport]
    arrived: int
    """Whole packets that arrived."""
    damaged: int
    skipped_bytes: int
    """Bytes that arrived and belong to no packet."""
    transit_ns: IntArray
    """From the end of the write until the packet had arrived, shape (packets,); empty if one was lost."""
    commands: int
    turnaround_ns: IntArray
    """From the write of a command until its acknowledgement had arrived, shape (answered commands,)."""
    latency_timer_ms: dict[str, int]
    granted: list[str]
    missing: dict[str, str]
    link_events: list[str]
    interrupted: bool

    def counted(self, status: DeliveryStatus) -> int:
        """Number of packets with this status."""
        return sum(report.status is status for report in self.reports)

    @property
    def lateness_ns(self) -> IntArray:
        """From due to written, shape (packets sent,)."""
        sent = (each for each in self.reports if each.status is DeliveryStatus.SENT)
        return np.array([max(0, each.sent_ns - each.due_ns) for each in sent], dtype=np.int64)

    @property
    def problems(self) -> list[str]:
        """Why the scenario does not fit; empty if it does."""
        due, sent, late = len(self.reports), *map(self.counted, (DeliveryStatus.SENT, DeliveryStatus.LATE))
        unanswered = self.commands - len(self.turnaround_ns)
        found = {
            "no packet was sent": not sent,
            f"{sent - self.arrived} of {sent} packets did not arrive": sent - self.arrived,
            f"{self.damaged} damaged packets arrived": self.damaged,
            f"{self.skipped_bytes} bytes arrived that belong to no packet": self.skipped_bytes,
            f"{unanswered} of {self.commands} commands were not answered": unanswered,
            f"{late} of {due} packets were late": late,
            f"{due - sent - late} of {due} packets were dropped": due - sent - late,
        }
        return [text for text, number in found.items() if number]

    def to_json(self) -> dict[str, Any]:
        """The report as JSON values."""
        lateness_ns = self.lateness_ns
        edges_ns = histogram_edges_ns(lateness_ns)
        return {
            "scenario": self.scenario,
            "ports": self.ports,
            "fits": not self.problems,
            "problems": self.problems,
            "interrupted": self.interrupted,
            "wire_load": self.wire_load,
            "packet": self.packet,
            "rate_hz": self.rate_hz,
            "due": len(self.reports),
            "sent": self.counted(DeliveryStatus.SENT),
            "late": self.counted(DeliveryStatus.LATE),
            "arrived": self.arrived,
            "damaged": self.damaged,
            "skipped_bytes": self.skipped_bytes,
            "commands": self.commands,
            "lateness": figures(lateness_ns),
            "transit": figures(self.transit_ns),
            "turnaround": figures(self.turnaround_ns),
            "histogram": {
                "edges_ns": edges_ns.tolist(),
                "lateness": counts_between(lateness_ns, edges_ns).tolist(),
            },
            "latency_timer_ms": self.latency_timer_ms,
            "granted": self.granted,
            "missing": self.missing,
            "link_events": self.link_events,
        }


def check_link(
    scenario: FlightScenario | BenchScenario,
    ports: list[PortSpec],
    duration_s: float,
    progress: Callable[[str], None],
) -> LinkReport:
    """Send packets of the scenario at its rate, and commands the other way; Ctrl-C keeps what was measured.

    Args:
        ports: the device's, and the host's; the device's alone if a plug joins its transmitter and receiver.

    Raises:
        InputError: a port cannot be opened, or the packets do not fit on it.
        RunError: the port process did not start, or it died.
    """
    progress("preparing")
    first, *far = ports
    if not far and first.kind is not Kind.SERIAL:
        remedy = "pass the other end too; one port alone is for a plug at a serial device"
        raise InputError("check", None, Finding(f"only {first}"), remedy)
    prepared = prepare(scenario, build_model(scenario), RunOptions(first, start=StartEvent.NOW))
    far = [spec.on_line(prepared.encoder.interface.serial_format) for spec in far]
    return _Check(prepared, far[0] if far else None, progress).measure(duration_s)


class _HostEnd:
    """Decodes packets, and commands a `no_op` now and then. Its instants are of the monotonic clock."""

    def __init__(self, prepared: PreparedRun, clock: Clock) -> None:
        interface, self._unit = prepared.encoder.interface, prepared.scenario.wire.unit
        self.is_can = prepared.port.kind is Kind.CAN
        self._clock, self._host = clock, Host(interface, self._unit)
        self._decoder = Decoder(interface)
        self.arrived_ns: list[int] = []
        self.turnaround_ns: list[int] = []
        self.commands = 0
        known = interface.commands if prepared.downlink.has_commands else None
        self._sequences = known.sequence_steps if known and "no_op" in known.by_name else 0
        self._unanswered: deque[tuple[int, int]] = deque()
        self._next_ns = clock.now_ns()

    def receive(self, data: bytes | list[Frame], at_ns: int) -> None:
        """Take what has arrived."""
        for message in self._decoder.receive(data):
            if isinstance(message, Message):
                self.arrived_ns.append(at_ns)
            elif isinstance(message, Acknowledge):
                self._answered(message.sequence, at_ns)

    def command(self, host: ByteHost | CanHost) -> None:
        """Send a command if one is due."""
        now_ns = self._clock.now_ns()
        if not self._sequences or now_ns < self._next_ns:
            return
        sequence = self.commands % self._sequences
        if host.write(command_payload(self._host, self.is_can, "no_op", {"sequence": sequence})):
            self._unanswered.append((sequence, now_ns))
            self.commands, self._next_ns = self.commands + 1, now_ns + _COMMAND_EVERY_NS

    @property
    def heard(self) -> int:
        """Packets and acknowledgements that have arrived."""
        return len(self.arrived_ns) + len(self.turnaround_ns)

    @property
    def is_waiting(self) -> bool:
        """Whether an acknowledgement is missing."""
        return bool(self._unanswered)

    @property
    def damaged(self) -> int:
        """Frames or sets that were damaged."""
        counters = self._decoder.counters()
        return sum(counters.get(name, 0) for name in _DAMAGES)

    @property
    def skipped_bytes(self) -> int:
        """Bytes that belong to no packet; on a bus frames of others are no fault."""
        return self._decoder.counters().get("skipped_bytes", 0)

    def _answered(self, sequence: int | None, at_ns: int) -> None:
        while self._unanswered:
            sent, sent_ns = self._unanswered.popleft()
            if sequence in (sent, None):  # an interface may leave it out
                self.turnaround_ns.append(at_ns - sent_ns)
                return


class _Check:
    def __init__(self, prepared: PreparedRun, far: PortSpec | None, progress: Callable[[str], None]) -> None:
        self._prepared, self._far, self._progress, self._clock = prepared, far, progress, Clock()
        self._host_end = _HostEnd(prepared, self._clock)
        kind = CanCommandReader if self._host_end.is_can else CommandReader
        interface, unit = prepared.encoder.interface, prepared.scenario.wire.unit
        self._commands = kind(interface, unit) if prepared.downlink.has_commands else None
        self._reports: list[DeliveryReport] = []
        self._answers = self._count = self._shown_second = 0
        self._commanding, self._listening, self._interrupted = True, True, False
        # Set by the thread that commands: only it knows that no write of a command is under way any more.
        self._all_commanded = far is None

    def measure(self, duration_s: float) -> LinkReport:
        """Send for a duration, or until Ctrl-C."""
        prepared, timing = self._prepared, self._prepared.scenario.timing
        block = prepared.session.shoot(_POOL_SHOTS)
        payloads = [payload_of(packet) for packet in (block.packets if block else []) if packet]
        if not payloads:
            raise InputError(
                prepared.scenario.name, None, Finding("no packets"), "must send some in its first shots"
            )
        longest = max(payloads, key=len)
        self._count = max(1, round(duration_s * 1e9) // timing.period_ns)
        packets = (
            OutgoingPacket(k, k * timing.period_ns, payloads[k % len(payloads)]) for k in range(self._count)
        )
        with on_signals(self._interrupt), PortRunner(_SLOTS, len(longest), keeps_received=True) as port:
            port.start(prepared.port, may_be_absent=prepared.port.shows_host)
            port.request_realtime()
            with self._far_end():
                start_ns = self._clock.now_ns() + _LEAD_NS
                port.begin(start_ns, timing.late_after_ns, Pace.WALL)
                self._send(port, packets)
                self._receive_last(port)
        self._reports += port.reports()
        host_end = self._host_end
        specs = [prepared.port] if self._far is None else [prepared.port, self._far]
        size = f"{len(unpack_frames(longest))} frames" if host_end.is_can else f"{len(longest)} bytes"
        return LinkReport(
            scenario=prepared.scenario.name,
            ports=[str(spec) for spec in specs],
            wire_load=prepared.wire_load,
            packet=size,
            rate_hz=timing.rate_hz,
            reports=self._reports,
            arrived=len(host_end.arrived_ns),
            damaged=host_end.damaged,
            skipped_bytes=host_end.skipped_bytes,
            transit_ns=self._transit_ns(start_ns),
            commands=host_end.commands,
            turnaround_ns=np.array(host_end.turnaround_ns, dtype=np.int64),
            latency_timer_ms=dict(_latency_timers(specs)),
            granted=list(port.status.granted),
            missing=dict(port.status.missing),
            link_events=[event.text for event in port.take_link_events()],
            interrupted=self._interrupted,
        )

    def _interrupt(self, *_: object) -> None:
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True

    @contextmanager
    def _far_end(self) -> Iterator[None]:
        if self._far is None:
            yield
            return
        host = open_host(self._far)
        thread = threading.Thread(target=self._listen, args=(host,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._listening = False
            thread.join()
            host.close()

    def _listen(self, host: ByteHost | CanHost) -> None:
        while self._listening:
            data = host.read(_READ_S)
            self._host_end.receive(data, self._clock.now_ns())
            if self._commanding:
                self._host_end.command(host)
            else:
                self._all_commanded = True

    def _send(self, port: PortRunner, packets: Iterator[OutgoingPacket]) -> None:
        for packet in packets:
            while not (self._interrupted or port.push(packet)):
                self._attend(port)
            if self._interrupted:
                break
        port.end_packets()
        while not (self._interrupted or port.finished):
            self._attend(port)
        self._commanding = False

    def _receive_last(self, port: PortRunner) -> None:
        sent = sum(report.status is DeliveryStatus.SENT for report in self._reports)
        host_end = self._host_end
        heard, deadline_ns = host_end.heard, self._clock.now_ns() + _QUIET_NS
        while self._clock.now_ns() < deadline_ns:
            if self._all_commanded and not host_end.is_waiting and len(host_end.arrived_ns) >= sent:
                break
            self._attend(port)
            if host_end.heard != heard:
                heard, deadline_ns = host_end.heard, self._clock.now_ns() + _QUIET_NS

    def _attend(self, port: PortRunner) -> None:
        """Wait a little; collect reports, and answer commands as the device does."""
        port.wait(self._clock.now_ns() + _POLL_NS)
        self._reports += port.reports()
        for received in port.take_received():
            if self._far is None:
                self._host_end.receive(received.data, received.at_ns)
            else:
                self._answer(port, received.data)
        if (second := self._clock.now_ns() // 10**9) != self._shown_second:
            self._shown_second, arrived = second, len(self._host_end.arrived_ns)
            self._progress(f"{len(self._reports)} of {self._count} packets, {arrived} arrived")

    def _answer(self, port: PortRunner, data: bytes) -> None:
        commands: list[FromHost] = []
        if isinstance(self._commands, CommandReader):
            commands = self._commands.feed(data)
        elif self._commands is not None:
            for frame in unpack_frames(data):
                commands += self._commands.feed(frame.can_id, frame.data, frame.is_fd)
        for command in commands:
            values = {"sequence": command.sequence or 0, "verdict": "accepted", "time_ns": 0, "time_s": 0.0}
            name = command.name if isinstance(command, Command) else "no_op"
            payload = self._prepared.downlink.acknowledgement(self._answers, name, values)
            if payload is not None:
                port.send_now(payload)
            self._answers += 1

    def _transit_ns(self, start_ns: int) -> IntArray:
        written_ns = [start_ns + each.sent_ns for each in self._reports if each.status is DeliveryStatus.SENT]
        arrived_ns = self._host_end.arrived_ns
        if len(written_ns) != len(arrived_ns):
            return np.empty(0, dtype=np.int64)
        return np.maximum(0, np.array(arrived_ns, dtype=np.int64) - np.array(written_ns, dtype=np.int64))


def _latency_timers(specs: Iterable[PortSpec]) -> Iterator[tuple[str, int]]:
    """Latency timers of USB adapters, by FTDI mostly, as the kernel shows them (Documentation/ABI, usb-serial)."""
    for spec in specs:
        if spec.kind is Kind.SERIAL and not spec.scheme:
            timer = Path("/sys/class/tty") / Path(spec.path).resolve().name / "device" / "latency_timer"
            with suppress(OSError, ValueError):
                yield spec.path, int(timer.read_text(encoding="ascii"))
