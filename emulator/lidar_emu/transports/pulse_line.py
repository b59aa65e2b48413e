"""Synchronisation pulses (PPS) on a modem input line: when the last one began.

Source: serial_core.c and usb-serial.c of Linux, where TIOCMIWAIT waits until one of the lines changes.
"""

from __future__ import annotations

import fcntl
import os
import termios
import threading
from collections.abc import Callable
from contextlib import suppress

MODEM_LINES = {"cts": termios.TIOCM_CTS, "dsr": termios.TIOCM_DSR, "cd": termios.TIOCM_CD}
"""Input lines, with their bits."""


class PulseLine:
    """Watches a line in its own thread, which records the time at once, whatever else the process does.

    A pulse begins with a rising edge. It is missed if it ends before the thread reads the line; milliseconds suffice.

    Args:
        terminal: descriptor of the port; it must stay open until `close`.
        line: `cd`, `cts` or `dsr`.
        now_ns: instant of the monotonic clock.
    """

    def __init__(self, terminal: int, line: str, now_ns: Callable[[], int]) -> None:
        self.last_ns: int | None = None
        """When the last pulse began, on the monotonic clock; None: there was none."""
        self._port, self._line, self._now_ns = terminal, line, now_ns
        # Only an edge, or the end of the process, releases a waiting thread. A duplicate descriptor keeps it from
        # waiting on another file that takes the same number later.
        self._terminal = os.dup(terminal)
        self._failure: list[str] = []
        self._closed = False
        threading.Thread(target=self._watch, daemon=True).start()

    def take_failure(self) -> list[str]:
        """Why pulses are no longer detected, once; empty while they are."""
        failure, self._failure = self._failure, []
        return failure

    def close(self) -> None:
        """Stop, and let other programs open the port although the thread may still have it open."""
        self._closed = True
        with suppress(OSError):
            fcntl.flock(self._port, fcntl.LOCK_UN)

    def _watch(self) -> None:
        bit = MODEM_LINES[self._line]
        try:
            while not self._closed:
                fcntl.ioctl(self._terminal, termios.TIOCMIWAIT, bit)
                edge_ns = self._now_ns()
                if modem_bits(self._terminal) & bit:
                    self.last_ns = edge_ns
        except OSError as error:
            self._failure = [f"no pulses from line {self._line}: {error.strerror}"]
        finally:
            os.close(self._terminal)


def modem_bits(terminal: int) -> int:
    """The state of all modem lines.

    Raises:
        OSError: the port has none.
    """
    state = bytearray(4)
    fcntl.ioctl(terminal, termios.TIOCMGET, state)
    return int.from_bytes(state, "little")
