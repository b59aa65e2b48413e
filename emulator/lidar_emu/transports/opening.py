"""Opening either end of the port that a `PortSpec` names, at the start and after a break."""

from __future__ import annotations

import os
import select
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from lidar_emu.errors import Finding, InputError
from lidar_emu.transports.frames import Frame, unpack_frames
from lidar_emu.transports.link import LinkLostError, PortChannel
from lidar_emu.transports.spec import Kind, PortSpec

Opener = Callable[[], PortChannel]


def opener(
    spec: PortSpec, loopback_descriptor: int | None = None, now_ns: Callable[[], int] | None = None
) -> Opener:
    """A function that opens the device's end, at the start and after a break.

    Args:
        loopback_descriptor: one end of the in-memory link, which the channel owns; required for that kind alone.
        now_ns: instant of the monotonic clock; required for pulses alone.

    The function raises:
        InputError: the port cannot be opened.
    """
    return _reopening(partial(_open, spec, loopback_descriptor, now_ns), spec)


def _reopening(open_port: Opener, spec: PortSpec) -> Opener:
    # The system reuses the number of a closed pty for the next terminal that is opened.
    if spec.kind is Kind.LOOPBACK or (spec.path or spec.channel).startswith("/dev/pts/"):
        return _once(open_port, spec)
    return open_port


def _once(open_channel: Opener, spec: PortSpec) -> Opener:
    attempts = iter([open_channel])

    def open_the_first_time() -> PortChannel:
        for attempt in attempts:
            return attempt()
        raise InputError("--port", None, str(spec), "a lost pty or loopback cannot be reopened")

    return open_the_first_time


def _open(spec: PortSpec, loopback_descriptor: int | None, now_ns: Callable[[], int] | None) -> PortChannel:
    match spec.kind:
        case Kind.CAN:
            from lidar_emu.transports.can_port import open_can

            return open_can(spec)
        case Kind.UDP:
            from lidar_emu.transports.udp_port import open_udp

            return open_udp(spec)
        case Kind.TCP | Kind.UNIX:
            from lidar_emu.transports.sockets import open_listening

            return open_listening(spec)
    if spec.kind is not Kind.LOOPBACK:
        from lidar_emu.transports.serial_port import open_byte_channel

        return open_byte_channel(spec, now_ns)
    from lidar_emu.transports.byte_channel import DescriptorChannel

    if loopback_descriptor is None:
        remedy = "pass a device, a URL, udp:PORT or pty, or --interface for a CAN bus"
        raise InputError("--port", None, Finding("missing"), remedy)
    return DescriptorChannel(loopback_descriptor, str(spec), lambda: os.close(loopback_descriptor))


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
        channel = self._opened()
        try:
            return channel is not None and channel.send(payload)
        except LinkLostError:
            self._lose()
            return False

    def _receive(self, timeout_s: float) -> bytes:
        """Bytes received within `timeout_s`; empty if none, or if the link is broken."""
        if (channel := self._opened()) is None:
            _pause(timeout_s)
            return b""
        try:
            if channel.connected() and channel.readable is not None:
                select.select([channel.readable], [], [], timeout_s)
                return channel.receive()
            left_s = timeout_s
            while not (data := channel.receive()) and left_s > 0:
                _pause(min(_POLL_S, left_s))
                left_s -= _POLL_S
            return data
        except LinkLostError:
            self._lose()
            return b""

    def _opened(self) -> PortChannel | None:
        if self._channel is None:
            with suppress(InputError):
                self._channel = self._open()
        return self._channel

    def _lose(self) -> None:
        self.times_lost += 1
        self.close()


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
        InputError: it cannot be opened, another program has it open (a serial device or pty), or `spec` names no port.
    """
    if spec.kind is Kind.CAN:
        return CanHost(opener(spec))
    if spec.kind is Kind.UDP:
        from lidar_emu.transports.udp_port import open_udp

        return ByteHost(lambda: open_udp(spec, is_host=True))
    if spec.kind in (Kind.TCP, Kind.UNIX):
        from lidar_emu.transports.sockets import open_stream_host

        return ByteHost(lambda: open_stream_host(spec))
    if spec.kind is Kind.LOOPBACK:
        return ByteHost(opener(spec))
    from lidar_emu.transports.serial_port import open_serial_host

    return ByteHost(_reopening(partial(open_serial_host, spec), spec))


def _pause(duration_s: float) -> None:
    select.select([], [], [], max(0.0, duration_s))
