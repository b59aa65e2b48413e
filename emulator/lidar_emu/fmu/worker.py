"""The device behind an FMU, a process of its own: the vehicle's state in, measurements out, over a socket.

`lidar.c` starts it with the socket as standard input. A request is the time and the values of the inputs; a reply is a
head (status, number of bytes), then the values of the outputs and the bytes that the device sent, or the text of an
error. All are of this machine's byte order.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lidar_emu.embedded_device import EmbeddedDevice
from lidar_emu.errors import Finding, InputError, RunError
from lidar_emu.fmu.model_description import given_variables, measured_variables, start_values
from lidar_emu.wire import interface_named
from lidar_protocol import Interface, Message, SerialReceiver

_HEAD = struct.Struct("=II")
_FINE, _FAILED = 0, 1
_MOST_TEXT_BYTES = 900


class Instance:
    """A device, and the outputs of its newest packet.

    Args:
        scenario: keys of a scenario with live truth.

    Raises:
        InputError: the scenario cannot be used.
    """

    def __init__(self, scenario: Mapping[str, Any]) -> None:
        self._device = EmbeddedDevice(scenario)
        interface: Interface = interface_named(
            self._device.scenario.wire.interface, "scenario", "wire.interface"
        )
        self._receiver = SerialReceiver(interface)
        self._packets = self._rejected = 0
        self._newest: list[float] = []

    def step(self, time_s: float, values: Sequence[float], beam_count: int) -> tuple[list[float], bytes]:
        """Take the vehicle's state at a time, and return the outputs after the packets that are due by then.

        The bytes are the packets that the device sent since the previous call, as on a serial line.

        Args:
            time_s: scenario time, later than in the previous call.
            values: values of `given_variables`.
            beam_count: beams of the outputs.

        Raises:
            InputError: the state or the time cannot be used.
        """
        known, *state = values
        if not all(map(math.isfinite, (time_s * 1e9, *state))):
            names = [scalar.name for variable in given_variables() for scalar in variable.scalars()]
            bad = [
                f"{name} is {value}"
                for name, value in zip(names, values, strict=True)
                if not math.isfinite(value)
            ]
            found = Finding("; ".join(bad) or f"the time is {time_s}")
            raise InputError("inputs", None, found, "pass finite numbers")
        time_ns = round(time_s * 1e9)
        self._device.set_truth(
            time_ns,
            state[0:3],
            state[3:6],
            state[9:13],
            state[13:16],
            acceleration_site_mps2=state[6:9] if known else None,
        )
        due = self._device.advance(time_ns)
        for packet in due:
            messages = [each for each in self._receiver.receive(packet.payload) if isinstance(each, Message)]
            if packet.kind == "shot" and not messages:
                self._rejected += 1
            for message in messages:
                self._packets += 1
                self._newest = _values(message, packet.due_ns * 1e-9, beam_count)
        newest = self._newest or start_values(measured_variables(beam_count)[2:])
        return [self._packets, self._rejected, *newest], b"".join(packet.payload for packet in due)


def _values(message: Message, sent_s: float, beam_count: int) -> list[float]:
    """The outputs after the counters."""
    shot, time_ns = message.shot, message.time_ns
    rows: list[Mapping[str, Any]] = [*message.beams[:beam_count], *[{}] * (beam_count - len(message.beams))]
    range_valid = [bool(row.get("range_valid")) for row in rows]
    speed_valid = [bool(row.get("speed_valid")) for row in rows]
    return [
        -1.0 if shot is None else shot,
        0.0 if time_ns is None else time_ns * 1e-9,
        sent_s,
        *_where(range_valid, [row.get("range_m") for row in rows]),
        *_where(speed_valid, [row.get("closing_speed_mps") for row in rows]),
        *map(float, range_valid),
        *map(float, speed_valid),
    ]


def _where(valid: Sequence[bool], values: Sequence[float | None]) -> list[float]:
    """The valid values; 0 elsewhere."""
    return [
        value if is_valid and value is not None else 0.0
        for is_valid, value in zip(valid, values, strict=True)
    ]


def serve(link: socket.socket, resources: Path) -> None:
    """Reply to requests until the FMU closes the socket.

    Args:
        link: connected stream socket.
        resources: folder with `scenario.json`.
    """
    request = struct.Struct(f"={1 + len(start_values(given_variables()))}d")
    try:
        stored = json.loads((resources / "scenario.json").read_text(encoding="utf-8"))
        instance, beam_count = Instance(stored["scenario"]), int(stored["beam_count"])
    except (InputError, RunError, OSError, ValueError) as error:
        _send(link, _FAILED, str(error).encode())
        return
    _send(link, _FINE, b"")
    while len(data := link.recv(request.size, socket.MSG_WAITALL)) == request.size:
        time_s, *values = request.unpack(data)
        try:
            outputs, sent = instance.step(time_s, values, beam_count)
        except (InputError, RunError) as error:
            _send(link, _FAILED, str(error).encode())
        else:
            _send(link, _FINE, struct.pack(f"={len(outputs)}d", *outputs) + sent)


def _send(link: socket.socket, status: int, data: bytes) -> None:
    if status != _FINE:
        data = data[:_MOST_TEXT_BYTES]
    link.sendall(_HEAD.pack(status, len(data)) + data)


if __name__ == "__main__":
    try:
        serve(socket.socket(fileno=0), Path(sys.argv[1]))
    except (KeyboardInterrupt, BrokenPipeError, ConnectionResetError):
        sys.exit(1)
