"""Adapters on which python-can itself would block: slcan on a serial line, and a bus behind a network.

Their bytes are written through a channel that takes whole lines or nothing.
"""

from __future__ import annotations

import errno
from contextlib import suppress
from typing import Any

from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.spec import PortSpec

_MESSAGE_TIMEOUT_S = 1.0


class _NonBlocking:
    """Replaces a serial port or a socket that would block, or spin, while the line is full."""

    def __init__(self, original: Any, lines: DescriptorChannel) -> None:
        self._original = original
        self._lines = lines
        self.write_timeout: float | None = None

    def write(self, line: bytes) -> int:
        if not self._lines.send(line):
            raise BlockingIOError(errno.EAGAIN, "the line is full")
        return len(line)

    def sendall(self, line: bytes) -> None:
        self.write(bytes(line))

    def flush(self) -> None:
        self._lines.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._original, name)


def nonblocking_slcan(bus: Any, spec: PortSpec) -> DescriptorChannel:
    """Make an slcan bus write its lines through the returned channel."""
    if spec.fd:
        bus.set_bitrate(spec.bitrate, spec.data_bitrate)
    port = bus.serialPortOrig
    lines = DescriptorChannel(port.fileno(), str(spec), port.close)
    bus.serialPortOrig = _NonBlocking(port, lines)
    return lines


def nonblocking_remote(bus: Any, spec: PortSpec) -> DescriptorChannel:
    """Make a bus of python-can-remote write its messages through the returned channel."""
    protocol, sock = bus.remote_protocol, bus.socket
    lines = DescriptorChannel(sock.fileno(), str(spec), sock.close)
    # The end of a message must follow within this time.
    sock.settimeout(_MESSAGE_TIMEOUT_S)
    protocol._ws.socket = _NonBlocking(sock, lines)

    def shut_down() -> None:
        """The library's own function would wait forever for the server's answer."""
        with suppress(Exception):
            protocol.close()
        lines.close()
        bus._is_shutdown = True

    bus.shutdown = shut_down
    return lines
