"""A simulated flight computer: it sends commands, whole or not."""

from __future__ import annotations

import json
from typing import Any

from lidar_emu.transports.frames import unpack_frames
from lidar_protocol import CanReceiver, Host, Message, SerialReceiver, default_interface
from lidar_protocol.packet import Received
from simulated_runtime.can_bus import SimulatedBus
from simulated_runtime.line import SimulatedLine
from simulated_runtime.scheduler import Scheduler

_SPLIT_NS = 3_000_000


class SimulatedHost:
    """A host on a byte link or a bus."""

    def __init__(self, line: SimulatedLine | SimulatedBus, scheduler: Scheduler) -> None:
        self._line, self._scheduler = line, scheduler
        self._interface = default_interface()
        self._encoder = Host(self._interface)
        self._bytes, self._frames = SerialReceiver(self._interface), CanReceiver(self._interface)
        self._sequence = 0
        assert self._interface.commands is not None
        self._steps = self._interface.commands.sequence_steps

    def command(self, name: str, arguments: dict[str, Any], how: str) -> None:
        """Send a command: `whole`, `split` into two parts, `twice`, `torn`, or with a number `skipped`."""
        if how == "skipped":
            self._sequence += 1
        values = {"sequence": self._sequence % self._steps, **arguments}
        self._sequence += 1
        if isinstance(self._line, SimulatedBus):
            for _ in range({"torn": 0, "twice": 2}.get(how, 1)):
                self._line.command(self._encoder.encode_command_frame(name, **values))
            return
        data, line = self._encoder.encode_command(name, **values), self._line
        middle = len(data) // 2
        match how:
            case "split":
                line.send_bytes(data[:middle])
                self._scheduler.at(self._scheduler.now_ns + _SPLIT_NS, lambda: line.send_bytes(data[middle:]))
            case "torn":
                line.send_bytes(data[:middle])
            case "twice":
                line.send_bytes(data + data)
            case _:
                line.send_bytes(data)

    def decode(self, payload: bytes) -> list[Received]:
        """What is in a whole payload."""
        if isinstance(self._line, SimulatedBus):
            frames = unpack_frames(payload)
            return [each for f in frames for each in self._frames.receive(f.can_id, f.data, f.is_fd)]
        return self._bytes.receive(payload)

    def mode(self, received: Received) -> str | None:
        """The mode in a message; None: it states none."""
        values = received.header if isinstance(received, Message) else received.values
        return self._interface.word("mode", int(values["mode"] or 0)) if "mode" in values else None

    def beside(self, name: str, arguments: dict[str, Any]) -> bytes:
        """The datagram of a command that comes beside the port."""
        return json.dumps({"commands": [[name, arguments]]}).encode()
