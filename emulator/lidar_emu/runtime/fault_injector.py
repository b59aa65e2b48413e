"""Faults injected in flight: received on a socket, checked, answered, and returned as changes to upcoming shots.

The socket takes commands to the device as well, which are passed on.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from typing import Any, Self

from lidar_emu.device.state import TimedEvent, events_of
from lidar_emu.errors import Finding, InputError, one_line, reason_of
from lidar_emu.faults.packets import FaultyEncoder, faulty_encoder
from lidar_emu.runtime.change_queue import Change, Execute, NamedCommand
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.scenario.faults import LinkFault, ScheduledFault
from lidar_emu.scenario.faults import packets as kinds
from lidar_emu.scenario.faults.beams import Dropout, FalseAlarms
from lidar_emu.scenario.faults.packets import Lost
from lidar_emu.scenario.load import read_fault, shifted
from lidar_emu.scenario.schema import Scenario
from lidar_emu.session import Session
from lidar_emu.shots.model import Model
from lidar_emu.transports.sockets import DatagramSocket
from lidar_emu.transports.spec import Kind
from lidar_emu.wire import Encoder

_CAN_ONLY = (kinds.ErrorFrames, kinds.BusOff)


def port_faults(scenario: Scenario, end_ns: int | None, pace: Pace, can: bool) -> list[dict[str, Any]]:
    """The faults of the port, each a `PortFault` as a mapping for JSON; empty if the scenario has none.

    Args:
        end_ns: end of the run, in scenario time; None: unknown.
        can: whether the link is a CAN bus.

    Raises:
        InputError: a fault cannot happen on this link, or the pace is not `Pace.WALL`.
    """
    return [
        port_fault(scenario, number, fault, end_ns, pace, can)
        for number, fault in enumerate(scenario.faults)
        if isinstance(fault, kinds.LinkFault)
    ]


def port_fault(
    scenario: Scenario, number: int, fault: kinds.LinkFault, end_ns: int | None, pace: Pace, can: bool
) -> dict[str, Any]:
    """Fault `number` of the scenario; arguments and errors as for `port_faults`."""
    from lidar_emu.transports.faulty_link import PortFault

    where = f"faults.{number}.kind"
    if pace is not Pace.WALL:
        found = Finding(f"{fault.kind} at pace {pace}")
        raise InputError(scenario.name, where, found, "use --pace wall: port faults follow the wall clock")
    if isinstance(fault, _CAN_ONLY) and not can:
        found = Finding(f"{fault.kind} on a byte link")
        raise InputError(scenario.name, where, found, "use a CAN bus")
    from_ns, to_ns = round(fault.from_s * 1e9), end_ns if fault.to_s is None else round(fault.to_s * 1e9)
    return asdict(PortFault(number, fault.kind, from_ns, to_ns, scenario.seed, _rate(fault)))


def _rate(fault: kinds.LinkFault) -> float:
    match fault:
        case kinds.SlowLine():
            return float(fault.bit_rate)
        case kinds.Babble():
            return float(fault.bytes_per_s)
        case kinds.ErrorFrames():
            return fault.rate_hz
    return 0.0


_MOST_FAULTS = 256
_OWNER_ONLY = 0o177
_MARGIN = 2
_ONE_OF_EACH = (Dropout(kind="dropout"), Lost(kind="lost"), FalseAlarms(kind="false_alarms", noise_db=1.0))

InjectableFault = ScheduledFault | LinkFault


class FaultInjector:
    """Receives faults on a Unix datagram socket that only its owner can write to; the path is removed at the end.

    A datagram holds a fault in YAML; the answer, if the sender has an address, is a JSON object:
    {"accepted": true, "fault": 3, "kind": "dropout"}, or {"accepted": false, "reason": text}. Commands come as
    {"commands": [["set_pattern", {"pattern": 1}]]}; the answer is {"results": [{"verdict": text, "time_s": number}]},
    or {"reason": text}.

    Args:
        path: path of the socket; the socket of a dead process is replaced.
        scenario, model, encoder, options: what the run flies, and how.
        packet_bytes: the longest packet without faults, as the port takes it, and the longest that it can take.
        inject_into_port: takes a fault of the port.
        inject_into_device: takes all events of the device whenever an injected fault changes them.
        observers: receive every fault, with the first shot that has it.
        machine: where the run runs.

    Raises:
        InputError: the socket cannot be made, or another process owns the path.
    """

    def __init__(
        self,
        path: str,
        scenario: Scenario,
        model: Model,
        encoder: Encoder,
        options: RunOptions,
        packet_bytes: tuple[int, int],
        inject_into_port: Callable[[dict[str, Any]], None],
        inject_into_device: Callable[[tuple[TimedEvent, ...]], None],
        observers: Sequence[Observer],
        machine: Machine,
    ) -> None:
        self._scenario = self._accepted = scenario
        self._model, self._encoder = model, encoder
        self._pace, self._can = options.pace, options.port.kind is Kind.CAN
        self._packet_bytes, self._room_bytes = packet_bytes
        self._inject_into_port, self._inject_into_device = inject_into_port, inject_into_device
        self._observers = observers
        self._injected: list[dict[str, Any]] = []
        self._refused = 0
        self._clock = machine.clock
        for fault in _ONE_OF_EACH:  # imports and compiles before the run what faults may need
            with suppress(InputError):
                self._build(_with_fault(scenario, fault))
        self._socket = _private_socket(path, machine)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def receive(self, execute: Execute) -> list[Change]:
        """Check and answer what has arrived; return the accepted faults, and the changes that commands make."""
        changes: list[Change] = []
        for data, arrived_ns, sender in self._socket.receive():
            if (commands := _commands_in(data)) is not None:
                made, answer = _executed(execute, commands, arrived_ns)
                changes += made
            else:
                try:
                    change, answer = self._accept(data, arrived_ns)
                    changes.append(change)
                except InputError as error:
                    self._refused += 1
                    answer = {"accepted": False, "reason": one_line(str(error))}
            self._socket.answer(json.dumps(answer).encode(), sender)
        return changes

    def to_json(self) -> dict[str, Any]:
        """The faults, by the keys of the summary file, as a scenario would state them."""
        return {"injected": self._injected, "refused": self._refused}

    def _accept(self, data: bytes, arrived_ns: int) -> tuple[Change, dict[str, Any]]:
        number, begun_ns = len(self._accepted.faults), self._clock.now_ns()
        fault = read_fault(data.decode(errors="replace"))
        if number >= _MOST_FAULTS:
            found = Finding(f"{number} faults already")
            raise InputError("faults", None, found, "restart the run to inject more")
        trial = _with_fault(self._accepted, fault)
        self._build(trial)
        self._port_fault(trial, number, fault)
        self._accepted = trial
        # All this is built once more when the fault is applied: allow twice the time that it took here.
        now_ns = self._clock.now_ns()
        ready_ns = now_ns + _MARGIN * (now_ns - begun_ns)
        change = Change(partial(self._apply, number, fault), max(arrived_ns, ready_ns))
        return change, {"accepted": True, "fault": number, "kind": fault.kind}

    def _apply(self, number: int, fault: InjectableFault, session: Session) -> None:
        shot = session.next_shot
        injected = shifted(fault, shot * self._scenario.timing.period_ns * 1e-9)
        self._scenario = _with_fault(self._scenario, injected)
        events = events_of(self._scenario.faults)
        session.use_faults(*self._build(self._scenario), events)
        self._inject_into_device(events)
        of_port = self._port_fault(self._scenario, number, injected)
        if of_port is not None:
            self._inject_into_port(of_port)
        self._injected.append(
            injected.model_dump(mode="json", exclude_defaults=True) | {"kind": injected.kind}
        )
        for observer in self._observers:
            observer.on_fault_injected(number, injected, shot)

    def _build(self, scenario: Scenario) -> tuple[Model, FaultyEncoder | None]:
        model = self._model.with_faults(scenario.faults)
        faulty = faulty_encoder(scenario, self._encoder, self._can)
        if faulty is not None and faulty.longest(self._packet_bytes) > self._room_bytes:
            found = Finding(f"packets of {faulty.longest(self._packet_bytes)} bytes")
            remedy = f"in flight, there is room for {self._room_bytes}"
            raise InputError(scenario.name, "faults", found, remedy)
        return model, faulty

    def _port_fault(self, scenario: Scenario, number: int, fault: InjectableFault) -> dict[str, Any] | None:
        if not isinstance(fault, LinkFault):
            return None
        return port_fault(scenario, number, fault, None, self._pace, self._can)


def _commands_in(data: bytes) -> list[NamedCommand] | None:
    """The commands in a datagram; None if it holds something else, or they have another form."""
    try:
        commands = json.loads(data)["commands"]
        if all(isinstance(name, str) and _are_arguments(values) for name, values in commands):
            return [(name, values) for name, values in commands]
    except (ValueError, TypeError, KeyError, RecursionError):
        pass
    return None


def _are_arguments(values: Any) -> bool:
    return isinstance(values, dict) and all(type(each) in (int, float, str) for each in values.values())


def _executed(
    execute: Execute, commands: list[NamedCommand], arrived_ns: int
) -> tuple[list[Change], dict[str, Any]]:
    try:
        changes, results = execute(commands, arrived_ns)
    except InputError as error:
        return [], {"reason": one_line(error.remedy)}
    return changes, {"results": results}


def _with_fault(scenario: Scenario, fault: InjectableFault) -> Scenario:
    return scenario.model_copy(update={"faults": [*scenario.faults, fault]})


def _private_socket(path: str, machine: Machine) -> DatagramSocket:
    before = os.umask(_OWNER_ONLY)
    try:
        return machine.datagram_socket(f"unix:{path}")
    except (OSError, ValueError) as error:
        remedy = f"must be a path that does not exist yet: {reason_of(error)}"
        raise InputError("--control", None, path, remedy) from None
    finally:
        os.umask(before)
