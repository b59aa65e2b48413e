"""Opening byte links: a serial device or pyserial URL, a pty, the in-memory loopback."""

from __future__ import annotations

import errno
import os
import socket
import termios
from contextlib import suppress
from typing import Any

from lidar_emu.errors import InputError, one_line
from lidar_emu.transports.byte_channel import DescriptorChannel, PtyChannel
from lidar_emu.transports.link import Channel, LinkLostError, Noticed
from lidar_emu.transports.spec import Kind, PortSpec

_LOOPBACK_BUFFER_BYTES = 4 << 20
_URL_WRITE_TIMEOUT_S = 0.1
# pyserial URLs behind which os.write on the descriptor is what write() does; spy:// and rfc2217:// are not.
_PLAIN_SCHEMES = ("", "hwgrep", "alt", "socket")
_REASONS = {
    errno.ENOENT: "there is no such port",
    errno.ENXIO: "there is no such device",
    errno.EACCES: "permission denied (on Debian the group dialout may open serial ports)",
    errno.EBUSY: "in use by another program",
    errno.EAGAIN: "in use by another program",
    errno.EISDIR: "a folder is not a port",
}


def loopback_pair() -> tuple[socket.socket, socket.socket]:
    """The two ends of an in-memory link, device side first."""
    device, host = socket.socketpair()
    # Room for seconds of small packets, as far as the system allows: each counts with its overhead.
    for end in (device, host):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _LOOPBACK_BUFFER_BYTES)
    return device, host


def open_loopback(descriptor: int) -> Channel:
    """One end of the in-memory link, by its descriptor, which belongs to the channel from here on."""
    return DescriptorChannel(descriptor, str(PortSpec()), lambda: os.close(descriptor))


def open_byte_channel(spec: PortSpec) -> Channel:
    """Open a serial device, a pyserial URL or a new pty.

    Raises:
        InputError: it cannot be opened.
    """
    return PtyChannel() if spec.kind is Kind.PTY else _open_serial(spec)


def _open_serial(spec: PortSpec) -> Channel:
    import serial

    plain = spec.scheme in _PLAIN_SCHEMES
    try:
        port = serial.serial_for_url(
            spec.path,
            baudrate=spec.baud,
            timeout=0,
            write_timeout=None if plain else _URL_WRITE_TIMEOUT_S,
            exclusive=True,
        )
    except (OSError, termios.error) as error:  # SerialException is an OSError
        raise InputError("--port", None, spec.path, _reason(error)) from None
    except (ValueError, OverflowError) as error:
        if spec.scheme:
            allowed = f"{_reason(error)}; allowed: pyserial's URLs"
            raise InputError("--port", None, spec.path, allowed) from None
        raise InputError("--baud", None, spec.baud, "allowed: a bit rate that the port can do") from None
    return DescriptorChannel(port.fileno(), spec.path, port.close) if plain else UrlChannel(port, spec.path)


def _reason(error: Exception) -> str:
    if os.strerror(errno.ENOTTY) in str(error):
        return "it is not a serial device"
    number: object = error.args[0] if error.args else None  # termios.error is no OSError
    return next((text for known, text in _REASONS.items() if known == number), one_line(str(error)))


class UrlChannel:
    """A pyserial port that has no descriptor of its own to write to (loop://, rfc2217://, spy://).

    Its `write` may wait for a short while; a packet that did not fit in that time counts as dropped.
    """

    pending = False
    readable = None
    writable = None

    def __init__(self, port: Any, description: str) -> None:
        self.description = description
        self._port = port

    def connected(self) -> bool:
        """Always, while it is open."""
        return True

    def send(self, payload: bytes) -> bool:
        """Write the packet; False if that took too long."""
        from serial import SerialTimeoutException

        try:
            self._port.write(payload)
        except SerialTimeoutException:
            return False
        except (OSError, termios.error) as error:
            raise LinkLostError(one_line(str(error))) from None
        return True

    def flush(self) -> bool:
        """Nothing is ever left."""
        return True

    def receive(self) -> bytes:
        """What has arrived; empty if nothing."""
        try:
            return bytes(self._port.read(self._port.in_waiting))
        except (OSError, termios.error) as error:
            raise LinkLostError(one_line(str(error))) from None

    def take_noticed(self) -> Noticed:
        """Nothing: a byte link has no news of its own."""
        return Noticed()

    def unread(self) -> int:
        """Not known."""
        return 0

    def close(self) -> None:
        """Give the port back; never raises."""
        with suppress(OSError, termios.error):
            self._port.close()
