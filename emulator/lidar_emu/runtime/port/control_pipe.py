"""What the parent says to the port's process, and whether it still lives: JSON lines from a pipe."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import Any

_PIPE_BYTES = 65536


class ControlPipe:
    """The reading end. At its end of file the parent has hung up, or is no more.

    Args:
        descriptor: of the pipe.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = b""

    def next_blocking(self) -> dict[str, Any] | None:
        """The first line; None at the end of file."""
        while b"\n" not in self._buffer:
            data = os.read(self._descriptor, _PIPE_BYTES)
            if not data:
                return None
            self._buffer += data
        return self._take()

    def obey(self, act: Callable[[dict[str, Any]], None]) -> bool:
        """Pass on all lines that have arrived; False at the end of file."""
        data = os.read(self._descriptor, _PIPE_BYTES)
        self._buffer += data
        while b"\n" in self._buffer:
            act(self._take())
        return bool(data)

    def _take(self) -> dict[str, Any]:
        line, _, self._buffer = self._buffer.partition(b"\n")
        order: dict[str, Any] = json.loads(line)
        return order
