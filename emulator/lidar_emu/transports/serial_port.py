"""Byte links: a serial device, its settings and other users, a pyserial URL, a pty, the in-memory loopback.

Sources: ioctl_tty(2), termios(3), linux/serial.h, asm-generic/ioctls.h; serial_core.c and usb-serial.c of Linux, where
TIOCMIWAIT waits until one of the lines changes.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import sys
import termios
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from lidar_emu.errors import InputError, one_line, reason_of
from lidar_emu.transports.byte_channel import DescriptorChannel, TtyReader
from lidar_emu.transports.link import (
    DriverFeatures,
    HostAbsentError,
    LinkDiagnostics,
    LinkLostError,
    PortChannel,
)
from lidar_emu.transports.opening_problems import refuse_used, serial_problem
from lidar_emu.transports.pseudo_terminal import PtyChannel, PtyUart
from lidar_emu.transports.spec import Kind, PortSpec

_LOOPBACK_BUFFER_BYTES = 4 << 20
_URL_WRITE_TIMEOUT_S = 0.1
_CONNECT_TIMEOUT_S = 1.0
_WRAPPING_SCHEMES = ("loop", "spy", "cp2110")
_IAC = b"\xff"  # a telnet stream doubles this byte
_RECEIVE_AT_MOST_BYTES = 1024


def loopback_pair() -> tuple[socket.socket, socket.socket]:
    """The two ends of an in-memory link, device side first."""
    device, host = socket.socketpair()
    # Room for seconds of small packets, as far as the system allows, which adds an overhead to each.
    for end in (device, host):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _LOOPBACK_BUFFER_BYTES)
    return device, host


def open_byte_channel(spec: PortSpec, now_ns: Callable[[], int] | None = None) -> PortChannel:
    """Open a serial device, a pyserial URL or a new pty; without a clock pulses are not detected.

    Raises:
        InputError: it cannot be opened.
    """
    if spec.kind is not Kind.PTY:
        return _open_serial(spec, now_ns)
    link = Path(spec.path) if spec.path else None
    try:
        if spec.is_uart and now_ns is not None:
            return PtyUart(link, 1e9 * spec.bits_per_byte / spec.baud, now_ns)
        return PtyChannel(link)
    except OSError as error:
        why = "it exists" if error.errno == errno.EEXIST else reason_of(error)
        remedy = f"must be a path that does not exist yet: {why}"
        raise InputError("--port", None, str(spec), remedy) from None


def open_serial_host(spec: PortSpec) -> PortChannel:
    """The host's end of a byte link: `open_byte_channel`, for one program at a time; its settings are restored.

    Raises:
        InputError: it cannot be opened, or another program has it open.
    """
    if spec.kind is not Kind.SERIAL or spec.scheme:
        return open_byte_channel(spec)
    # Open until pyserial has opened it too: the lines of a device that nobody has open would fall.
    found = None
    with suppress(OSError):
        found = os.open(spec.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        if found is None or os.isatty(found):  # any number of programs have /dev/null open
            refuse_used(spec.path)
        settings = None if found is None else _ioctl(found, _TCGETS2, _NO_SETTINGS)
        channel = open_byte_channel(spec)
    finally:
        if found is not None:
            os.close(found)
    if isinstance(channel, SerialChannel):
        channel.settings_at_close = settings
    return channel


def _open_serial(spec: PortSpec, now_ns: Callable[[], int] | None) -> PortChannel:
    if spec.scheme == "socket":
        return _open_tcp(spec)
    if spec.scheme == "rfc2217" and not urlsplit(spec.path).netloc.rpartition(":")[2].isdecimal():
        raise InputError("--port", None, spec.path, "must be rfc2217://HOST:PORT")
    import serial

    write_timeout_s = _URL_WRITE_TIMEOUT_S if spec.scheme in _WRAPPING_SCHEMES else None
    try:
        port = serial.serial_for_url(
            spec.path,
            baudrate=spec.baud,
            parity=spec.parity,
            stopbits=spec.stop_bits,
            timeout=0,
            write_timeout=write_timeout_s,
            exclusive=True,
        )
    except (OSError, termios.error) as error:  # SerialException is an OSError
        raise InputError("--port", None, spec.path, serial_problem(error, spec.path)) from None
    except (ValueError, OverflowError) as error:
        if spec.scheme:
            remedy = f"must be a URL that pyserial knows: {serial_problem(error, spec.path)}"
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
        raise HostAbsentError("--port", None, spec.path, serial_problem(error, spec.path)) from None
    except (OSError, ValueError, OverflowError) as error:
        raise InputError("--port", None, spec.path, serial_problem(error, spec.path)) from None
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return DescriptorChannel(sock.fileno(), spec.path, sock.close)


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


MODEM_LINES = {"cts": termios.TIOCM_CTS, "dsr": termios.TIOCM_DSR, "cd": termios.TIOCM_CD}
"""Input lines, with their bits."""
_PULSE_BITS = {"rts": termios.TIOCM_RTS, "dtr": termios.TIOCM_DTR}


class PulseLine:
    """Watches a line in its own thread, which records the time at once, whatever else the process does.

    A pulse begins with a rising edge. It is missed if it ends before the thread reads the line; milliseconds suffice.

    Args:
        terminal: descriptor of the port; it must stay open until `close`.
        line: `cd`, `cts` or `dsr`.
        now_ns: instant of the monotonic clock.
    """

    def __init__(self, terminal: int, line: str, now_ns: Callable[[], int]) -> None:
        self.last_ns: int | None = None
        """When the last pulse began, on the monotonic clock; None: there was none."""
        self._port, self._line, self._now_ns = terminal, line, now_ns
        # Only an edge, or the end of the process, releases a waiting thread. A duplicate descriptor keeps it from
        # waiting on another file that takes the same number later.
        self._terminal = os.dup(terminal)
        self._failure: list[str] = []
        self._closed = False
        threading.Thread(target=self._watch, daemon=True).start()

    def take_failure(self) -> list[str]:
        """Why pulses are no longer detected, once; empty while they are."""
        failure, self._failure = self._failure, []
        return failure

    def close(self) -> None:
        """Stop, and let other programs open the port although the thread may still have it open."""
        self._closed = True
        with suppress(OSError):
            fcntl.flock(self._port, fcntl.LOCK_UN)

    def _watch(self) -> None:
        bit = MODEM_LINES[self._line]
        try:
            while not self._closed:
                fcntl.ioctl(self._terminal, termios.TIOCMIWAIT, bit)
                edge_ns = self._now_ns()
                if modem_bits(self._terminal) & bit:
                    self.last_ns = edge_ns
        except OSError as error:
            self._failure = [f"no pulses from line {self._line}: {error.strerror}"]
        finally:
            os.close(self._terminal)


def modem_bits(terminal: int) -> int:
    """The state of all modem lines.

    Raises:
        OSError: the port has none.
    """
    state = bytearray(4)
    fcntl.ioctl(terminal, termios.TIOCMGET, state)
    return int.from_bytes(state, "little")


_TCGETS2, _TCSETS2, _TCSETSW2, _NO_SETTINGS = 0x802C542A, 0x402C542B, 0x402C542C, bytes(44)


class SerialChannel(DescriptorChannel):
    """An open device, locked against other programs. A program that had it open already can still change its settings;
    they are then set again.

    Args:
        now_ns: instant of the monotonic clock; without it pulses are not detected.
    """

    def __init__(self, port: Any, spec: PortSpec, now_ns: Callable[[], int] | None = None) -> None:
        self._tty = port.fileno()
        os.set_blocking(self._tty, False)
        self._reader = TtyReader(self._tty)
        super().__init__(self._tty, spec.path, port.close, self._reader.descriptor)
        self.driver_features = request_driver_features(port, spec)
        self._settings = _ioctl(self._tty, _TCGETS2, _NO_SETTINGS)
        self.settings_at_close: bytes | int | None = None
        """Settings to restore, unless another program has changed them meanwhile; None: leave them."""
        self._diagnostics = LinkDiagnostics(modem_lines(self._tty))
        self._marked = False
        if not _is_pty(self._tty):
            self.gone = "the device has gone"
            # A pty outlives this process: the exclusive mark would stay for the program at its other end.
            self._marked = _ioctl(self._tty, termios.TIOCEXCL) is not None
        watched = spec.pulse_line in MODEM_LINES and now_ns
        self._pulses = PulseLine(self._tty, spec.pulse_line, watched) if watched else None
        self._pulse_out = spec.pulse_out
        self.set_pulse(False)

    def set_pulse(self, level: bool) -> None:
        if not self._pulse_out:
            return
        bit = _PULSE_BITS[self._pulse_out].to_bytes(4, sys.byteorder)
        try:
            fcntl.ioctl(self._tty, termios.TIOCMBIS if level else termios.TIOCMBIC, bit)
        except OSError as error:
            self._diagnostics.events.append(f"no pulses on line {self._pulse_out}: {error.strerror}")
            self._pulse_out = ""

    def take_diagnostics(self) -> LinkDiagnostics:
        now = _ioctl(self._tty, _TCGETS2, _NO_SETTINGS)
        if self._settings is not None and now not in (self._settings, None):
            _ioctl(self._tty, _TCSETS2, self._settings)
            text = "another program has changed the settings of the port; they were set again"
            self._diagnostics.events.append(text)
        if self._pulses is not None:
            self._diagnostics.pulse_ns = self._pulses.last_ns
            self._diagnostics.events += self._pulses.take_failure()
        return super().take_diagnostics()

    def close(self) -> None:
        if self.settings_at_close and _ioctl(self._tty, _TCGETS2, _NO_SETTINGS) == self._settings:
            _ioctl(self._tty, _TCSETSW2, self.settings_at_close)  # once what was written has left
        if self._marked:
            _ioctl(self._tty, termios.TIOCNXCL)
        if self._pulses is not None:
            self._pulses.close()
        self.set_pulse(False)
        self._reader.close()
        super().close()


def request_driver_features(port: Any, spec: PortSpec) -> DriverFeatures:
    """Request optional features from the driver of a pyserial port."""
    from serial.rs485 import RS485Settings

    requests: dict[str, Callable[[], None]] = {"low_latency": lambda: port.set_low_latency_mode(True)}
    if spec.rs485:
        requests["rs485"] = lambda: setattr(port, "rs485_mode", RS485Settings())
    granted = []
    for name, request in requests.items():
        with suppress(OSError, ValueError, NotImplementedError):
            request()
            granted.append(name)
    missing = {name: "a serial driver that supports it" for name in requests if name not in granted}
    return DriverFeatures(tuple(granted), missing)


def modem_lines(descriptor: int) -> list[str]:
    """A line of text with the states of the modem input lines; empty if the port has none."""
    try:
        bits = modem_bits(descriptor)
    except OSError:
        return []
    states = (f"{name.upper()} {'on' if bits & bit else 'off'}" for name, bit in MODEM_LINES.items())
    return ["modem lines: " + ", ".join(states)]


def _is_pty(descriptor: int) -> bool:
    try:
        return os.ttyname(descriptor).startswith("/dev/pts/")
    except OSError:
        return False


def _ioctl(descriptor: int, request: int, argument: bytes | int = 0) -> bytes | int | None:
    try:
        return fcntl.ioctl(descriptor, request, argument)
    except OSError:
        return None
