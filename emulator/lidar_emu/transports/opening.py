"""Opening either end of the port that a `PortSpec` names, at the start and after a break."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from lidar_emu.errors import Finding, InputError
from lidar_emu.transports.link import PortChannel
from lidar_emu.transports.spec import Kind, PortSpec

Opener = Callable[[], PortChannel]


def opener(
    spec: PortSpec, loopback_descriptor: int | None = None, now_ns: Callable[[], int] | None = None
) -> Opener:
    """A function that opens the device's end, at the start and after a break.

    Args:
        spec: the port.
        loopback_descriptor: one end of the in-memory link; required for that kind alone.
        now_ns: instant of the monotonic clock; required for pulses alone.

    The function raises:
        InputError: the port cannot be opened.
    """
    if spec.kind is Kind.LOOPBACK:
        return _once(lambda: _open_loopback(loopback_descriptor), spec)
    open_port = _OPENERS.get(spec.kind) or partial(_open_bytes, now_ns)
    # The system reuses the number of a closed pty for the next terminal that is opened.
    if (spec.path or spec.channel).startswith("/dev/pts/"):
        return _once(lambda: open_port(spec), spec)
    return lambda: open_port(spec)


def host_opener(spec: PortSpec) -> Opener:
    """A function that opens the host's end, which differs from the device's on sockets; errors as for `opener`."""
    if spec.kind is Kind.UDP:
        from lidar_emu.transports.udp_port import open_udp_host

        return lambda: open_udp_host(spec)
    if spec.kind in (Kind.TCP, Kind.UNIX):
        from lidar_emu.transports.stream_socket import open_stream_host

        return lambda: open_stream_host(spec)
    return opener(spec)


def _once(open_channel: Opener, spec: PortSpec) -> Opener:
    attempts = iter([open_channel])

    def open_the_first_time() -> PortChannel:
        for attempt in attempts:
            return attempt()
        raise InputError("--port", None, str(spec), "a lost pty or loopback cannot be reopened")

    return open_the_first_time


def _open_loopback(descriptor: int | None) -> PortChannel:
    from lidar_emu.transports.serial_port import open_loopback

    if descriptor is None:
        remedy = "pass a device, a URL, udp:PORT or pty, or --interface for a CAN bus"
        raise InputError("--port", None, Finding("missing"), remedy)
    return open_loopback(descriptor)


def _open_can(spec: PortSpec) -> PortChannel:
    from lidar_emu.transports.can_port import open_can

    return open_can(spec)


def _open_udp(spec: PortSpec) -> PortChannel:
    from lidar_emu.transports.udp_port import open_udp

    return open_udp(spec)


def _open_stream(spec: PortSpec) -> PortChannel:
    from lidar_emu.transports.stream_socket import open_listening

    return open_listening(spec)


def _open_bytes(now_ns: Callable[[], int] | None, spec: PortSpec) -> PortChannel:
    from lidar_emu.transports.serial_port import open_byte_channel

    return open_byte_channel(spec, now_ns)


_OPENERS = {Kind.CAN: _open_can, Kind.UDP: _open_udp, Kind.TCP: _open_stream, Kind.UNIX: _open_stream}
