"""The two pipes between the model process and the port process: one JSON object per line.

The model process sends commands through the control pipe; its end of file means that the process has closed it or
died. The port process sends its status through the other pipe, and never waits for a reader.
"""

from __future__ import annotations

import json
import os
from typing import Any

from lidar_emu.runtime.clock import Clock

_PIPE_BYTES = 65536
_CLOSING_LIMIT_NS = 1_000_000_000


class ControlPipe:
    """The reading end of the control pipe, in the port process.

    Args:
        descriptor: descriptor of the pipe.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = b""

    def receive_first(self) -> dict[str, Any] | None:
        """Wait for the first message; None at the end of file."""
        while b"\n" not in self._buffer:
            data = os.read(self._descriptor, _PIPE_BYTES)
            if not data:
                return None
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        return message

    def receive(self) -> tuple[list[dict[str, Any]], bool]:
        """The messages that have arrived, and whether the pipe is still open."""
        data = os.read(self._descriptor, _PIPE_BYTES)
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        return [json.loads(line) for line in lines], bool(data)


class StatusPipe:
    """The writing end of the status pipe, in the port process.

    Args:
        descriptor: descriptor of the pipe; set non-blocking here.
        clock: limits the wait in `close`.
    """

    def __init__(self, descriptor: int, clock: Clock) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._clock = clock
        self._unsent = b""

    def send(self, **message: object) -> None:
        """Send a message that must arrive; `flush` completes it where the pipe is full."""
        self._unsent += json.dumps(message).encode() + b"\n"
        self.flush()

    def send_if_idle(self, **message: object) -> bool:
        """Send a message that may be lost; False if it is, because earlier messages still wait for room."""
        if self._unsent:
            return False
        self.send(**message)
        return True

    def flush(self) -> None:
        """Write as much of the pending messages as the pipe takes."""
        while self._unsent:
            try:
                written = os.write(self._descriptor, self._unsent)
            except BlockingIOError:
                return
            except BrokenPipeError:  # the reader has closed its end
                written = len(self._unsent)
            self._unsent = self._unsent[written:]

    @property
    def writable(self) -> list[int]:
        """Descriptors to wait on before the next `flush`; empty if no message is pending."""
        return [self._descriptor] if self._unsent else []

    def close(self) -> None:
        """Give the reader one second to take the pending messages."""
        deadline_ns = self._clock.now_ns() + _CLOSING_LIMIT_NS
        while self._unsent and self._clock.now_ns() < deadline_ns:
            self._clock.wait(deadline_ns, [], self.writable)
            self.flush()
