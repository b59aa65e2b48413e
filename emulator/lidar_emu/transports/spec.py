"""The port as the user specifies it, and the rules for the options."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Self

from lidar_emu.errors import Finding, InputError

DEFAULT_BAUD = 115_200
DEFAULT_BITRATE = 500_000
DEFAULT_DATA_BITRATE = 2_000_000
_URLS_WITHOUT_A_BIT_RATE = ("socket", "loop")
_UDP = "udp:"
_PTY = "pty:"
_TCP = "tcp:"
_UNIX = "unix:"
_THIS_MACHINE = "127.0.0.1"


class Kind(StrEnum):
    """Kind of a port."""

    LOOPBACK = "loopback"
    SERIAL = "serial"
    PTY = "pty"
    UDP = "udp"
    TCP = "tcp"
    UNIX = "unix"
    CAN = "can"


_SOCKETS = {Kind.UDP: _UDP, Kind.TCP: _TCP, Kind.UNIX: _UNIX}


@dataclass(frozen=True)
class PortSpec:
    """A port as the user specified it."""

    kind: Kind = Kind.LOOPBACK
    path: str = ""
    """Device path or pyserial URL (serial); HOST:PORT of the other end (UDP), or to listen at (TCP); path of a
    Unix socket; symbolic link to make (pty), or empty."""
    baud: int = DEFAULT_BAUD
    """Bits per second on a serial line; on a pty, which has none, the rate of the line that it represents; on a
    socket the rate of the line behind the bridge, or 0."""
    rs485: bool = False
    """Whether the driver is to enable the transmitter while it sends (serial)."""
    pulse_line: str = ""
    """Modem line whose rising edges are synchronisation pulses (serial), named as in `pulse_line`; empty: none."""
    interface: str = ""
    """python-can interface name (CAN), e.g. socketcan; the following fields are for CAN as well."""
    channel: str = ""
    bitrate: int = DEFAULT_BITRATE
    """Bits per second; with CAN FD, of the arbitration phase."""
    fd: bool = False
    data_bitrate: int = DEFAULT_DATA_BITRATE
    """Bits per second of a CAN FD frame's data phase."""

    @property
    def scheme(self) -> str:
        """Scheme of a pyserial URL; empty for a device path."""
        return self.path.partition("://")[0] if "://" in self.path else ""

    @property
    def has_bit_rate(self) -> bool:
        """Whether bits take time on this link."""
        if self.kind in _SOCKETS:
            return self.baud > 0
        return self.kind is not Kind.LOOPBACK and self.scheme not in _URLS_WITHOUT_A_BIT_RATE

    @property
    def shows_host(self) -> bool:
        """Whether the port shows that the other end has opened it: a cable, a bus and a datagram do not."""
        return self.kind in (Kind.PTY, Kind.TCP, Kind.UNIX) or self.scheme == "socket"

    def __str__(self) -> str:
        match self.kind:
            case Kind.LOOPBACK:
                return "in-memory loopback"
            case Kind.PTY:
                return _PTY + self.path if self.path else "pty"
            case Kind.SERIAL:
                return self.path
            case Kind.UDP | Kind.TCP | Kind.UNIX:
                return _SOCKETS[self.kind] + self.path
            case Kind.CAN:
                return f"{self.interface} {self.channel}"

    def to_json(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """The inverse of `to_json`."""
        return cls(**{**values, "kind": Kind(values["kind"])})


def parse_port(
    port: str | None = None,
    baud: int | None = None,
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    fd: bool = False,
    data_bitrate: int | None = None,
    rs485: bool = False,
) -> PortSpec:
    """The port that these options specify together; None: the option was not given.

    Raises:
        InputError: two ports at once, an option of the other kind of port, or a value out of range.
    """
    rates = {"--baud": baud, "--bitrate": bitrate, "--data-bitrate": data_bitrate}
    for option, rate in rates.items():
        if rate is not None and rate <= 0:
            raise InputError(option, None, rate, "must be a positive number of bits per second")
    if port is not None and interface is not None:
        raise InputError("--port", None, port, f"cannot be combined with --interface {interface}")
    if interface is None:
        can_options = {"--channel": channel, "--fd": fd or None, **rates, "--baud": None}
        _refuse_given(can_options, "pass it together with --interface")
        return _bytes(port, baud, rs485)
    _refuse_given({"--baud": baud, "--rs485": rs485 or None}, "pass it together with --port")
    return _can(interface, channel, bitrate, fd, data_bitrate)


def _refuse_given(options: dict[str, Any], remedy: str) -> None:
    for option, value in options.items():
        if value is not None:
            raise InputError(option, None, value, remedy)


def _bytes(port: str | None, baud: int | None, rs485: bool) -> PortSpec:
    if port is None:
        _refuse_given({"--baud": baud, "--rs485": rs485 or None}, "pass it together with --port")
        return PortSpec()
    if port in ("", _PTY, _UNIX):
        known = "pty, pty:LINK, udp:[HOST:]PORT, tcp:[HOST:]PORT or unix:PATH"
        raise InputError("--port", None, port, f"must be a device, a pyserial URL, {known}")
    if port == "pty" or port.startswith((_PTY, _UDP, _TCP, _UNIX)):
        _refuse_given({"--rs485": rs485 or None}, "pass it with a serial device")
    speed = DEFAULT_BAUD if baud is None else baud
    if port == "pty" or port.startswith(_PTY):
        return PortSpec(Kind.PTY, path=port.removeprefix(_PTY) if port != "pty" else "", baud=speed)
    for kind, prefix in _SOCKETS.items():
        if port.startswith(prefix):
            path = port.removeprefix(prefix) if kind is Kind.UNIX else _address(port, prefix)
            return PortSpec(kind, path=path, baud=baud or 0)
    return PortSpec(Kind.SERIAL, path=port, baud=speed, rs485=rs485)


def _address(port: str, prefix: str) -> str:
    host, _, number = port.removeprefix(prefix).rpartition(":")
    if not (number.isascii() and number.isdigit() and 0 < int(number) < 1 << 16):
        remedy = f"must be {prefix}PORT on this machine, or {prefix}HOST:PORT, with a port from 1 to 65535"
        raise InputError("--port", None, port, remedy)
    return f"{host or _THIS_MACHINE}:{number}"


def _can(
    interface: str, channel: str | None, bitrate: int | None, fd: bool, data_bitrate: int | None
) -> PortSpec:
    if interface == "virtual":
        remedy = "must be socketcan (vcan0), slcan or another interface; a virtual bus ends with its process"
        raise InputError("--interface", None, interface, remedy)
    if not channel:
        raise InputError("--channel", None, Finding("missing"), "pass the channel of the CAN interface")
    if data_bitrate is not None and not fd:
        raise InputError("--data-bitrate", None, data_bitrate, "pass it together with --fd")
    return PortSpec(
        kind=Kind.CAN,
        interface=interface,
        channel=channel,
        bitrate=bitrate or DEFAULT_BITRATE,
        fd=fd,
        data_bitrate=data_bitrate or DEFAULT_DATA_BITRATE,
    )
