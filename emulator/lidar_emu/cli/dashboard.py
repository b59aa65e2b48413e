"""A picture of a run on the terminal, drawn by a process of its own: whoever flies never waits for a terminal."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from types import TracebackType
from typing import Any, Self

from lidar_emu.cli.output import say
from lidar_emu.runtime.clock import Clock

_EVERY_NS = 200_000_000
_END_LIMIT_S = 2.0


def has_terminal() -> bool:
    """Whether somebody looks on, at something that can be drawn on."""
    return sys.stdout is not None and sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


class Dashboard:
    """The other end of the process that draws. What it cannot take at once is left out; if it dies, lines are printed.

    It has no part in Ctrl-C: it ends, and leaves the terminal as it was, when this end is closed or gone.
    """

    def __init__(self) -> None:
        self._clock = Clock()
        self._next_ns = 0
        self._unsaid: list[str] = []
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "lidar_emu.cli.dashboard_screen", str(theirs.fileno())],
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
        """Give the terminal back."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        try:
            self._process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:  # it hangs in a terminal that takes nothing
            self._process.kill()
            self._process.wait()
        self._give_up()

    @property
    def is_due(self) -> bool:
        """Whether the picture is old enough to be drawn anew."""
        return self._socket is not None and self._clock.now_ns() >= self._next_ns

    def show(self, picture: dict[str, Any]) -> None:
        """Draw this, as `dashboard_screen.picture` has it."""
        self._next_ns = self._clock.now_ns() + _EVERY_NS
        self._catch_up()
        self._send(picture)

    def say(self, text: str) -> None:
        """A line that stays, above the picture."""
        self._unsaid.append(text)
        self._catch_up()
        if self._socket is None:
            self._give_up()

    def _catch_up(self) -> None:
        while self._unsaid and self._send({"say": self._unsaid[0]}):
            self._unsaid.pop(0)

    def _send(self, told: dict[str, Any]) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.send(json.dumps(told).encode())
        except BlockingIOError:
            return False
        except OSError:
            self._socket.close()
            self._socket = None
            self._give_up()
            return False
        return True

    def _give_up(self) -> None:
        """Nobody draws: what was to be said is printed."""
        unsaid, self._unsaid = self._unsaid, []
        for text in unsaid:
            say(text)
