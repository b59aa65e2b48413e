"""Whole packets over a non-blocking descriptor: a serial device, a pty, a socket.

A process that polls or reads a terminal first waits for the kernel worker that delivers the bytes (n_tty_poll flushes
the port's work queue), and that worker has ordinary priority: on a busy machine a host that sent 1000 commands a second
delayed shots by milliseconds. Behind a pipe there is no such delay.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct
import termios
import threading
from collections.abc import Callable
from contextlib import suppress
from errno import EIO, ENODEV, ENXIO

from lidar_emu.transports.link import LinkLostError, PortChannel

_READ_BYTES = 4096
_INT = struct.Struct("i")


class DescriptorChannel(PortChannel):
    """A byte link over a descriptor.

    Args:
        descriptor: open for reading and writing; set non-blocking here.
        input_descriptor: descriptor to read from; None: `descriptor`.
    """

    gone = "the other end has gone"
    """Why the link is lost where nothing more can be read."""

    def __init__(
        self,
        descriptor: int,
        description: str,
        close: Callable[[], None],
        input_descriptor: int | None = None,
    ) -> None:
        super().__init__(description)
        self._descriptor = descriptor
        self._input = descriptor if input_descriptor is None else input_descriptor
        for each in (self._descriptor, self._input):
            os.set_blocking(each, False)
        self._close = close
        self._rest = b""
        self._poll = select.poll()
        self._poll.register(self._input, select.POLLIN)

    @property
    def pending(self) -> bool:
        return bool(self._rest)

    @property
    def readable(self) -> int | None:
        return self._input

    @property
    def writable(self) -> int | None:
        return self._descriptor

    def send(self, payload: bytes) -> bool:
        if not self.flush():
            return False
        written = self._write(payload)
        if written:
            self._rest = payload[written:]
        return written > 0 or not payload

    def flush(self) -> bool:
        if self._rest:
            self._rest = self._rest[self._write(self._rest) :]
        return not self._rest

    def receive(self) -> bytes:
        for _, happened in self._poll.poll(0):
            data = self._read() if happened & select.POLLIN else b""
            if not data:
                # The descriptor of a vanished device is readable, and reads return nothing.
                raise LinkLostError(self.gone)
            return data
        return b""

    def unread(self) -> int:
        # A socket counts the system's overhead too.
        return len(self._rest) + queued_bytes(self._descriptor)

    def close(self) -> None:
        with suppress(OSError, termios.error):
            self._close()

    def _write(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._lost(error) from None

    def _read(self) -> bytes:
        try:
            return os.read(self._input, _READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._lost(error) from None

    def _lost(self, error: OSError) -> LinkLostError:
        # A device that vanished fails in more ways than one.
        has_gone = error.errno in (EIO, ENODEV, ENXIO)
        return LinkLostError(self.gone if has_gone else error.strerror or str(error))


def queued_bytes(descriptor: int, request: int = termios.TIOCOUTQ) -> int:
    """Bytes in a queue of the descriptor, by default the output queue; 0 if it has none, or is closed."""
    count = bytearray(_INT.size)
    with suppress(OSError):
        fcntl.ioctl(descriptor, request, count)
    return int(_INT.unpack(count)[0])


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
