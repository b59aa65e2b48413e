"""Faults ordered in flight: read from a socket, checked, answered, and passed on to the shots."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Self

from lidar_emu.device.rules import Event, all_events
from lidar_emu.errors import Finding, InputError, one_line, reason_of
from lidar_emu.faults.encoder import FaultyEncoder, faulty_encoder
from lidar_emu.runtime.change_queue import Change, Changes
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.feed.datagram_socket import DatagramSocket
from lidar_emu.runtime.link_faults import link_order
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions
from lidar_emu.scenario.faults import Dropout, FalseAlarms, LinkFault, Lost, ScheduledFault
from lidar_emu.scenario.faults.injected import read_fault, shifted
from lidar_emu.scenario.schema import Scenario
from lidar_emu.session import Session
from lidar_emu.shots.model import Model
from lidar_emu.transports.spec import Kind
from lidar_emu.wire import Encoder

_MOST_FAULTS = 256
_OWNER_ONLY = 0o177
_MARGIN = 2
_ONE_OF_EACH = (Dropout(kind="dropout"), Lost(kind="lost"), FalseAlarms(kind="false_alarms", noise_db=1.0))

Order = ScheduledFault | LinkFault


class FaultInjector:
    """Takes orders on a Unix datagram socket that only its owner can write to; its path is given back at the end.

    An order is a fault in YAML; the answer, for whoever has a name to be answered by, is a JSON object:
    {"accepted": true, "fault": 3, "kind": "dropout"}, or {"accepted": false, "reason": text}.

    Args:
        path: of the socket; that of a dead process is taken over.
        scenario: what is flown.
        model: of the scenario.
        encoder: how it goes onto the link.
        options: how it is run.
        packet_bytes: the longest packet without faults, as the port takes it, and the longest that it can take.
        order_of_port: takes the port's own faults.
        order_of_device: takes what is done to the device, all of it, whenever that changes.
        changes: where shots find what they are to follow.
        observers: told of every fault, once shots have it.

    Raises:
        InputError: the socket cannot be made, or somebody listens there.
    """

    def __init__(
        self,
        path: str,
        scenario: Scenario,
        model: Model,
        encoder: Encoder,
        options: RunOptions,
        packet_bytes: tuple[int, int],
        order_of_port: Callable[[dict[str, Any]], None],
        order_of_device: Callable[[tuple[Event, ...]], None],
        changes: Changes,
        observers: Sequence[Observer],
    ) -> None:
        self._scenario = self._asked = scenario
        self._model, self._encoder = model, encoder
        self._pace, self._can = options.pace, options.port.kind is Kind.CAN
        self._packet_bytes, self._room_bytes = packet_bytes
        self._order_of_port, self._order_of_device = order_of_port, order_of_device
        self._changes, self._observers = changes, observers
        self._ordered: list[dict[str, Any]] = []
        self._refused = 0
        self._clock = Clock()
        self._warm_up()
        self._socket = _private_socket(path, self._clock)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def hear(self) -> None:
        """Check and answer what has arrived."""
        for data, arrived_ns, sender in self._socket.receive():
            answer = self._answer(data, arrived_ns)
            self._refused += not answer["accepted"]
            self._socket.answer(json.dumps(answer).encode(), sender)

    def to_json(self) -> dict[str, Any]:
        """Under the names of the summary file; faults as a scenario would state them, to fly them again."""
        return {"ordered": self._ordered, "refused": self._refused}

    def _answer(self, data: bytes, arrived_ns: int) -> dict[str, Any]:
        number, begun_ns = len(self._asked.faults), self._clock.now_ns()
        try:
            fault = read_fault(data.decode(errors="replace"))
            if number >= _MOST_FAULTS:
                raise InputError("faults", None, Finding(f"{number} of them"), f"allowed: {_MOST_FAULTS}")
            trial = _with_fault(self._asked, fault)
            self._prepared(trial)
            self._link_order(trial, number, fault)
        except InputError as error:
            return {"accepted": False, "reason": one_line(str(error))}
        self._asked = trial
        # What has been built here once will be built again before the first shot that has it.
        now_ns = self._clock.now_ns()
        ready_ns = now_ns + _MARGIN * (now_ns - begun_ns)
        self._changes.add(Change(partial(self._apply, number, fault), max(arrived_ns, ready_ns)))
        return {"accepted": True, "fault": number, "kind": fault.kind}

    def _apply(self, number: int, fault: Order, session: Session) -> None:
        shot = session.next_shot
        ordered = shifted(fault, shot * self._scenario.timing.period_ns * 1e-9)
        self._scenario = _with_fault(self._scenario, ordered)
        events = all_events(self._scenario.device, self._scenario.faults)
        session.use_faults(*self._prepared(self._scenario), events)
        self._order_of_device(events)
        order = self._link_order(self._scenario, number, ordered)
        if order is not None:
            self._order_of_port(order)
        self._ordered.append(ordered.model_dump(mode="json", exclude_defaults=True) | {"kind": ordered.kind})
        for observer in self._observers:
            observer.on_fault_injected(number, ordered, shot)

    def _prepared(self, scenario: Scenario) -> tuple[Model, FaultyEncoder | None]:
        """What a session needs for a scenario that differs in its faults."""
        model = self._model.with_faults(scenario.faults)
        faulty = faulty_encoder(scenario, self._encoder, self._can)
        if faulty is not None and faulty.longest(self._packet_bytes) > self._room_bytes:
            found = Finding(f"packets of {faulty.longest(self._packet_bytes)} bytes")
            raise InputError(scenario.name, "faults", found, f"allowed in flight: {self._room_bytes} bytes")
        return model, faulty

    def _warm_up(self) -> None:
        """Import and compile before the run what orders may need."""
        for fault in _ONE_OF_EACH:
            with suppress(InputError):
                self._prepared(_with_fault(self._scenario, fault))

    def _link_order(self, scenario: Scenario, number: int, fault: Order) -> dict[str, Any] | None:
        if not isinstance(fault, LinkFault):
            return None
        return link_order(scenario, number, fault, None, self._pace, self._can)


def _with_fault(scenario: Scenario, fault: Order) -> Scenario:
    return scenario.model_copy(update={"faults": [*scenario.faults, fault]})


def _private_socket(path: str, clock: Clock) -> DatagramSocket:
    before = os.umask(_OWNER_ONLY)
    try:
        return DatagramSocket(f"unix:{path}", clock)
    except (OSError, ValueError) as error:
        allowed = f"{reason_of(error)}; allowed: a path where nothing is"
        raise InputError("--control", None, path, allowed) from None
    finally:
        os.umask(before)
