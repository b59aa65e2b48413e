"""A run: packets computed ahead into the ring, reports counted, the far end shown, all in one loop."""

from __future__ import annotations

import signal
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from threading import current_thread, main_thread
from typing import Any

from lidar_emu.errors import InputError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.lateness import steal_ticks
from lidar_emu.runtime.pacing import Pace, WhenLate
from lidar_emu.runtime.packets import Fate, Outgoing, Report
from lidar_emu.runtime.run import PortRunner
from lidar_emu.runtime.summary import Tally, expectation
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Block, Session
from lidar_emu.shots import Model
from lidar_emu.transports.frames import Frame, pack_frames
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_emu.transports.wire_load import check_wire_load, wire_load
from lidar_emu.wire import Encoder, Packet

LOOK_AHEAD_S = 2.0
_BLOCK_S = 0.25
_LEAD_NS = 100_000_000
_WAIT_S = 0.02
_PACKET_ROOM_BYTES = 8192


class Observer:
    """Whoever looks on, displays and recorders: each overrides what concerns it."""

    def opened(self, port: str, start: datetime) -> None:
        """The port is open under this name; scenario time 0 will be at `start`, in UTC."""

    def computed(self, block: Block) -> None:
        """Shots are on their way to the port."""

    def report(self, packet: Outgoing, report: Report) -> None:
        """A packet met its fate."""

    def arrived(self, data: bytes) -> None:
        """Bytes at the far end of the in-memory loopback."""


@dataclass(frozen=True)
class RunOptions:
    """How a scenario is run."""

    port: PortSpec
    pace: Pace = Pace.WALL
    start: datetime | None = None
    """UTC instant of scenario time 0; None as soon as the first shots are computed."""


@dataclass
class Outcome:
    """What is known at the end of a run."""

    tally: Tally
    details: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """The summary file."""
        return {**self.details, **self.tally.to_json()}


class Run:
    """One flight of a scenario over a port.

    Args:
        scenario: what is flown.
        model: of the scenario.
        options: port, pace and start.
        observers: told of everything, in the loop: they must be quick.

    Raises:
        InputError: the wire is too slow for the rate, or the interface too small for the beams.
    """

    def __init__(
        self,
        scenario: FlightScenario | BenchScenario,
        model: Model,
        options: RunOptions,
        observers: list[Observer],
        clock: Clock | None = None,
    ) -> None:
        self._scenario = scenario
        self._model = model
        self._options = options
        self._observers = observers
        self._clock = clock or Clock()
        rate_hz = scenario.timing.rate_hz
        block_shots = max(1, min(128, round(rate_hz * _BLOCK_S)))
        port = options.port
        encoder = Encoder(scenario.wire, port.kind is Kind.CAN, port.fd, model.beam_count)
        self._session = Session(model, encoder, block_shots)
        # The first block is computed before the run: kernels are compiled, and the packets' length is known.
        self._first = self._session.next_block()
        assert self._first is not None
        longest = max((payload_of(packet) for packet in self._first.packets), key=len)
        self.warning = check_wire_load(port, longest, rate_hz)
        self._wire_load = wire_load(port, longest, rate_hz)
        self._slots = max(2 * block_shots, round(rate_hz * LOOK_AHEAD_S))
        self._in_flight: deque[Outgoing] = deque()
        self._opening = True
        self._interrupted = False
        self._start_utc: datetime | None = None
        self.start_ns: int | None = None
        """Instant of the monotonic clock from which due times count; known once observers hear `opened`."""
        self._when_late = WhenLate(scenario.timing.when_late)
        self._aborted_by: Report | None = None
        self.tally = Tally(options.pace)
        self._expected = expectation(scenario, model)

    def fly(self) -> Outcome:
        """Run to the end, or until SIGINT (Ctrl-C), SIGTERM or SIGHUP, which end the run as cleanly.

        Raises:
            InputError: the port cannot be opened, or the start lies in the past.
            RunError: the port's process died.
        """
        stolen = steal_ticks()
        with _on_signals(self._interrupt), PortRunner(self._slots, _PACKET_ROOM_BYTES) as port:
            with suppress(KeyboardInterrupt):
                self._open(port)
            self._feed(port)
            port.close()
            self._take(port)
        self.tally.close()
        return Outcome(self.tally, self._details(port, stolen))

    def _interrupt(self, *_: object) -> None:
        """Noted, and acted on between packets: an exception anywhere could lose reports that were just fetched.
        While the port is being opened there is nothing to lose, and no loop that would look."""
        self._interrupted = True
        if self._opening:
            raise KeyboardInterrupt

    def _open(self, port: PortRunner) -> None:
        description = port.start(self._options.port)
        self._opening = False
        self.start_ns, self._start_utc = self._start()
        for observer in self._observers:
            observer.opened(description, self._start_utc)
        late_after_ns = self._scenario.timing.late_after_ns
        port.begin(self.start_ns, late_after_ns, self._options.pace, self._when_late)

    @property
    def _cut_short(self) -> bool:
        return self._interrupted or self._aborted_by is not None

    def _feed(self, port: PortRunner) -> None:
        block = self._first
        while block is not None and not self._cut_short:
            for observer in self._observers:
                observer.computed(block)
            self.tally.measured(block.measurement)
            for packet in self._outgoing(block):
                self._in_flight.append(packet)
                while not port.push(packet):
                    self._wait(port)
                    if self._cut_short:
                        return
            self._take(port)
            block = self._session.next_block()
        if not self._cut_short:
            port.last_packet_pushed()
        while not (port.finished or self._cut_short):
            self._wait(port)

    def _wait(self, port: PortRunner) -> None:
        port.wait(_WAIT_S)
        self._take(port)

    @staticmethod
    def _outgoing(block: Block) -> Iterator[Outgoing]:
        shots, dues = block.measurement.shot.tolist(), block.measurement.due_ns.tolist()
        for shot, due_ns, packet in zip(shots, dues, block.packets, strict=True):
            yield Outgoing(shot, due_ns, payload_of(packet))

    def _take(self, port: PortRunner) -> None:
        """Count what became of packets and pass on what arrived."""
        for report in port.reports():
            packet = self._in_flight.popleft()
            self.tally.report(report)
            if report.fate is Fate.LATE and self._when_late is WhenLate.ABORT:
                self._aborted_by = report
            for observer in self._observers:
                observer.report(packet, report)
        if data := port.far_end():
            for observer in self._observers:
                observer.arrived(data)

    def _start(self) -> tuple[int, datetime]:
        """The start of the run, on the monotonic clock and in UTC."""
        now_ns, now = self._clock.now_ns(), self._clock.utc_now()
        start = self._options.start
        if start is None:
            return now_ns + _LEAD_NS, now + timedelta(microseconds=_LEAD_NS / 1000)
        if start < now:
            raise InputError("--start", None, start.isoformat(), "allowed: now, or an instant to come")
        return now_ns + (start - now) // timedelta(microseconds=1) * 1000, start

    def _details(self, port: PortRunner, stolen: int | None) -> dict[str, Any]:
        stolen_now = steal_ticks()
        late = self._aborted_by
        return {
            "scenario": self._scenario.name,
            "seed": self._scenario.seed,
            "epoch": self._scenario.timing.epoch.isoformat(),
            "rate_hz": self._scenario.timing.rate_hz,
            "planned_shots": self._model.shot_count,
            "started_utc": None if self._start_utc is None else self._start_utc.isoformat(),
            "interrupted": self._interrupted,
            "port": port.description or str(self._options.port),
            "pace": str(self._options.pace),
            "when_late": str(self._when_late),
            "aborted_by": None
            if late is None
            else {"shot": late.shot, "late_ns": late.woke_ns - late.due_ns},
            "granted": port.granted,
            "missing": port.missing,
            "steal_ticks": None if stolen is None or stolen_now is None else stolen_now - stolen,
            "wire": {
                "load": self._wire_load,
                "sent_bytes": port.sent_bytes,
                "received_bytes": port.received_bytes,
            },
            "link_event_count": port.event_count,
            "link_events": [{"time_s": event.time_ns * 1e-9, "what": event.text} for event in port.events],
            **self._expected,
            "left_out": [row for row in self._model.plan.rows() if not row["computed"]],
        }


def payload_of(packet: Packet) -> bytes:
    """A packet as the port process takes it."""
    if isinstance(packet, bytes):
        return packet
    return pack_frames([Frame(f.can_id, f.data, f.is_fd, f.bitrate_switch) for f in packet])


@contextmanager
def _on_signals(act: Callable[..., None]) -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP do something else for a while.

    A signal that is ignored stays so: a shell's background job is not meant to hear Ctrl-C. Threads other than
    the main one have no say in this.
    """
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if current_thread() is main_thread() else ()
    previous = {number: signal.getsignal(number) for number in numbers}
    heard = [number for number in numbers if previous[number] is not signal.SIG_IGN]
    for number in heard:
        signal.signal(number, act)
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, previous[number])
