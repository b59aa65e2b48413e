"""The port as the user specifies it, the rules for the options, and the time that packets take on it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any, Self

from lidar_emu.errors import Finding, InputError
from lidar_emu.ip_addresses import is_this_machine
from lidar_emu.transports.frames import Frame, unpack_frames

DEFAULT_BAUD = 115_200
_SERIAL_FORMAT = "8N1"
_SERIAL_FORMATS = ("8N1", "8E1", "8O1", "8N2", "8E2", "8O2")
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
    serial_format: str = ""
    """Data bits, parity and stop bits of a serial line, as 8N1; empty: the interface's."""
    is_uart: bool = False
    """Whether a pty takes as long as the line that it represents, and holds no more than it."""
    rs485: bool = False
    """Whether the driver is to enable the transmitter while it sends (serial)."""
    pulse_line: str = ""
    """Source of synchronisation pulses: a modem line (serial), named as in `pulse_line`, or a PPS device; or empty."""
    pulse_out: str = ""
    """Modem line on which the device gives pulses (serial), `rts` or `dtr`; empty: none."""
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

    @property
    def is_open(self) -> bool:
        """Whether other machines can connect to the port."""
        return self.kind is Kind.TCP and not is_this_machine(self.path.rpartition(":")[0].strip("[]"))

    @property
    def parity(self) -> str:
        """N (none), E (even) or O (odd)."""
        return (self.serial_format or _SERIAL_FORMAT)[1]

    @property
    def stop_bits(self) -> int:
        """Stop bits of a serial line."""
        return int((self.serial_format or _SERIAL_FORMAT)[2])

    @property
    def bits_per_byte(self) -> int:
        """Bits of a character on a serial line: start, data, parity, stop."""
        return 9 + (self.parity != "N") + self.stop_bits

    def on_line(self, serial_format: str) -> Self:
        """The port with the interface's serial format, unless the user has stated one."""
        return self if self.serial_format else replace(self, serial_format=serial_format)

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

    def to_options(self) -> list[str]:
        """The options of the command line that `parse_port` reads as this port."""
        if self.kind is Kind.LOOPBACK:
            return []
        if self.kind is Kind.CAN:
            options = [
                "--interface",
                self.interface,
                "--channel",
                self.channel,
                "--bitrate",
                str(self.bitrate),
            ]
            return options + (["--fd", "--data-bitrate", str(self.data_bitrate)] if self.fd else [])
        options = ["--port", str(self)] + (["--baud", str(self.baud)] if self.baud else [])
        options += ["--serial-format", self.serial_format] if self.serial_format else []
        return options + (["--rs485"] if self.rs485 else [])

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
    serial_format: str | None = None,
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
    if port is None:
        serial_options = {"--baud": baud, "--serial-format": serial_format, "--rs485": rs485 or None}
        _refuse_given(serial_options, "pass it together with --port")
    if interface is None:
        can_options = {"--channel": channel, "--fd": fd or None, **rates, "--baud": None}
        _refuse_given(can_options, "pass it together with --interface")
        return PortSpec() if port is None else _bytes(port, baud, rs485, serial_format)
    return _can(interface, channel, bitrate, fd, data_bitrate)


def _refuse_given(options: dict[str, Any], remedy: str) -> None:
    for option, value in options.items():
        if value is not None:
            raise InputError(option, None, value, remedy)


def _bytes(port: str, baud: int | None, rs485: bool, serial_format: str | None) -> PortSpec:
    if serial_format not in (None, *_SERIAL_FORMATS):
        remedy = f"must be {', '.join(_SERIAL_FORMATS)}: data bits, parity (none, even, odd), stop bits"
        raise InputError("--serial-format", None, serial_format, remedy)
    characters = serial_format or ""
    if port in ("", _PTY, _UNIX):
        known = "pty, pty:LINK, udp:[HOST:]PORT, tcp:[HOST:]PORT or unix:PATH"
        raise InputError("--port", None, port, f"must be a device, a pyserial URL, {known}")
    if port == "pty" or port.startswith((_PTY, _UDP, _TCP, _UNIX)):
        _refuse_given({"--rs485": rs485 or None}, "pass it with a serial device")
    speed = DEFAULT_BAUD if baud is None else baud
    if port == "pty" or port.startswith(_PTY):
        path = port.removeprefix(_PTY) if port != "pty" else ""
        return PortSpec(Kind.PTY, path=path, baud=speed, serial_format=characters)
    for kind, prefix in _SOCKETS.items():
        if port.startswith(prefix):
            path = port.removeprefix(prefix) if kind is Kind.UNIX else _address(port, prefix)
            return PortSpec(kind, path=path, baud=baud or 0, serial_format=characters)
    return PortSpec(Kind.SERIAL, path=port, baud=speed, serial_format=characters, rs485=rs485)


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
        raise InputError(
            "--channel", None, Finding("missing"), "pass the channel too, as -i socketcan -c vcan0"
        )
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


_WARN_ABOVE = 0.7
_ROUNDING = 1e-9
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def wire_load(spec: PortSpec, payload: bytes, rate_hz: float) -> float:
    """Share of the link's capacity that `rate_hz` packets a second take; above 1 they do not fit.

    Args:
        spec: the port. A pty has no bit rate: its `baud` is the rate of the line that it represents.
        payload: the longest packet of the run, framed for the port (CAN: frame records).
        rate_hz: packets per second.
    """
    return time_on_link_s(spec, payload) * rate_hz


def time_on_link_s(spec: PortSpec, payload: bytes) -> float:
    """Transmission time of a packet; 0 if bits take no time. Arguments as for `wire_load`."""
    if not spec.has_bit_rate:
        return 0.0
    if spec.kind is Kind.CAN:
        bits = [frame_bits(frame) for frame in unpack_frames(payload)]
        return sum(slow / spec.bitrate + fast / spec.data_bitrate for slow, fast in bits)
    return spec.bits_per_byte * len(payload) / spec.baud


def check_wire_load(spec: PortSpec, payload: bytes, rate_hz: float) -> str | None:
    """A warning if the link will be nearly full, otherwise None. Arguments as for `wire_load`.

    Raises:
        InputError: the packets do not fit.
    """
    load = wire_load(spec, payload, rate_hz)
    if load <= _WARN_ABOVE:
        return None
    option, rate = ("--bitrate", spec.bitrate) if spec.kind is Kind.CAN else ("--baud", spec.baud)
    what = f"{rate_hz:g} packets of {len(payload)} bytes per second"
    if spec.kind is Kind.CAN:
        what = f"{rate_hz:g} packets of {len(unpack_frames(payload))} frames per second"
    if load > 1 + _ROUNDING:
        remedy = f"must be faster, or rate_hz lower: {what} need {100 * load:.0f} % of the wire"
        raise InputError(option, None, rate, remedy)
    return f"{what} take {100 * load:.0f} % of {option} {rate}"


def drain_time_s(spec: PortSpec, unread: int) -> float:
    """Time in which the port sends the bytes that have not left it; 0 if the bit rate is unknown."""
    if not (spec.kind is Kind.SERIAL or spec.is_uart) or not spec.has_bit_rate:
        return 0.0
    return spec.bits_per_byte * unread / spec.baud


def frame_bits(frame: Frame) -> tuple[int, int]:
    """Bits of a frame, with worst-case stuffing and the intermission: (at bit rate, at data bit rate).

    Classic frames (ISO 11898-1): 47 bits and the data, of which all but CRC delimiter, acknowledgement,
    end of frame and intermission (13 bits) can be stuffed, at worst one bit in four after the first:
    47 + 8n + floor((34 + 8n - 1) / 4) with an 11-bit identifier; 20 more bits with 29.

    CAN FD frames (ISO 11898-1:2015): from start of frame to BRS 17 bits (36 with a 29-bit identifier) and 12
    from the acknowledgement on; between them, at the data rate where BRS is set, ESI, 4 of DLC, the data, 4
    of stuff count, a CRC of 17 bits (21 above 16 bytes), one fixed stuff bit before and after each four bits
    of the last two, and the CRC delimiter. Dynamic stuffing ends with the data.
    """
    if not frame.is_fd:
        stuffable = 34 + 20 * frame.is_extended + 8 * len(frame.data)
        return stuffable + 13 + (stuffable - 1) // 4, 0
    length = next(allowed for allowed in _FD_LENGTHS if allowed >= len(frame.data))
    head = 36 if frame.is_extended else 17
    body = 1 + 4 + 8 * length
    crc = 4 + (17 if length <= 16 else 21)
    fixed_stuffing = 1 + crc // 4
    head_stuffing = (head - 1) // 4
    body_stuffing = (head + body - 1) // 4 - head_stuffing
    slow = head + head_stuffing + 12
    fast = body + body_stuffing + crc + fixed_stuffing + 1
    return (slow, fast) if frame.bitrate_switch else (slow + fast, 0)
