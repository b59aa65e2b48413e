"""Adapters for which python-can itself would wait: slcan on a serial line, and a bus behind a network.

Their bytes go out by a channel of ours, which takes whole lines or nothing.
"""

from __future__ import annotations

import errno
from contextlib import suppress
from typing import Any

from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.spec import PortSpec

_FRAME_PATIENCE_S = 1.0


class _Patient:
    """Stands in for a serial port or a socket whose writing would wait for a full line, or spin."""

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


def patient_slcan(bus: Any, spec: PortSpec) -> DescriptorChannel:
    """Write an slcan bus' lines by the channel that this returns."""
    if spec.fd:
        bus.set_bitrate(spec.bitrate, spec.data_bitrate)
    port = bus.serialPortOrig
    lines = DescriptorChannel(port.fileno(), str(spec), port.close)
    bus.serialPortOrig = _Patient(port, lines)
    return lines


def patient_remote(bus: Any, spec: PortSpec) -> DescriptorChannel:
    """Write the messages of python-can-remote's bus by the channel that this returns."""
    protocol, sock = bus.remote_protocol, bus.socket
    lines = DescriptorChannel(sock.fileno(), str(spec), sock.close)
    # A message of which the end does not come is waited for no longer than this.
    sock.settimeout(_FRAME_PATIENCE_S)
    protocol._ws.socket = _Patient(sock, lines)

    def take_leave() -> None:
        """Its own would wait for the server's answer for ever."""
        with suppress(Exception):
            protocol.close()
        lines.close()
        bus._is_shutdown = True

    bus.shutdown = take_leave
    return lines
