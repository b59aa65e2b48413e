"""Pseudo terminals: the device's end, with a name of the user's choice, at once or as a UART would send."""

from __future__ import annotations

import os
import select
import socket
import termios
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from lidar_emu.transports.byte_channel import DescriptorChannel, queued_bytes
from lidar_emu.transports.link import LinkLostError

_TERMINALS = Path("/dev/pts")
_CLAIM_BYTES = 90  # the name of a socket has at most 107
UART_BUFFER_BYTES = 4096
"""Transmit buffer of a serial driver."""
READER_BUFFER_BYTES = 4095
"""What Linux holds for the reader of a terminal (N_TTY_BUF_SIZE less one). More would wait before it, uncounted."""


def unlink_stale(link: Path) -> None:
    """Remove a symbolic link to a terminal of a process that was killed.

    The system gives the terminal's name to the next one, of anybody: the link is stale as well if its terminal is
    younger than itself, and no running process has claimed it. (A terminal looks younger once its mode was changed.)
    """
    with suppress(OSError):
        if link.is_symlink() and link.readlink().parent == _TERMINALS:
            if not link.exists():
                link.unlink()
            elif link.stat().st_ctime_ns > link.lstat().st_mtime_ns and (claim := _claim(link)):
                claim.close()
                link.unlink()


def _claim(link: Path) -> socket.socket | None:
    """A socket that claims the link while its process lives; None if another process has claimed it."""
    name = os.fsencode(link.parent.resolve() / link.name)
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(b"\0lidar-emu:" + name[-_CLAIM_BYTES:])
    except OSError:
        claim.close()
        return None
    return claim


class PtyChannel(DescriptorChannel):
    """The master end of a pseudo terminal made here; `description` is the path that a program opens.

    Args:
        link: symbolic link to the terminal, made here and removed at the end; a stale one is replaced. None: no link.

    Raises:
        OSError: the link cannot be made.
    """

    def __init__(self, link: Path | None = None) -> None:
        if link is not None:
            # First, as the new terminal may have the name of the one that is gone.
            unlink_stale(link)
        master, slave = os.openpty()
        # Cooked mode would swallow control bytes and echo the rest.
        tty.setraw(slave)
        self._path, self._link = os.ttyname(slave), link
        # Once this process has closed the slave end, a hang-up means that no other program has it open.
        os.close(slave)
        super().__init__(master, self._path if link is None else str(link), lambda: os.close(master))
        self._had_reader = False
        self._claim = None if link is None else _claim(link)
        if link is not None:
            try:
                link.symlink_to(self._path)
            except OSError:
                self.close()
                raise

    def close(self) -> None:
        with suppress(OSError):
            if self._link is not None and self._link.readlink() == Path(self._path):
                self._link.unlink()
        if self._claim is not None:
            self._claim.close()
        super().close()

    def connected(self) -> bool:
        hung_up = any(happened & select.POLLHUP for _, happened in self._poll.poll(0))
        if hung_up and self._had_reader:
            # Unread bytes are stale for the next reader, which starts with a whole packet.
            self._rest = b""
            self._on_slave(lambda slave: termios.tcflush(slave, termios.TCIFLUSH))
        self._had_reader = not hung_up
        return not hung_up

    def send(self, payload: bytes) -> bool:
        # Once there is a reader, it is not checked for again before each packet.
        return (self._had_reader or self.connected()) and super().send(payload)

    def receive(self) -> bytes:
        ready = self._poll.poll(0)
        if not any(happened & select.POLLIN for _, happened in ready):
            return b""
        try:
            return self._read()
        except LinkLostError:  # EIO: the reader has closed its end, and another may open it
            return b""

    def unread(self) -> int:
        # Closing the master discards what the reader has not fetched.
        counts = [0]
        self._on_slave(lambda slave: counts.append(queued_bytes(slave, termios.FIONREAD)))
        return len(self._rest) + counts[-1]

    def _write(self, data: bytes) -> int:
        try:
            return super()._write(data)
        except LinkLostError:
            return 0

    def _on_slave(self, action: Callable[[int], object]) -> None:
        with suppress(OSError, termios.error):
            slave = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                action(slave)
            finally:
                os.close(slave)


class PtyUart(PtyChannel):
    """A pty whose bytes leave at the bit rate, through a transmit buffer, to a reader with an input buffer. While that
    is full the line rests, as with flow control, so that nothing that was sent is lost.

    Args:
        link: see `PtyChannel`.
        byte_ns: time of a byte on the line.
        now_ns: instant of the monotonic clock.
    """

    def __init__(self, link: Path | None, byte_ns: float, now_ns: Callable[[], int]) -> None:
        super().__init__(link)
        self._byte_ns, self._now_ns = byte_ns, now_ns
        self._buffer = bytearray()
        self._sent_ns = 0.0

    @property
    def pending(self) -> bool:
        return bool(self._buffer)

    @property
    def writable(self) -> int | None:
        return None if self._buffer else super().writable

    def connected(self) -> bool:
        connected = super().connected()
        if not connected:
            self._buffer.clear()
        return connected

    def send(self, payload: bytes) -> bool:
        if not (self._had_reader or self.connected()):
            return False
        self.flush()
        if len(self._buffer) + len(payload) > UART_BUFFER_BYTES:
            return False
        if not self._buffer:
            self._sent_ns = self._now_ns()
        self._buffer += payload
        return True

    def flush(self) -> bool:
        if self._buffer:
            now_ns = self._now_ns()
            due = int((now_ns - self._sent_ns) / self._byte_ns)
            room = READER_BUFFER_BYTES - super().unread()
            written = self._write(bytes(self._buffer[: max(0, min(due, room))])) if due and room > 0 else 0
            del self._buffer[:written]
            self._sent_ns = self._sent_ns + written * self._byte_ns if written == due else float(now_ns)
        return not self._buffer

    def unread(self) -> int:
        return super().unread() + len(self._buffer)
