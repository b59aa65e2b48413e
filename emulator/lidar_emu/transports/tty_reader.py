"""Reads a terminal in its own thread, so that the sender never waits for the kernel's terminal input.

A process that polls or reads a terminal first waits for the kernel worker that delivers the bytes (n_tty_poll flushes
the port's work queue), and that worker has ordinary priority: on a busy machine a host that sent 1000 commands a second
delayed shots by milliseconds. Behind a pipe there is no such delay.
"""

from __future__ import annotations

import fcntl
import os
import select
import threading
from contextlib import suppress

_PIPE_BYTES = 4096
_F_SETPIPE_SZ = 1031
_STOP_LIMIT_S = 1.0


class TtyReader:
    """Copies the input of a terminal into a small pipe; the pipe ends when the terminal does.

    Args:
        terminal: its descriptor, non-blocking. It must stay open until `close`.
    """

    def __init__(self, terminal: int) -> None:
        self._terminal = terminal
        self.descriptor, self._pipe = os.pipe()
        """Descriptor of the pipe's reading end."""
        with suppress(OSError):  # keep the pipe short: bytes that wait in it are late
            fcntl.fcntl(self._pipe, _F_SETPIPE_SZ, _PIPE_BYTES)
        self._stop_out, self._stop = os.pipe()
        self._thread = threading.Thread(target=self._copy, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading, and close the pipe."""
        os.close(self.descriptor)  # releases a thread that waits for room
        os.close(self._stop)
        self._thread.join(_STOP_LIMIT_S)

    def _copy(self) -> None:
        poll = select.poll()
        poll.register(self._terminal, select.POLLIN)
        poll.register(self._stop_out, 0)  # a hang-up is reported in any case
        with suppress(OSError):
            while not any(descriptor == self._stop_out for descriptor, _ in poll.poll()):
                try:
                    data = os.read(self._terminal, _PIPE_BYTES)
                except BlockingIOError:
                    continue
                if not data:
                    break
                os.write(self._pipe, data)
        os.close(self._pipe)
        os.close(self._stop_out)
