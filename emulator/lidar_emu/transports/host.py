"""The host's end of a link: what `listen` reads, and `send` writes to."""

from __future__ import annotations

import select

from lidar_emu.errors import InputError
from lidar_emu.transports.frames import Frame, unpack_frames
from lidar_emu.transports.link import LinkLostError, PortChannel
from lidar_emu.transports.opening import Opener, host_opener
from lidar_emu.transports.spec import Kind, PortSpec

_POLL_S = 0.01


class _Host:
    """A port that is read with a time limit, and reopened when it is lost."""

    def __init__(self, open_channel: Opener) -> None:
        self._open = open_channel
        self._channel: PortChannel | None = open_channel()
        self.description = self._channel.description
        """Name of the port; for a pty, the path that the other side opens."""
        self.times_lost = 0
        """Number of breaks of the link."""

    def close(self) -> None:
        """Close the port."""
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def write(self, payload: bytes) -> bool:
        """Hand over a whole command (CAN: frame records); False while the line is full or broken."""
        if self._channel is None and not self._reopen():
            return False
        assert self._channel is not None
        try:
            return self._channel.send(payload)
        except LinkLostError:
            self.times_lost += 1
            self.close()
            return False

    def _receive(self, timeout_s: float) -> bytes:
        """Bytes received within `timeout_s`; empty if none, or if the link is broken."""
        if self._channel is None and not self._reopen():
            _pause(timeout_s)
            return b""
        try:
            return self._wait_and_receive(timeout_s)
        except LinkLostError:
            self.times_lost += 1
            self.close()
            return b""

    def _wait_and_receive(self, timeout_s: float) -> bytes:
        channel = self._channel
        assert channel is not None
        if channel.connected() and channel.readable is not None:
            select.select([channel.readable], [], [], timeout_s)
            return channel.receive()
        left_s = timeout_s
        while True:
            data = channel.receive()
            if data or left_s <= 0:
                return data
            _pause(min(_POLL_S, left_s))
            left_s -= _POLL_S

    def _reopen(self) -> bool:
        try:
            self._channel = self._open()
        except InputError:
            return False
        return True


class ByteHost(_Host):
    """The host's end of a byte link."""

    def read(self, timeout_s: float) -> bytes:
        """Bytes that have arrived; waits at most `timeout_s` for the first. Empty if there are none."""
        return self._receive(timeout_s)


class CanHost(_Host):
    """The host's end of a CAN bus."""

    def read(self, timeout_s: float) -> list[Frame]:
        """Frames that have arrived; waits at most `timeout_s` for the first. Empty if there are none."""
        return unpack_frames(self._receive(timeout_s))


def open_host(spec: PortSpec) -> ByteHost | CanHost:
    """Open the host's end: make a pty, whose `description` is the path for the device's `--port`, or bind a UDP port.

    Raises:
        InputError: it cannot be opened, or `spec` names no port.
    """
    end = CanHost if spec.kind is Kind.CAN else ByteHost
    return end(host_opener(spec))


def _pause(duration_s: float) -> None:
    select.select([], [], [], max(0.0, duration_s))
