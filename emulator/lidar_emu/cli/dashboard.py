"""Live display on the terminal, drawn by a separate process so that a run never waits for the terminal."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from types import TracebackType
from typing import Any, Self

from lidar_emu.cli.output import print_line
from lidar_emu.runtime.clock import Clock

_EVERY_NS = 200_000_000
_END_LIMIT_S = 2.0


def has_terminal() -> bool:
    """Whether standard output is a terminal that can show a live display."""
    return sys.stdout is not None and sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


class Dashboard:
    """Client of the display process: drops updates that cannot be sent at once; prints lines directly if it has died.

    The process ignores Ctrl-C: it ends, and restores the terminal, when this end of the socket is closed.
    """

    def __init__(self) -> None:
        self._clock = Clock()
        self._next_ns = 0
        self._pending: list[str] = []
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "lidar_emu.cli.dashboard_process", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        ours.setblocking(False)
        self._socket: socket.socket | None = ours

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Restore the terminal."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        try:
            self._process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:  # the process hangs in a blocked terminal
            self._process.kill()
            self._process.wait()
        self._print_pending()

    @property
    def is_due(self) -> bool:
        """Whether it is time for an update."""
        return self._socket is not None and self._clock.now_ns() >= self._next_ns

    def show(self, content: dict[str, Any]) -> None:
        """Update the display; the content is described at `dashboard_process.render`."""
        self._next_ns = self._clock.now_ns() + _EVERY_NS
        self._flush()
        self._send(content)

    def print_line(self, text: str) -> None:
        """Print a line that stays, above the display."""
        self._pending.append(text)
        self._flush()
        if self._socket is None:
            self._print_pending()

    def _flush(self) -> None:
        while self._pending and self._send({"line": self._pending[0]}):
            self._pending.pop(0)

    def _send(self, message: dict[str, Any]) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.send(json.dumps(message).encode())
        except BlockingIOError:
            return False
        except OSError:
            self._socket.close()
            self._socket = None
            self._print_pending()
            return False
        return True

    def _print_pending(self) -> None:
        """Print the pending lines without the display."""
        pending, self._pending = self._pending, []
        for text in pending:
            print_line(text)
