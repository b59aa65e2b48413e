"""Lateness of the emulator on this machine: a whole flight, and a control process that only sleeps and writes."""

from __future__ import annotations

import os
import platform
import tempfile
from array import array
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.bench.helper_process import Helper
from lidar_emu.bench.realtime_statistics import (
    NEVER,
    SecondComparison,
    Side,
    counts_between,
    figures,
    histogram_edges_ns,
    late_without_control,
    median_excess_ns,
    windows,
)
from lidar_emu.numerics.arrays import IntArray
from lidar_emu.recording.write import Recorder
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions, StartEvent
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, payload_of
from lidar_emu.runtime.run import Run
from lidar_emu.runtime.summary import steal_ticks
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.scenario.schema import FlightScenario, Timing
from lidar_emu.session import Block
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import Kind, PortSpec

_PTY = PortSpec(Kind.PTY, baud=3_000_000)
_TOP_M, _BOTTOM_M, _SPEED_MPS = 2000.0, 100.0, 100.0
_NS_PER_S = 1_000_000_000
_NOTHING = np.empty(0, dtype=np.int64)

Progress = Callable[[str], None]


@dataclass(frozen=True)
class RealtimeOptions:
    """The benchmark flight."""

    rate_hz: float = 1111.0
    """Shots per second."""
    duration_s: float = 10.0
    beamlets: int = 61
    """Beamlets per beam; the four beams fire together."""
    recording: bool = False
    """Whether the flight is recorded as well, into a temporary file."""
    port: PortSpec = _PTY
    """The emulator's port. What arrives at the far end of another one is not measured."""


@dataclass(frozen=True)
class RealtimeReport:
    """The measurements of emulator and control process."""

    options: RealtimeOptions
    emulator: Side
    control: Side
    windows: list[SecondComparison]
    steal_by_second: dict[int, int]
    """Ticks stolen by the host in each second of the run; empty if the system does not count them."""
    packet_bytes: int
    summary: dict[str, Any]
    """Summary of the flight, as `lidar-emu run --summary` writes it."""
    control_granted: list[str]


def scenario_of(options: RealtimeOptions) -> FlightScenario:
    """Scenario of the benchmark: the shipped descent's instrument and ground, on a straight descent of the whole
    duration.

    Raises:
        InputError: a rate, duration or number of beamlets that no instrument has.
    """
    speed_mps = min(_SPEED_MPS, (_TOP_M - _BOTTOM_M) / (1.01 * options.duration_s))
    legs = ", ".join(f"{{altitude_m: {m}, speed_mps: {speed_mps!r}}}" for m in (_TOP_M, _BOTTOM_M))
    changes = {
        "name": "bench realtime",
        "timing.rate_hz": repr(options.rate_hz),
        "device.housekeeping_rate_hz": "0",
        "duration_s": repr(options.duration_s),
        "instrument.optics.beamlets": repr(options.beamlets),
        "trajectory.waypoints": f"[{legs}]",
    }
    return require_flight(load("descent.yaml", changes))


def measure_realtime(options: RealtimeOptions, progress: Progress) -> RealtimeReport:
    """Fly, with control process and readers in parallel; Ctrl-C ends the flight early and keeps the measurements.

    Raises:
        InputError: as `scenario_of`.
        RunError: a process died.
    """
    progress("preparing")
    scenario = scenario_of(options)
    model = build_model(scenario)
    log = _ReportLog(progress)
    observers: list[Observer] = [log]
    run_options = RunOptions(options.port, start=StartEvent.NOW)
    run = Run(scenario, model, run_options, observers)
    with ExitStack() as stack:
        if options.recording:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="lidar-emu-"))
            recorder = Recorder(Path(folder) / "flight.mcap", scenario, run_options)
            observers.append(stack.enter_context(recorder))
        processes = _ControlProcesses(
            stack, run, scenario.timing, model.shot_count, options.port.kind is Kind.PTY
        )
        observers.append(processes)
        summary = run.fly().to_json()
        progress("collecting")
        emulator = log.side(run.start_ns or 0, processes.received_ns(), processes.delimiters)
        control = processes.control_side()
    return RealtimeReport(
        options,
        emulator,
        control,
        windows(emulator, control),
        log.steal_by_second(),
        processes.packet_bytes,
        summary,
        processes.granted,
    )


class _ReportLog(Observer):
    """Records every delivery report of the flight, in the loop of the model process."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._due, self._woke, self._sent = array("q"), array("q"), array("q")
        self._late = array("b")
        self._second = -1
        self._steal: list[tuple[int, int]] = []

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:  # noqa: ARG002
        self._due.append(report.due_ns)
        self._woke.append(report.woke_ns)
        self._sent.append(report.sent_ns)
        self._late.append(report.status is DeliveryStatus.LATE)
        if report.due_ns // _NS_PER_S != self._second:
            self._second = report.due_ns // _NS_PER_S
            self._progress(f"{self._second} s, {sum(self._late)} late")
            ticks = steal_ticks()
            if ticks is not None:
                self._steal.append((self._second, ticks))

    def side(self, start_ns: int, received_ns: IntArray, delimiters: int) -> Side:
        """The recorded instants, and the reader's (monotonic clock, one per delimiter)."""
        sent = np.array(self._sent, dtype=np.int64)
        return Side(
            np.array(self._due, dtype=np.int64),
            np.array(self._woke, dtype=np.int64),
            sent,
            in_order_of(sent, received_ns[delimiters - 1 :: delimiters] - start_ns),
            np.array(self._late, dtype=bool),
        )

    def steal_by_second(self) -> dict[int, int]:
        """Ticks stolen between the first reports of consecutive seconds."""
        return {
            second: after - before
            for (second, before), (_, after) in zip(self._steal, self._steal[1:], strict=False)
        }


class _ControlProcesses(Observer):
    """The control process and the two readers, started by events of the flight.

    Args:
        run: the flight, whose start they need.
        reads: whether the far end of the emulator's port is a pty, and is read.
    """

    def __init__(self, stack: ExitStack, run: Run, timing: Timing, shot_count: int, reads: bool) -> None:
        self._run, self._timing, self._shot_count, self._reads = run, timing, shot_count, reads
        self._control, self._control_reader, self._reader = (
            stack.enter_context(Helper(name)) for name in ("realtime_control", "pty_reader", "pty_reader")
        )
        told = self._control.receive()
        self.granted: list[str] = told["granted"]
        for reader in (self._reader, self._control_reader):
            reader.receive()
        self._control_reader.send(path=told["path"])
        self._control_reader.receive()
        self._first_due_ns: int | None = None
        self.packet_bytes = 0
        self.delimiters = 1

    def on_block_computed(self, block: Block) -> None:
        if self._first_due_ns is None:
            payload = payload_of(block.packets[0])
            self.packet_bytes, self.delimiters = len(payload), payload.count(0)
            self._first_due_ns = int(block.measurement.due_ns[0])

    def on_opened(self, port: str, start: datetime) -> None:  # noqa: ARG002
        # Its schedule comes once the far end of the emulator's pty is open.
        if self._reads:
            self._reader.send(path=port)
            self._reader.receive()
        self._control.send(
            packet_bytes=self.packet_bytes,
            start_ns=self._run.start_ns,
            first_due_ns=self._first_due_ns,
            period_ns=self._timing.period_ns,
            count=self._shot_count,
            late_after_ns=self._timing.late_after_ns,
        )

    def received_ns(self) -> IntArray:
        """Instants of the emulator's delimiters at the far end, on the monotonic clock."""
        return self._reader.finish()[0] if self._reads and self._run.start_ns is not None else _NOTHING

    def control_side(self) -> Side:
        """The instants of the control process and its reader."""
        if self._first_due_ns is None or self._run.start_ns is None:
            return Side(_NOTHING, _NOTHING, _NOTHING, _NOTHING, _NOTHING.astype(bool))
        received = self._control_reader.finish()[0] - self._run.start_ns
        woke, written = self._control.finish()
        due = self._first_due_ns + self._timing.period_ns * np.arange(len(woke), dtype=np.int64)
        late = woke > due + self._timing.late_after_ns
        return Side(due, woke, written, in_order_of(written, received), late)


def in_order_of(sent_ns: IntArray, received_ns: IntArray) -> IntArray:
    """Instants of reception, shape as `sent_ns`: neither the pty nor the reader changes the order."""
    result = np.full(len(sent_ns), NEVER, dtype=np.int64)
    sent = np.flatnonzero(sent_ns != NEVER)[: len(received_ns)]
    result[sent] = received_ns[: len(sent)]
    return result


def realtime_document(report: RealtimeReport) -> dict[str, Any]:
    """All results except the single shots. Times are integer nanoseconds."""
    kernel, python = platform.release(), platform.python_version()
    machine = {"cores": os.cpu_count(), "kernel": kernel, "python": python}
    shots, summary = report.summary["shots"], report.summary
    ours_ns, theirs_ns = report.emulator.due_to_written_ns(), report.control.due_to_written_ns()
    edges_ns = histogram_edges_ns(ours_ns, theirs_ns)
    return {
        "machine": machine,
        **asdict(report.options),
        "port": str(report.options.port),
        "packet_bytes": report.packet_bytes,
        "interrupted": summary["interrupted"],
        "granted": summary["granted"],
        "missing": summary["missing"],
        "control_granted": report.control_granted,
        "steal_ticks": summary["steal_ticks"],
        "emulator": _side(report.emulator) | {"dropped": sum(shots["dropped"].values())},
        "control": _side(report.control),
        "windows": {
            "count": len(report.windows),
            "median_excess_p99_ns": median_excess_ns(report.windows),
            "late_where_control_had_none": late_without_control(report.windows),
            "each": [
                asdict(window) | {"steal_ticks": report.steal_by_second.get(window.at_s)}
                for window in report.windows
            ],
        },
        "histogram": {
            "edges_ns": edges_ns.tolist(),
            "emulator": counts_between(ours_ns, edges_ns).tolist(),
            "control": counts_between(theirs_ns, edges_ns).tolist(),
        },
    }


def _side(side: Side) -> dict[str, Any]:
    return {
        "due": len(side.due_ns),
        "late": int(side.late.sum()),
        "wake_up": figures(side.wake_up_ns()),
        "due_to_written": figures(side.due_to_written_ns()),
        "due_to_received": figures(side.due_to_received_ns()),
    }
