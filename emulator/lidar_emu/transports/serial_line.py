"""A serial device: its settings, optional features of its driver, and other programs that use it.

Sources: ioctl_tty(2), termios(3), linux/serial.h, asm-generic/ioctls.h.
"""

from __future__ import annotations

import fcntl
import os
import termios
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from lidar_emu.transports.byte_channel import DescriptorChannel
from lidar_emu.transports.link import NOTHING, DriverFeatures, LinkDiagnostics
from lidar_emu.transports.pulse_line import MODEM_LINES, PulseLine, modem_bits
from lidar_emu.transports.spec import PortSpec
from lidar_emu.transports.tty_reader import TtyReader

_TCGETS2, _TCSETS2, _SETTINGS_BYTES = 0x802C542A, 0x402C542B, 44
_NAMED_AT_MOST = 3
_REMEDIES = {"low_latency": "a serial driver that supports it", "rs485": "a serial driver that supports it"}


class SerialChannel(DescriptorChannel):
    """An open device, locked against other programs. A program that had it open already can still change its settings;
    they are then set again.

    Args:
        port: open pyserial port.
        spec: the port as the user specified it.
        now_ns: instant of the monotonic clock; without it pulses are not detected.
    """

    def __init__(self, port: Any, spec: PortSpec, now_ns: Callable[[], int] | None = None) -> None:
        self._tty = port.fileno()
        os.set_blocking(self._tty, False)
        self._reader = TtyReader(self._tty)
        super().__init__(self._tty, spec.path, port.close, self._reader.descriptor)
        self.driver_features = request_driver_features(port, spec)
        self._settings = _settings_of(self._tty)
        self._diagnostics = LinkDiagnostics(modem_lines(self._tty))
        self._marked = False
        if not _is_pty(self._tty):
            self.gone = "the device has gone"
            # A pty outlives this process: the exclusive mark would stay for the program at its other end.
            self._marked = _request(self._tty, termios.TIOCEXCL)
        self._pulses = PulseLine(self._tty, spec.pulse_line, now_ns) if spec.pulse_line and now_ns else None

    def take_diagnostics(self) -> LinkDiagnostics:
        if self._settings is not None and _settings_of(self._tty) not in (self._settings, None):
            with suppress(OSError):
                fcntl.ioctl(self._tty, _TCSETS2, self._settings)
            self._diagnostics.events.append(
                "another program has changed the settings of the port; they were set again"
            )
        if self._pulses is not None:
            self._diagnostics.pulse_ns = self._pulses.last_ns
            self._diagnostics.events += self._pulses.take_failure()
        if self._diagnostics == NOTHING:
            return NOTHING
        diagnostics, self._diagnostics = self._diagnostics, LinkDiagnostics()
        return diagnostics

    def close(self) -> None:
        if self._marked:
            _request(self._tty, termios.TIOCNXCL)
        if self._pulses is not None:
            self._pulses.close()
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
    return DriverFeatures(tuple(granted), {name: _REMEDIES[name] for name in requests if name not in granted})


def modem_lines(descriptor: int) -> list[str]:
    """A line of text with the states of the modem input lines; empty if the port has none."""
    try:
        bits = modem_bits(descriptor)
    except OSError:
        return []
    states = (f"{name.upper()} {'on' if bits & bit else 'off'}" for name, bit in MODEM_LINES.items())
    return ["modem lines: " + ", ".join(states)]


def users_of(path: str) -> str:
    """Processes that have a device open, as far as this user may see them: "cat (process 42)"; empty if none."""
    device, found = Path(path).resolve(), []
    for folder in Path("/proc").glob("[0-9]*/fd"):
        with suppress(OSError):
            if any(link.is_symlink() and link.readlink() == device for link in folder.iterdir()):
                name = (folder.parent / "comm").read_text().strip()
                found.append(f"{name} (process {folder.parent.name})")
    return ", ".join(found[:_NAMED_AT_MOST])


def _settings_of(descriptor: int) -> bytes | None:
    try:
        return fcntl.ioctl(descriptor, _TCGETS2, bytes(_SETTINGS_BYTES))
    except OSError:
        return None


def _is_pty(descriptor: int) -> bool:
    try:
        return os.ttyname(descriptor).startswith("/dev/pts/")
    except OSError:
        return False


def _request(descriptor: int, request: int) -> bool:
    try:
        fcntl.ioctl(descriptor, request)
    except OSError:
        return False
    return True
