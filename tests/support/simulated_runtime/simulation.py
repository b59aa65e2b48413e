"""A simulated run: its plan carried out on the real runtime, and its invariants checked."""

from __future__ import annotations

import gc
import signal
import tempfile
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from io import BufferedWriter
from pathlib import Path
from random import Random
from typing import IO, Any, NamedTuple

from lidar_emu.errors import InputError
from lidar_emu.recording.read import Recording
from lidar_emu.recording.traffic import read_traffic
from lidar_emu.recording.write import Recorder
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions, StartEvent
from lidar_emu.runtime.port.packets import DeliveryStatus, Pace
from lidar_emu.runtime.replay import Replay
from lidar_emu.runtime.run import Run
from lidar_emu.runtime.summary import Outcome
from lidar_emu.scenario.load import load_with_settings
from lidar_emu.session import Block
from lidar_emu.shots.model import Model, build_model
from lidar_emu.transports.link import PortChannel
from lidar_emu.transports.spec import Kind, PortSpec
from simulated_runtime.can_bus import SimulatedBus, SimulatedCan
from simulated_runtime.checks import Checks
from simulated_runtime.disk import DiskFile
from simulated_runtime.host import SimulatedHost
from simulated_runtime.ledger import Ledger, require
from simulated_runtime.line import SimulatedLine, SimulatedPty, SimulatedSerial
from simulated_runtime.machine import SimulatedMachine
from simulated_runtime.plan import MS, Plan, S
from simulated_runtime.scheduler import START_NS, Killed, Scheduler
from simulated_runtime.truth import SimulatedSimulator

_BAUD = 921_600
_DESCRIPTORS = Path("/proc/self/fd")
_BUFFER_BYTES = 1 << 20
_SPECS = {
    "serial": PortSpec(Kind.SERIAL, "/dev/lidar", _BAUD),
    "pty": PortSpec(Kind.PTY, baud=_BAUD),
    "can": PortSpec(Kind.CAN, interface="simulated", channel="can0", bitrate=1_000_000),
}
_CONTROL = "/simulated/control"
_WAITS_S = 5.0
_LIMIT_NS = 300 * S


class Result(NamedTuple):
    """What a run did."""

    packets: int
    """Packets whose delivery status is known."""
    statuses: dict[DeliveryStatus, int]
    ending: str
    trace: str
    """What was sent, reported and delivered, and when."""


@lru_cache
def _planned_model(flight: tuple[tuple[str, str], ...]) -> Model:
    """The model of a planned flight: without state, and the same for all runs that fly it."""
    return build_model(load_with_settings("descent.yaml", dict(flight)))


class _Computing(Observer):
    """The time that the model takes for shots."""

    def __init__(self, scheduler: Scheduler, shot_ns: int) -> None:
        self._scheduler, self._shot_ns = scheduler, shot_ns

    def on_block_computed(self, block: Block) -> None:
        self._scheduler.spend(self._shot_ns * len(block.packets))


class Simulation:
    """A run of a plan.

    Args:
        folder: for the recording.
        errors: standard error of the port process.
    """

    def __init__(self, plan: Plan, folder: Path, errors: IO[bytes]) -> None:
        self._plan, self._recording = plan, folder / "flight.mcap"
        random = Random(f"run {plan.seed}")
        self._scheduler = Scheduler(random, plan.tick_ns, plan.wake_ns, plan.preempted, _LIMIT_NS)
        self._machine, self._line = _machine(plan, self._scheduler, errors)
        self._errors = errors
        self._host = SimulatedHost(self._line, self._scheduler)
        self._scenario = scenario = load_with_settings(plan.scenario, plan.settings)
        self._model = build_model(scenario) if scenario.live else _planned_model(plan.flight)
        self._options = RunOptions(
            _SPECS[plan.link], Pace(plan.pace), self._start(), _WAITS_S, _CONTROL if plan.control else None
        )
        self._simulator = self._simulates() if plan.scenario == "live.yaml" else None
        observers: list[Observer] = [_Computing(self._scheduler, plan.shot_ns)]
        self._run = Run(scenario, self._model, self._options, observers, self._machine)
        self._ledger = Ledger(Pace(plan.pace), scenario.timing.late_after_ns, self._run.tally)
        self._recorder = Recorder(
            self._recording,
            scenario,
            self._options,
            lambda path: BufferedWriter(self._disk_file(path), _BUFFER_BYTES),
        )
        observers += [self._ledger, self._recorder] if plan.is_recorded else [self._ledger]
        self._scheduler.after_step = self._ledger.check_step
        self._disk: DiskFile | None = None
        for happening in plan.happenings:
            self._scheduler.at(START_NS + happening.at_ns, lambda h=happening: self._happen(h.kind, h.values))

    def run(self) -> Result:
        """Carry out the plan.

        Raises:
            Failure: an invariant does not hold.
        """
        descriptors = len([*_DESCRIPTORS.iterdir()])
        outcome: Outcome | None = None
        ending = "finished"
        try:
            with self._recorder:
                outcome = self._run.fly()
        except Killed:
            ending = "killed"
        except InputError as error:
            ending = f"refused: {error}"
        finally:
            gc.unfreeze()
        self._scheduler.outlive()
        if self._scheduler.failure is not None:
            raise self._scheduler.failure
        require(len([*_DESCRIPTORS.iterdir()]) == descriptors, "descriptors are left open")
        checks = self._checks()
        if self._ledger.is_open and self._plan.is_recorded:
            is_full = self._disk is not None and self._disk.refused
            checks.check_recording(
                Recording(self._recording), self._recorder.error, is_full, ending == "killed"
            )
        if outcome is not None:
            ending = outcome.error or ("interrupted" if outcome.details["interrupted"] else ending)
            checks.check(outcome.to_json())
        elif ending == "killed":
            checks.check_line()
        if self._ledger.sent and self._plan.is_recomputed and ending != "killed" and self._disk is not None:
            replayed, sent = _replayed(self._plan, self._recording, self._errors), set(self._ledger.sent)
            shots = [payload for payload in replayed if payload in sent]
            require(
                self._disk.refused or shots == self._ledger.sent,
                "replayed:",
                len(shots),
                len(self._ledger.sent),
            )
        delivered = [bytes(connection.delivered) for connection in self._line.connections]
        trace = repr((self._ledger.times, self._ledger.events, self._ledger.housekeeping, delivered))
        return Result(self._ledger.statuses.total(), dict(self._ledger.statuses), ending, trace)

    def _checks(self) -> Checks:
        killed = any(port.process.killed for port in self._machine.ports) or self._scheduler.model.killed
        known = self._plan, self._scenario, self._model, self._ledger, self._line, self._host, self._simulator
        self._errors.seek(0)
        said, start_ns = self._errors.read().decode(), self._run.start_ns
        return Checks(*known, killed, said, start_ns, self._scheduler.model.stalled_ns)

    def _start(self) -> StartEvent | datetime | None:
        match self._plan.start:
            case "on-command":
                return StartEvent.ON_COMMAND
            case "instant":
                return datetime(2030, 1, 1, tzinfo=UTC) + timedelta(seconds=0.5)
        return None

    def _simulates(self) -> SimulatedSimulator:
        plan = self._plan
        simulator = SimulatedSimulator(
            self._scheduler,
            self._machine,
            plan.truth_ns,
            plan.truth_latency_ns,
            round(float(plan.settings["duration_s"]) * 0.9e9),
        )
        begin = simulator.step_along if plan.pace == "lockstep" else simulator.fly
        self._scheduler.at(START_NS + 200 * MS, begin)
        return simulator

    # What happens

    def _happen(self, kind: str, values: tuple[Any, ...]) -> None:
        scheduler, line = self._scheduler, self._line
        match kind:
            case "command":
                self._host.command(*values)
            case "commands":
                for name, arguments in values:
                    self._host.command(name, arguments, "whole")
            case "noise":
                line.send_bytes(values[0])
            case "flood":
                line.flood(scheduler.now_ns + values[0])
            case "stall model":
                scheduler.stall(scheduler.model, values[0])
            case "stall port":
                for port in self._machine.ports:
                    scheduler.stall(port.process, values[0])
            case "stall line":
                line.stall(values[0])
            case "unplug" | "hang up":
                line.unplug()
                scheduler.at(scheduler.now_ns + values[0], line.plug)
            case "step utc":
                scheduler.utc_step += timedelta(seconds=values[0])
            case "inject":
                self._to_control(values[0].encode())
            case "control":
                self._to_control(self._host.beside(*values))
            case "kill port":
                for port in self._machine.ports:
                    scheduler.kill(port.process)
            case "kill model":
                scheduler.kill(scheduler.model)
            case "interrupt":
                scheduler.interrupt(lambda: signal.raise_signal(signal.SIGINT))
            case "lose truth" if self._simulator is not None:
                self._simulator.lose(values[0])
            case "hold truth" if self._simulator is not None:
                self._simulator.hold(values[0])
            case "repeat truth" if self._simulator is not None:
                self._simulator.repeat()
            case "damage truth" if self._simulator is not None:
                self._simulator.damage(values[0])
            case "another simulator" if self._simulator is not None:
                self._simulator.intrude()
            case "fill disk":
                if self._disk is not None:
                    self._disk.room_bytes = values[0]

    def _disk_file(self, path: Path) -> DiskFile:
        self._disk = DiskFile(path, "w")
        return self._disk

    def _to_control(self, datagram: bytes) -> None:
        socket = self._machine.sockets.get(f"unix:{_CONTROL}")
        if socket is not None:
            socket.deliver(datagram, "/simulated/sender")


def _machine(
    plan: Plan, scheduler: Scheduler, errors: IO[bytes]
) -> tuple[SimulatedMachine, SimulatedLine | SimulatedBus]:
    """A machine, and the line at its port."""

    def open_port() -> PortChannel:
        if isinstance(line, SimulatedBus):
            return SimulatedCan(line)
        return SimulatedPty(line) if plan.link == "pty" else SimulatedSerial(line)

    line: SimulatedLine | SimulatedBus
    machine = SimulatedMachine(scheduler, open_port, errors, plan.busy_wait_share, plan.pipe_bytes)
    if plan.link == "can":
        line = SimulatedBus(scheduler, plan.baud)
    else:
        line = SimulatedLine(scheduler, plan.baud, machine.descriptor_of)
    return machine, line


def _replayed(plan: Plan, recording: Path, errors: IO[bytes]) -> list[bytes]:
    """What the line takes when a recording is replayed as fast as it goes."""
    scheduler = Scheduler(
        Random(f"replay {plan.seed}"), plan.tick_ns, plan.wake_ns, plan.preempted, _LIMIT_NS
    )
    machine, line = _machine(plan, scheduler, errors)
    traffic = read_traffic(recording)
    longest = max(len(payload) for _, payload in traffic.packets)
    packets = traffic.scheduled(1.0, 1)
    Replay(packets, longest, _SPECS[plan.link], Pace.MAX, 0.0, [], machine=machine).play()
    scheduler.outlive()
    if scheduler.failure is not None:
        raise scheduler.failure
    return [payload for connection in line.connections for payload in connection.taken]


def simulate(plan: Plan) -> Result:
    """Run a plan.

    Raises:
        Failure: an invariant does not hold.
    """
    with (
        tempfile.TemporaryDirectory(prefix="simulated-") as folder,
        (Path(folder) / "errors").open("w+b") as errors,
    ):
        return Simulation(plan, Path(folder), errors).run()
