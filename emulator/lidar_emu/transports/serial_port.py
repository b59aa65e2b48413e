"""Opening byte links: a serial device or pyserial URL, a pty, the in-memory loopback."""

from __future__ import annotations

import errno
import os
import socket
import termios
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from lidar_emu.errors import InputError, one_line, reason_of
from lidar_emu.transports.byte_channel import DescriptorChannel, PtyChannel
from lidar_emu.transports.link import HostAbsentError, LinkLostError, PortChannel
from lidar_emu.transports.serial_device import SerialChannel, users_of
from lidar_emu.transports.spec import Kind, PortSpec

_LOOPBACK_BUFFER_BYTES = 4 << 20
_URL_WRITE_TIMEOUT_S = 0.1
_CONNECT_TIMEOUT_S = 1.0
_WRAPPING_SCHEMES = ("loop", "spy", "cp2110")
_IAC = b"\xff"  # a telnet stream doubles this byte
_RECEIVE_AT_MOST_BYTES = 1024
_IN_USE = "in use by another program"
_REASONS = {
    errno.ENOENT: "there is no such port",
    errno.ENXIO: "there is no such device",
    errno.EACCES: "permission denied (on Debian, members of the group dialout may open serial ports)",
    errno.EBUSY: _IN_USE,
    errno.EAGAIN: _IN_USE,
    errno.EISDIR: "it is a folder, not a port",
}


def loopback_pair() -> tuple[socket.socket, socket.socket]:
    """The two ends of an in-memory link, device side first."""
    device, host = socket.socketpair()
    # Room for seconds of small packets, as far as the system allows, which adds an overhead to each.
    for end in (device, host):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _LOOPBACK_BUFFER_BYTES)
    return device, host


def open_loopback(descriptor: int) -> PortChannel:
    """One end of the in-memory link, from its descriptor, which the channel owns from now on."""
    return DescriptorChannel(descriptor, str(PortSpec()), lambda: os.close(descriptor))


def open_byte_channel(spec: PortSpec, now_ns: Callable[[], int] | None = None) -> PortChannel:
    """Open a serial device, a pyserial URL or a new pty; without a clock pulses are not detected.

    Raises:
        InputError: it cannot be opened.
    """
    if spec.kind is not Kind.PTY:
        return _open_serial(spec, now_ns)
    try:
        return PtyChannel(Path(spec.path) if spec.path else None)
    except OSError as error:
        why = "it exists" if error.errno == errno.EEXIST else reason_of(error)
        raise InputError(
            "--port", None, str(spec), f"must be a path that does not exist yet: {why}"
        ) from None


def _open_serial(spec: PortSpec, now_ns: Callable[[], int] | None) -> PortChannel:
    if spec.scheme == "socket":
        return _open_tcp(spec)
    import serial

    write_timeout_s = _URL_WRITE_TIMEOUT_S if spec.scheme in _WRAPPING_SCHEMES else None
    try:
        port = serial.serial_for_url(
            spec.path, baudrate=spec.baud, timeout=0, write_timeout=write_timeout_s, exclusive=True
        )
    except (OSError, termios.error) as error:  # SerialException is an OSError
        raise InputError("--port", None, spec.path, _reason(error, spec.path)) from None
    except (ValueError, OverflowError) as error:
        if spec.scheme:
            remedy = f"must be a URL that pyserial knows: {_reason(error, spec.path)}"
            raise InputError("--port", None, spec.path, remedy) from None
        raise InputError("--baud", None, spec.baud, "must be a bit rate that the port supports") from None
    if spec.scheme == "rfc2217":
        return TelnetChannel(port, spec.path)
    if spec.scheme in _WRAPPING_SCHEMES:
        return UrlChannel(port, spec.path)
    return SerialChannel(port, spec, now_ns)


def _open_tcp(spec: PortSpec) -> PortChannel:
    """Raw bytes over TCP. pyserial waits 0.3 s whenever it closes such a port."""
    host, _, number = spec.path.partition("://")[2].rpartition(":")
    try:
        if not number.isdecimal():
            raise ValueError("must be socket://HOST:PORT")
        sock = socket.create_connection((host.strip("[]"), int(number)), _CONNECT_TIMEOUT_S)
    except (ConnectionRefusedError, TimeoutError) as error:
        raise HostAbsentError("--port", None, spec.path, _reason(error, spec.path)) from None
    except (OSError, ValueError, OverflowError) as error:
        raise InputError("--port", None, spec.path, _reason(error, spec.path)) from None
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return DescriptorChannel(sock.fileno(), spec.path, sock.close)


def _reason(error: Exception, path: str) -> str:
    if os.strerror(errno.ENOTTY) in str(error):
        return "it is not a serial device"
    number: object = error.args[0] if error.args else None  # termios.error is no OSError
    reason = next((text for known, text in _REASONS.items() if known == number), one_line(str(error)))
    users = users_of(path) if reason is _IN_USE else ""
    return f"{reason}: {users}" if users else reason


class TelnetChannel(DescriptorChannel):
    """A port behind a terminal server (RFC 2217): pyserial reads and negotiates; packets are written here, because its
    `write` blocks for seconds while the other end does not read."""

    readable = None

    def __init__(self, port: Any, description: str) -> None:
        self._port, self._socket = port, port._socket
        super().__init__(self._socket.fileno(), description, self._hang_up)

    def send(self, payload: bytes) -> bool:
        return super().send(payload.replace(_IAC, 2 * _IAC))

    def receive(self) -> bytes:
        data = b""
        try:
            # Without blocking, `read` returns one byte at a time.
            while len(data) < _RECEIVE_AT_MOST_BYTES and (byte := self._port.read(1)):
                data += byte
        except (OSError, termios.error) as error:
            if not data:
                raise LinkLostError(one_line(str(error))) from None
        return data

    def _hang_up(self) -> None:
        # In a thread: pyserial takes 0.3 s, and leaves a broken socket open.
        def close() -> None:
            self._port.close()
            self._socket.close()

        threading.Thread(target=close, daemon=True).start()


class UrlChannel(PortChannel):
    """A pyserial port without a descriptor to write to (loop://, spy://).

    Its `write` may block for a short time; a packet that was not written by then counts as dropped.
    """

    def __init__(self, port: Any, description: str) -> None:
        super().__init__(description)
        self._port = port

    def send(self, payload: bytes) -> bool:
        from serial import SerialTimeoutException

        try:
            self._port.write(payload)
        except SerialTimeoutException:
            return False
        except (OSError, termios.error) as error:
            raise LinkLostError(one_line(str(error))) from None
        return True

    def receive(self) -> bytes:
        try:
            return bytes(self._port.read(self._port.in_waiting))
        except (OSError, termios.error) as error:
            raise LinkLostError(one_line(str(error))) from None

    def close(self) -> None:
        with suppress(OSError, termios.error):
            self._port.close()
