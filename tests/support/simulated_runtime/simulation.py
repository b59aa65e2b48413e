"""A simulated run: its plan carried out on the real runtime, and its invariants checked."""

from __future__ import annotations

import gc
from collections import deque
from copy import deepcopy
import os
import signal
import tempfile
from datetime import UTC, datetime, timedelta
from io import BufferedWriter
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

from lidar_emu.errors import InputError
from lidar_emu.recording.read import Recording
from lidar_emu.recording.recompute import recompute
from lidar_emu.recording.write import Recorder
from lidar_emu.runtime.change_queue import ReceivedCommand
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions, StartEvent
from lidar_emu.runtime.port.packets import DeliveryStatus, Pace
from lidar_emu.runtime.run import Run
from lidar_emu.runtime.summary import Outcome
from lidar_emu.scenario.load import load_with_settings
from lidar_emu.session import Block
from lidar_emu.shots.model import build_model
from lidar_emu.transports.frames import unpack_frames
from lidar_emu.transports.link import PortChannel
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import Message, SerialReceiver, default_interface
from simulated_runtime.can_bus import SimulatedBus, SimulatedCan
from simulated_runtime.disk import DiskFile
from simulated_runtime.expected_modes import ExpectedDevice, events_of_faults
from simulated_runtime.host import SimulatedHost
from simulated_runtime.ledger import Ledger, match_wire, require
from simulated_runtime.line import SimulatedLine, SimulatedPty, SimulatedSerial
from simulated_runtime.machine import SimulatedMachine
from simulated_runtime.plan import MS, S, Plan
from simulated_runtime.scheduler import START_NS, Failure, Killed, Scheduler
from simulated_runtime.truth import SimulatedSimulator

_BAUD = 921_600
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
    """

    def __init__(self, plan: Plan, folder: Path) -> None:
        self._plan, self._recording = plan, folder / "flight.mcap"
        self._errors = tempfile.TemporaryFile(dir=folder)
        random = Random(f"run {plan.seed}")
        self._scheduler = Scheduler(random, plan.tick_ns, plan.wake_ns, plan.preempted, _LIMIT_NS)
        self._machine = SimulatedMachine(self._scheduler, lambda spec: self._open(spec), self._errors)
        self._line: SimulatedLine | SimulatedBus = (
            SimulatedBus(self._scheduler, plan.baud)
            if plan.link == "can"
            else SimulatedLine(self._scheduler, plan.baud, self._machine.descriptor_of)
        )
        self._host = SimulatedHost(self._line, self._scheduler)
        self._scenario = scenario = load_with_settings(plan.scenario, plan.settings)
        self._model = build_model(scenario)
        self._options = RunOptions(
            _SPECS[plan.link], Pace(plan.pace), self._start(), _WAITS_S, _CONTROL if plan.control else None
        )
        self._simulator = self._simulates() if plan.scenario == "live.yaml" else None
        observers: list[Observer] = [_Computing(self._scheduler, plan.shot_ns)]
        self._run = Run(scenario, self._model, self._options, observers, self._machine)
        self._ledger = Ledger(Pace(plan.pace), scenario.timing.late_after_ns, self._run.tally)
        self._recorder = Recorder(self._recording, scenario, self._options, lambda path: BufferedWriter(self._disk_file(path), _BUFFER_BYTES))
        observers += [self._ledger, self._recorder]
        self._interrupts = False
        self._disk: DiskFile | None = None
        for happening in plan.happenings:
            self._scheduler.at(START_NS + happening.at_ns, lambda h=happening: self._happen(h.kind, h.values))

    def run(self) -> Result:
        """Carry out the plan.

        Raises:
            Failure: an invariant does not hold.
        """
        descriptors = len(os.listdir("/proc/self/fd"))
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
        if self._ledger.is_open:
            self._check_recording(ending)
        require(len(os.listdir("/proc/self/fd")) == descriptors, "descriptors are left open")
        if outcome is not None:
            ending = outcome.error or ("interrupted" if outcome.details["interrupted"] else ending)
            self._check(outcome)
        return Result(self._ledger.statuses.total(), dict(self._ledger.statuses), ending)

    def _start(self) -> StartEvent | datetime | None:
        match self._plan.start:
            case "on-command":
                return StartEvent.ON_COMMAND
            case "instant":
                return datetime(2030, 1, 1, tzinfo=UTC) + timedelta(seconds=0.5)
        return None

    def _open(self, spec: PortSpec) -> PortChannel:
        if isinstance(self._line, SimulatedBus):
            return SimulatedCan(self._line)
        return SimulatedPty(self._line) if spec.kind is Kind.PTY else SimulatedSerial(self._line)

    def _simulates(self) -> SimulatedSimulator:
        plan = self._plan
        simulator = SimulatedSimulator(
            self._scheduler, self._machine, plan.truth_ns, plan.truth_latency_ns, round(float(plan.settings["duration_s"]) * 0.9e9)
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

    # What must hold

    def _check(self, outcome: Outcome) -> None:
        ledger, summary = self._ledger, outcome.to_json()
        ledger.check_summary(summary["shots"])
        is_whole = outcome.error is None and not summary["interrupted"]
        if is_whole and self._simulator is None:
            whole = [shot for shot, *_ in ledger.shots] == [*range(self._model.shot_count)]
            require(whole, "shots are missing:", ledger.last, self._model.shot_count)
        computed = [shot for shot, *_ in ledger.shots if shot not in ledger.missed]
        require(ledger.blocks == computed, "measurements of each reported shot, once")
        if self._simulator is not None and self._plan.pace == "lockstep":
            answered = [(packet.shot, packet.status, packet.payload) for packet in self._simulator.answered]
            require(answered == ledger.reports[: len(answered)], "answered and reported:", len(answered), len(ledger.reports))
            require(not is_whole or len(answered) == len(ledger.reports), "reports without an answer")
        if ledger.statuses and self._plan.pace == "wall":
            require(summary["lateness"]["count"] == ledger.statuses[DeliveryStatus.SENT], "lateness of what was sent")
        port_died = any(port.process.killed for port in self._machine.ports)
        self._check_wire(summary, port_died, is_whole)

    def _check_wire(self, summary: dict[str, Any], port_died: bool, is_whole: bool) -> None:
        ledger, line = self._ledger, self._line
        taken = [payload for connection in line.connections for payload in connection.taken]
        slow = any(h.kind == "inject" and "slow_line" in h.values[0] for h in self._plan.happenings)
        rest = match_wire(taken, ledger.sent, ledger.between, not slow)
        may_have_more = port_died or summary["error"] is not None
        require(not rest or may_have_more, "on the line, but not reported:", len(rest), rest[:1])
        if port_died:
            return
        wire, sent_bytes = summary["wire"], sum(map(len, (*ledger.sent, *ledger.between)))
        require(wire["sent_bytes"] == sent_bytes, "sent_bytes:", wire["sent_bytes"], sent_bytes)
        # What arrives while an injected fault holds the port broken is lost.
        received_bytes = line.received_bytes
        breaks = any(h.kind == "inject" and "disconnect" in h.values[0] for h in self._plan.happenings)
        is_counted = wire["received_bytes"] <= received_bytes if breaks else wire["received_bytes"] == received_bytes
        require(is_counted or self._plan.link == "can", "received_bytes:", wire["received_bytes"], received_bytes)
        require(wire["tx_dropped"] == ledger.between_dropped, "tx_dropped:", wire, ledger.between_dropped)
        require(not ledger.made, "no result of acknowledgements or housekeeping:", len(ledger.made))
        if isinstance(line, SimulatedLine) and line.connections and not line.connections[-1].lost and not slow:
            last = line.connections[-1]
            undelivered = sum(map(len, last.taken)) - len(last.delivered) - last.discarded
            require(undelivered <= wire["unread_bytes"], "unread_bytes:", wire["unread_bytes"], undelivered)
        commands = summary["commands"]
        verdicts = +ledger.verdicts
        rejected = {word: count for word, count in sorted(verdicts.items()) if word != "accepted"}
        require((commands["accepted"], commands["rejected"]) == (verdicts["accepted"], rejected), "commands:", commands)
        if not ledger.statuses:
            return
        if not any(h.kind == "inject" and "reordered" in h.values[0] for h in self._plan.happenings):
            self._check_device()
            if isinstance(line, SimulatedBus):
                self._check_frames(line)
            elif not slow:
                self._check_host(line)

    def _check_recording(self, ending: str) -> None:
        """The recording holds each report, whatever the end; and flies again, packet by packet."""
        is_cut = self._disk is not None and self._disk.refused
        require((self._recorder.error is not None) == is_cut, "an error of the recording:", self._recorder.error)
        recording = Recording(self._recording)
        packets = recording.packets()
        recorded = [*zip(packets.shot.tolist(), packets.status.tolist(), packets.payload, strict=True)]
        reports = self._ledger.reports
        if is_cut or ending == "killed":
            reports = reports[: len(recorded)]
        else:
            require(recording.is_whole, "the recording lacks its end")
        require(recorded == reports, "recorded and reported:", len(recorded), len(reports))
        require(not recording.damage or is_cut or ending == "killed", "damage:", recording.damage)
        if recorded:
            result = recompute(recording)
            require(result.different == 0, "recomputed:", result)

    def _check_device(self) -> None:
        """Modes and numbers in the packets are those of another, plain model of the device."""
        ledger, period_ns = self._ledger, self._model.period_ns
        accepted = [each for each in ledger.commands if each[0].verdict == "accepted"]
        # A command counts from its time, even where the shots after it had gone out already.
        commanded, number = self._expected_device(), 0
        device, left = deepcopy(commanded), deque(each for each in accepted if each[1] is not None)
        self._numbers: list[int] = []
        for skipped in range(ledger.shots[0][0]):  # before the first truth
            device.advance(skipped * period_ns)
            number += device.measures and skipped % device.divisor == 0
        for shot, silent, _, payload in ledger.shots:
            restarts = device.restarts
            while left and left[0][1] is not None and left[0][1] <= shot:
                _apply(commanded, left.popleft()[0])
                device = deepcopy(commanded)
            device.advance(shot * period_ns)
            if device.restarts != restarts:
                number = 0
            expects = device.measures and shot % device.divisor == 0
            require(expects != silent, "silent or not, but the device is", device.mode, device.divisor, shot)
            if payload:
                message = self._host.decode(payload)[-1]
                mode = self._host.mode(message) or device.mode
                shown = number if message.shot is None else message.shot
                require((mode, shown) == (device.mode, number), "mode and number:", shot, mode, shown, device.mode, number)
            self._numbers.append(number)
            number += not silent
        for time_ns, payload, count in ledger.housekeeping:
            (mode,) = {mode for block in self._host.decode(payload) if (mode := self._host.mode(block))}
            possible = {self._mode_at(time_ns, accepted[:n]) for n in range(count, len(accepted) + 1)}
            require(mode in possible, "housekeeping of another mode:", time_ns, mode, possible)

    def _expected_device(self) -> ExpectedDevice:
        timing, faults = self._scenario.timing, events_of_faults(self._ledger.faults)
        return ExpectedDevice(self._scenario.device, timing.rate_hz, self._ledger.waited_ns, faults)

    def _mode_at(self, time_ns: int, commands: list[tuple[ReceivedCommand, int | None]]) -> str:
        device = self._expected_device()
        for command, _ in commands:
            if command.time_ns <= time_ns:
                _apply(device, command)
        device.advance(time_ns)
        return device.mode

    def _check_frames(self, bus: SimulatedBus) -> None:
        """What the host has received: the frames of whole sets, in order."""
        frames = (frame for each in bus.connections for payload in each.taken for frame in unpack_frames(payload))
        require(all(frame in frames for frame in bus.frames), "received by the host, but not sent in this order")

    def _check_host(self, line: SimulatedLine) -> None:
        """What the host has decoded: whole packets, in order, all that have reached it."""
        receiver = SerialReceiver(default_interface())
        connections, decoded = line.connections, list[int]()
        for connection in connections:
            received = receiver.receive(bytes(connection.delivered) + b"\0")
            decoded += [each.header["shot"] for each in received if isinstance(each, Message)]
        shots = zip(self._ledger.shots, self._numbers, strict=True)
        expected = [number for (_, _, sent, _), number in shots if sent]
        rest = iter(expected)
        require(all(each in rest for each in decoded), "decoded by the host, but not sent in this order")
        is_cut = any(each.lost or each.discarded or each.cut for each in connections)
        if connections and not is_cut:
            require(decoded == expected, "sent, but not decoded:", len(expected), len(decoded))
            counters = receiver.counters
            bad = counters.bad_crc + counters.bad_stuffing + counters.bad_length + counters.skipped_bytes
            require(bad == 0, "damaged on the way:", counters)


def _apply(device: ExpectedDevice, command: ReceivedCommand) -> None:
    device.advance(command.time_ns)
    device.command(str(command.command), command.values)


def simulate(plan: Plan) -> Result:
    """Run a plan.

    Raises:
        Failure: an invariant does not hold.
    """
    with tempfile.TemporaryDirectory(prefix="simulated-", dir="/dev/shm") as folder:
        return Simulation(plan, Path(folder)).run()
