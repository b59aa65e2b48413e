"""A serial device: its settings, optional features of its driver, and other programs that use it.

Source: serial_core.c and usb-serial.c of Linux, where TIOCMIWAIT waits until one of the lines changes.

Sources: ioctl_tty(2), termios(3), linux/serial.h, asm-generic/ioctls.h.
"""

from __future__ import annotations

import fcntl
import os
import termios
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from lidar_emu.transports.byte_channel import DescriptorChannel, TtyReader
from lidar_emu.transports.link import NOTHING, DriverFeatures, LinkDiagnostics
from lidar_emu.transports.spec import PortSpec

MODEM_LINES = {"cts": termios.TIOCM_CTS, "dsr": termios.TIOCM_DSR, "cd": termios.TIOCM_CD}
"""Input lines, with their bits."""


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
