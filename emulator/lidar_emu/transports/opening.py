"""How to open the port that a `PortSpec` names, the first time and again."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from lidar_emu.errors import InputError
from lidar_emu.transports.link import Channel
from lidar_emu.transports.spec import Kind, PortSpec

Opener = Callable[[], Channel]


def opener(
    spec: PortSpec, loopback_descriptor: int | None = None, now_ns: Callable[[], int] | None = None
) -> Opener:
    """A function that opens the port, and opens it again after it was lost.

    Args:
        spec: the port.
        loopback_descriptor: one end of the in-memory link; needed for that kind alone.
        now_ns: instant of the monotonic clock; needed for pulses alone.

    The function raises:
        InputError: the port cannot be opened.
    """
    if spec.kind is Kind.LOOPBACK:
        return _once(lambda: _open_loopback(loopback_descriptor), spec)
    open_port = _OPENERS.get(spec.kind) or partial(_open_bytes, now_ns)
    # The number of a pty that vanished is given to the next terminal that somebody opens.
    if (spec.path or spec.channel).startswith("/dev/pts/"):
        return _once(lambda: open_port(spec), spec)
    return lambda: open_port(spec)


def _once(open_channel: Opener, spec: PortSpec) -> Opener:
    attempts = iter([open_channel])

    def open_the_first_time() -> Channel:
        for attempt in attempts:
            return attempt()
        raise InputError("--port", None, str(spec), "what was lost there does not come back")

    return open_the_first_time


def _open_loopback(descriptor: int | None) -> Channel:
    from lidar_emu.transports.serial_port import open_loopback

    if descriptor is None:
        raise InputError(
            "--port", None, "nothing", "allowed: a device, a URL, udp:PORT or pty; or a CAN interface"
        )
    return open_loopback(descriptor)


def _open_can(spec: PortSpec) -> Channel:
    from lidar_emu.transports.can_port import open_can

    return open_can(spec)


def _open_udp(spec: PortSpec) -> Channel:
    from lidar_emu.transports.udp_port import open_udp

    return open_udp(spec)


def _open_bytes(now_ns: Callable[[], int] | None, spec: PortSpec) -> Channel:
    from lidar_emu.transports.serial_port import open_byte_channel

    return open_byte_channel(spec, now_ns)


_OPENERS = {Kind.CAN: _open_can, Kind.UDP: _open_udp}
