"""Latency from live truth to the last byte written, compared with a control process that writes at once."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.bench.helper_process import Helper
from lidar_emu.bench.realtime_statistics import NEVER
from lidar_emu.numerics.arrays import IntArray
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import DeliveryReport, OutgoingPacket
from lidar_emu.runtime.run import Run
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model
from lidar_emu.transports.spec import Kind, PortSpec

_BAUD = 3_000_000
_TOP_M, _BOTTOM_M, _SPEED_MPS = 2000.0, 100.0, 50.0
_BEFORE_START_S = 1.0
_EARLY_NS = 100_000
"""Truth is sent this long before the packet is due: any later, the shot would be computed without it."""


@dataclass(frozen=True)
class ResponseReport:
    """Latencies of emulator and control process in nanoseconds, one for each shot that was written.

    A shot whose truth came after its packet was due, because the simulator woke up late, was computed without it and is
    left out.
    """

    emulator_ns: IntArray
    control_ns: IntArray
    summary: dict[str, Any]


def measure_response(
    rate_hz: float, duration_s: float, beamlets: int, progress: Callable[[str], None]
) -> ResponseReport:
    """Fly on a simulator's truth, which is sent for each shot just before its packet is due.

    Raises:
        InputError: a rate, duration or number of beamlets that no instrument has.
        RunError: a process died.
    """
    progress("preparing")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lidar-emu-")))
        addresses = folder / "emulator", folder / "control"
        scenario = _scenario(rate_hz, duration_s, beamlets, addresses[0])
        model = build_model(scenario)
        assert isinstance(model, FlightModel)
        beside = _SimulatorProcesses(stack, addresses, model, scenario, progress)
        port, clock = PortSpec(Kind.PTY, baud=_BAUD), Clock()
        # Compiles what is not in the cache, so that the next one starts on time.
        Run(scenario, model, RunOptions(port), [])
        start_utc = clock.utc_now() + timedelta(seconds=_BEFORE_START_S)
        beside.start_ns = clock.now_ns() + round(_BEFORE_START_S * 1e9)
        run = Run(scenario, model, RunOptions(port, start=start_utc), [beside])
        summary = run.fly().to_json()
        progress("collecting")
        told_ns, told_control_ns = beside.simulator.finish()
        (control_ns,) = beside.control.finish()
    written_ns = np.array(beside.written_ns, dtype=np.int64) + (run.start_ns or 0) - beside.start_ns
    emulator = written_ns - told_ns[np.array(beside.shots, dtype=np.int64)]
    n = min(len(control_ns), len(told_control_ns))
    taken_ns = (control_ns - beside.start_ns)[:n] - told_control_ns[:n]
    return ResponseReport(emulator, taken_ns[control_ns[:n] != NEVER], summary)


def _scenario(rate_hz: float, duration_s: float, beamlets: int, address: Path) -> FlightScenario:
    changes = {
        "name": "bench response",
        "timing.rate_hz": repr(rate_hz),
        "timing.processing_latency_s": "0",
        "device.housekeeping_rate_hz": "0",
        "duration_s": repr(duration_s),
        "instrument.optics.beamlets": repr(beamlets),
        "trajectory.listen": f"unix:{address}",
        "trajectory.lead_s": "0",
    }
    return require_flight(load("live.yaml", changes))


class _SimulatorProcesses(Observer):
    """Starts simulator, control process and readers with the flight, and records when its packets were written."""

    def __init__(
        self,
        stack: ExitStack,
        addresses: tuple[Path, Path],
        model: FlightModel,
        scenario: FlightScenario,
        progress: Callable[[str], None],
    ) -> None:
        names = "response_simulator", "response_control", "pty_reader", "pty_reader"
        helpers = (stack.enter_context(Helper(name)) for name in names)
        self.simulator, self.control, self._reader, control_reader = helpers
        self._addresses, self._flight, self._progress = addresses, model.flight, progress
        self._count = model.shot_count
        self._speed_mps = min(_SPEED_MPS, (_TOP_M - _BOTTOM_M) / (scenario.duration_s or 1.0))
        self.start_ns = 0
        self.shots: list[int] = []
        self.written_ns: list[int] = []
        self._without_truth: set[int] = set()
        path = self.control.receive()["path"]
        for helper in (self.simulator, self._reader, control_reader):
            helper.receive()
        control_reader.send(path=path)
        control_reader.receive()

    def on_waiting(self, port: str, what: str) -> None:  # noqa: ARG002
        self._reader.send(path=port)
        self._reader.receive()
        self.control.send(address=str(self._addresses[1]), packet_bytes=145)
        self.control.receive()
        flight = self._flight
        self.simulator.send(
            emulator=str(self._addresses[0]),
            control=str(self._addresses[1]),
            start_ns=self.start_ns,
            first_sent_ns=flight.due_ns(0) - _EARLY_NS,
            first_truth_ns=flight.seen_ns(0),
            period_ns=flight.period_ns,
            count=self._count,
            top_m=_TOP_M,
            speed_mps=self._speed_mps,
        )

    def on_opened(self, port: str, start: datetime) -> None:
        self._progress(f"flying on {port} from {start:%H:%M:%S}")

    def on_truth_used(self, shot: int, age_ns: int, truth_count: int) -> None:  # noqa: ARG002
        if age_ns > 0:
            self._without_truth.add(shot)

    def on_report(self, packet: OutgoingPacket, report: DeliveryReport) -> None:
        if report.sent_ns >= 0 and packet.shot not in self._without_truth:
            self.shots.append(packet.shot)
            self.written_ns.append(report.sent_ns)
