"""Two polled devices and a host on one pair of wires: what anybody sends, all others hear."""

from __future__ import annotations

import select
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

import pytest
from programs import Program, read_summary
from waiting import LIMIT_S, eventually

from lidar_protocol import (
    Acknowledge,
    Host,
    Housekeeping,
    Message,
    Received,
    SerialReceiver,
    default_interface,
)

INTERFACE = default_interface()
Start = Callable[..., Program]


class Wires:
    """The host, which passes on what each device sends."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self.devices: list[socket.socket] = []
        self.heard: list[Received] = []
        self._receivers: dict[socket.socket, SerialReceiver] = {}

    def attach(self) -> None:
        """Wait for one more device."""
        self.devices.append(self._server.accept()[0])
        self._receivers[self.devices[-1]] = SerialReceiver(INTERFACE)

    def send(self, unit: int, number: int) -> None:
        """Poll a device; all hear it."""
        for device in self.devices:
            device.sendall(Host(INTERFACE, unit).encode_command("no_op", sequence=number))

    def listen(self, timeout_s: float) -> list[Received]:
        """Messages that came within a time, whole ones; what is sent is passed on to the other devices."""
        heard: list[Received] = []
        for device in select.select(self.devices, [], [], timeout_s)[0]:
            data = device.recv(65536)
            heard += self._receivers[device].receive(data)
            for other in self.devices:
                if other is not device:
                    with suppress(OSError):  # its flight has ended
                        other.sendall(data)
        self.heard += heard
        return heard

    def answered(self, unit: int, number: int) -> bool:
        """Whether a device has acknowledged a poll; meanwhile it is listened to."""
        return any(
            isinstance(message, Acknowledge) and (message.unit, message.sequence) == (unit, number)
            for message in self.listen(0.05)
        )

    def close(self) -> None:
        for each in (*self.devices, self._server):
            each.close()


@pytest.fixture
def wires() -> Iterator[Wires]:
    made = Wires()
    yield made
    made.close()


def test_each_device_speaks_when_it_is_asked_and_once(start: Start, wires: Wires, tmp_path: Path) -> None:
    runs = []
    for unit in (0, 1):
        flight = ["descent.yaml", "--set", "wire.polled=true", "--set", f"wire.unit={unit}"]
        runs.append(start("run", *flight, "--port", wires.port, "--summary", f"{unit}.json"))
        wires.attach()
    polls = 30
    for number in range(polls):
        for unit in (0, 1):
            wires.send(unit, number)
            eventually(lambda unit=unit, number=number: wires.answered(unit, number), LIMIT_S)  # type: ignore[misc]
            wires.listen(0.02)
            assert {message.unit for message in wires.heard} == ({0} if (number, unit) == (0, 0) else {0, 1})
    for run in runs:
        run.signal(signal.SIGINT)
        run.wait()
    for unit in range(2):
        summary = read_summary(tmp_path / f"{unit}.json")
        mine = [message for message in wires.heard if message.unit == unit]
        shots = [message.shot for message in mine if isinstance(message, Message)]
        assert (
            sum(isinstance(message, Acknowledge) for message in mine)
            == summary["commands"]["accepted"]
            == polls
        )
        assert (
            sum(isinstance(message, Housekeeping) for message in mine) == summary["housekeeping"]["sent"] > 0
        )
        assert shots == sorted(set(shots)), "a measurement is sent once"
        assert 0 < len(shots) <= polls
        assert summary["shots"]["sent"] == len(shots)
        assert summary["shots"]["not_polled"] == summary["shots"]["due"] - len(shots) > 0
        assert summary["lateness"]["count"] == summary["shots"]["late"] == 0


def test_a_flight_ends_although_nobody_polls(start: Start, wires: Wires, tmp_path: Path) -> None:
    flight = [
        "descent.yaml",
        "--duration",
        "1",
        "--set",
        "wire.polled=true",
        "--set",
        "timing.late_after_s=1000",
    ]
    run = start("run", *flight, "--port", wires.port, "--summary", "s.json")
    wires.attach()
    assert run.wait() == 1
    assert "none of 20 shots was sent: 20 not polled" in run.err
    assert read_summary(tmp_path / "s.json")["shots"]["not_polled"] == 20


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--pace", "max"], "wire.polled: must be false with --pace max"),
        (["--set", "wire.interface=mute.toml"], "wire.polled: requires an interface with the command no_op"),
    ],
)
def test_what_cannot_be_polled_is_refused(
    options: list[str], said: str, start: Start, tmp_path: Path
) -> None:
    text = (files("lidar_protocol") / "default.toml").read_text(encoding="utf-8")
    (tmp_path / "mute.toml").write_text(text.replace("no_op", "ping"))
    run = start("run", "descent.yaml", "--set", "wire.polled=true", *options)
    assert run.wait() == 2
    assert said in run.err
    assert run.err.count("\n") == 1
