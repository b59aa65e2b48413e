"""Commands by `send`'s own means, to devices on a bus in memory."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import pytest

from lidar_emu.cli import messages
from lidar_emu.cli.messages import NO_ACKNOWLEDGEMENT, SENT, CommandClient
from lidar_emu.device.commands import DeviceTimeline
from lidar_emu.device.modes import initial
from lidar_emu.device.state import device_constants
from lidar_emu.runtime.change_queue import ReceivedCommand
from lidar_emu.runtime.command_handler import CommandHandler, DownlinkEncoder
from lidar_emu.runtime.observer import Observer
from lidar_emu.scenario.device import DeviceBehaviour
from lidar_emu.transports.can_port import open_can
from lidar_emu.transports.opening import CanHost
from lidar_emu.transports.spec import Kind, PortSpec
from lidar_protocol import default_interface

INTERFACE = default_interface()
_buses = count()


class Unit(Observer):
    """A device on a bus, that hears and answers; and what it has heard."""

    def __init__(self, spec: PortSpec, unit: int) -> None:
        self._channel = open_can(spec)
        constants = device_constants(DeviceBehaviour(), 20.0, 4, 2, 1.0)
        encoder = DownlinkEncoder(INTERFACE, unit, True)
        self.received: list[ReceivedCommand] = []
        device = DeviceTimeline(constants, initial(constants))
        self._handler = CommandHandler(encoder, device, lambda _: True, self._channel.send, [self])
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def on_command(self, command: ReceivedCommand, shot: int | None) -> None:  # noqa: ARG002
        self.received.append(command)

    def _listen(self) -> None:
        for now_ns in count(0, 1_000_000):
            if self._over.wait(0.0005):
                return
            if data := self._channel.receive():
                for change in self._handler.receive(data, now_ns, now_ns):
                    assert change.applied is not None
                    change.applied(None, None)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._channel.close()


@pytest.fixture
def spec() -> PortSpec:
    return PortSpec(Kind.CAN, interface="virtual", channel=f"commander{next(_buses)}")


@pytest.fixture
def unit(spec: PortSpec) -> Iterator[Callable[[int], Unit]]:
    """Put one more unit on the bus."""
    units: list[Unit] = []

    def add(number: int) -> Unit:
        units.append(Unit(spec, number))
        return units[-1]

    yield add
    for each in units:
        each.close()


@pytest.fixture
def commander(spec: PortSpec) -> Iterator[Callable[..., CommandClient]]:
    hosts: list[CanHost] = []

    def connect(number: int, timeout_s: float = 20.0) -> CommandClient:
        hosts.append(CanHost(lambda: open_can(spec)))
        return CommandClient(hosts[-1], INTERFACE, number, timeout_s)

    yield connect
    for host in hosts:
        host.close()


def test_units_on_one_bus_each_hear_their_own(
    unit: Callable[[int], Unit], commander: Callable[..., CommandClient]
) -> None:
    units = {number: unit(number) for number in (0, 3)}
    hosts = {number: commander(number) for number in units}
    for host in hosts.values():
        greeting = host.synchronise()
        assert greeting is not None
        assert greeting.verdict == "accepted"
    assert hosts[3].send("set_rate_hz", {"rate_hz": 10}).verdict == "accepted"
    assert hosts[0].send("enable_beams", {"beams": 5}).verdict == "accepted"
    assert hosts[3].send("set_pattern", {"pattern": 7}).verdict == "out_of_range"
    # A slow machine repeats the first command.
    reported = {
        number: list(dict.fromkeys((heard.command, heard.sequence) for heard in each.received))
        for number, each in units.items()
    }
    assert reported == {
        0: [("no_op", 0), ("enable_beams", 1)],
        3: [("no_op", 0), ("set_rate_hz", 1), ("set_pattern", 2)],
    }


def test_a_unit_that_is_not_there_does_not_answer(
    unit: Callable[[int], Unit], commander: Callable[..., CommandClient]
) -> None:
    present = unit(0)
    assert commander(5, timeout_s=0.2).send("no_op", {}).verdict == NO_ACKNOWLEDGEMENT
    assert commander(0).send("no_op", {}).verdict == "accepted"
    assert len(present.received) == 1


class BootingHost(CanHost):
    """A link whose device does not receive the first two commands."""

    written = 0

    def write(self, data: bytes) -> bool:
        self.written += 1
        return self.written <= 2 or super().write(data)


def test_a_device_that_boots_is_asked_again(
    unit: Callable[[int], Unit], spec: PortSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(messages, "_REPEAT_S", 0.02)
    unit(0)
    host = BootingHost(lambda: open_can(spec))
    greeting = CommandClient(host, INTERFACE, 0, 20.0).synchronise()
    assert greeting is not None
    assert greeting.verdict == "accepted"
    assert host.written >= 3
    host.close()


def test_where_the_bus_has_no_answers_a_command_counts_as_sent(spec: PortSpec) -> None:
    assert INTERFACE.can is not None
    silent = replace(INTERFACE, can=replace(INTERFACE.can, acknowledge=None))
    host = CanHost(lambda: open_can(spec))
    assert CommandClient(host, silent, 0, 20.0).send("no_op", {}).verdict == SENT
    host.close()
