"""A terminal read in a thread of its own, so that nobody else waits for what the kernel does with its input.

Whoever polls or reads a terminal first waits for the kernel's worker that carries the bytes to it (n_tty_poll flushes
the port's work), and that worker has no more than ordinary priority: on a busy machine a host that says 1000 commands a
second made shots late by milliseconds. Behind a pipe it does not.
"""

from __future__ import annotations

import fcntl
import os
import select
import threading
from contextlib import suppress

_PIPE_BYTES = 4096
_F_SETPIPE_SZ = 1031
_LEAVE_S = 1.0


class TtyReader:
    """Passes a terminal's input on into a small pipe; the pipe ends where the terminal does.

    Args:
        terminal: its descriptor, non-blocking. It must stay open until `close`.
    """

    def __init__(self, terminal: int) -> None:
        self._terminal = terminal
        self.descriptor, self._pipe = os.pipe()
        """To read from."""
        with suppress(OSError):  # a short one: what waits in it is heard late
            fcntl.fcntl(self._pipe, _F_SETPIPE_SZ, _PIPE_BYTES)
        self._leave_out, self._leave = os.pipe()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading, and give the pipe back."""
        os.close(self.descriptor)  # whoever waits for room in it is freed
        os.close(self._leave)
        self._thread.join(_LEAVE_S)

    def _carry(self) -> None:
        poll = select.poll()
        poll.register(self._terminal, select.POLLIN)
        poll.register(self._leave_out, 0)  # told of a hang-up all the same
        with suppress(OSError):
            while not any(descriptor == self._leave_out for descriptor, _ in poll.poll()):
                try:
                    data = os.read(self._terminal, _PIPE_BYTES)
                except BlockingIOError:
                    continue
                if not data:
                    break
                os.write(self._pipe, data)
        os.close(self._pipe)
        os.close(self._leave_out)
