"""A simulated flight computer: it sends commands, whole or not."""

from __future__ import annotations

import json
from typing import Any

from lidar_protocol import Host, default_interface
from simulated_runtime.line import SimulatedLine
from simulated_runtime.scheduler import Scheduler

_SPLIT_NS = 3_000_000


class SimulatedHost:
    """A host on a byte link."""

    def __init__(self, line: SimulatedLine, scheduler: Scheduler) -> None:
        self._line, self._scheduler = line, scheduler
        self._encoder = Host(default_interface())
        self._sequence = 0
        self._steps = default_interface().commands.sequence_steps  # type: ignore[union-attr]

    def command(self, name: str, arguments: dict[str, Any], how: str) -> None:
        """Send a command: `whole`, `split` into two parts, `twice`, `torn`, or with a number `skipped`."""
        if how == "skipped":
            self._sequence += 1
        data = self._encoder.encode_command(name, sequence=self._sequence % self._steps, **arguments)
        self._sequence += 1
        middle = len(data) // 2
        match how:
            case "split":
                self._line.send(data[:middle])
                self._scheduler.at(self._scheduler.now_ns + _SPLIT_NS, lambda: self._line.send(data[middle:]))
            case "torn":
                self._line.send(data[:middle])
            case "twice":
                self._line.send(data + data)
            case _:
                self._line.send(data)

    def beside(self, name: str, arguments: dict[str, Any]) -> bytes:
        """The datagram of a command that comes beside the port."""
        return json.dumps({"commands": [[name, arguments]]}).encode()
