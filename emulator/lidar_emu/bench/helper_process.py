"""A helper process that measures beside a flight: the parent's side.

It receives JSON lines on its standard input, the control pipe, replies with JSON lines, and at its end
writes a line with the number of its arrays and then the arrays, one after the other, all of the same length.
"""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import suppress
from typing import Any, Self

import numpy as np

from lidar_emu.errors import RunError
from lidar_emu.numerics.arrays import IntArray


class Helper:
    """The parent's side. Leaving its context ends the process.

    Args:
        name: one of `helper_programs`, run in a session of its own, where no terminal's Ctrl-C reaches it.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "lidar_emu.bench.helper_programs", name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._control = self._process.stdin
        self._replies = self._process.stdout

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._replies.close()
        self._close_control()

    def send(self, **message: object) -> None:
        """Send it a message."""
        self._control.write(json.dumps(message).encode() + b"\n")
        self._control.flush()

    def receive(self) -> dict[str, Any]:
        """Its next message.

        Raises:
            RunError: it ended without one.
        """
        line = self._replies.readline()
        if not line:
            raise RunError(f"lidar_emu.bench.{self._name} ended (exit code {self._process.wait()})")
        reply: dict[str, Any] = json.loads(line)
        return reply

    def finish(self) -> list[IntArray]:
        """Close the control pipe and receive the measured arrays."""
        self._close_control()
        count = self.receive()["arrays"]
        values = np.frombuffer(self._replies.read(), dtype=np.int64)
        return list(values.reshape(count, -1))

    def _close_control(self) -> None:
        with suppress(BrokenPipeError):  # it ended before it received the last message
            self._control.close()
