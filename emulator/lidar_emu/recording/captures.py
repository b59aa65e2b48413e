"""Captures of other tools: pcap, pcapng and logs of CAN buses.

Layouts follow draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng. A truncated capture yields the records before the
truncation.

Link types and layouts follow https://www.tcpdump.org/linktypes.html.
"""

from __future__ import annotations

import ipaddress
import logging
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from lidar_emu.errors import Finding, InputError, one_line
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_file
from lidar_emu.transports.can_adapters import frame_of, message_of
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames

_MICROSECONDS, _NANOSECONDS = 0xA1B2C3D4, 0xA1B23C4D
_SECTION, _INTERFACE, _ENHANCED = 0x0A0D0D0A, 1, 6
_BYTE_ORDER, _TIME_RESOLUTION, _TIME_OFFSET = 0x1A2B3C4D, 9, 14
_LONGEST = 1 << 26
_SNAP_BYTES = 262_144
MAGICS = tuple(struct.pack(f"{order}I", magic) for order in "<>" for magic in (_MICROSECONDS, _NANOSECONDS))
NEXT_GENERATION_MAGIC = struct.pack(">I", _SECTION)


class Captured(NamedTuple):
    """A record of a capture."""

    link_type: int
    """Link type, a number of the registry of tcpdump.org."""
    time_ns: int
    """Nanoseconds since 1970."""
    data: bytes


def read_capture(path: Path) -> Iterator[Captured]:
    """Iterate over the records of a capture.

    Raises:
        InputError: the file cannot be read, or is not a capture.
    """
    try:
        with path.open("rb") as file:
            magic = file.read(4)
            file.seek(0)
            if magic in MAGICS:
                yield from _classic(file, "<" if magic[0] in (0xD4, 0x4D) else ">")
            elif magic == NEXT_GENERATION_MAGIC:
                yield from _next_generation(file)
            else:
                raise InputError(str(path), None, Finding("not a capture"), "must be a pcap or pcapng file")
    except OSError as error:
        raise InputError(
            str(path), None, Finding(error.strerror or str(error)), "must be a capture"
        ) from None


class PcapWriter:
    """Writer of a pcap file with times in nanoseconds.

    Args:
        file: binary file, written from its present position.
        link_type: link type of all records.
    """

    def __init__(self, file: BinaryIO, link_type: int) -> None:
        self._file = file
        file.write(struct.pack("<IHHiIII", _NANOSECONDS, 2, 4, 0, 0, _SNAP_BYTES, link_type))

    def write(self, time_ns: int, data: bytes) -> None:
        """Append a record; time in nanoseconds since 1970."""
        second, rest_ns = divmod(time_ns, 10**9)
        self._file.write(struct.pack("<IIII", second & 0xFFFFFFFF, rest_ns, len(data), len(data)) + data)


def _classic(file: BinaryIO, order: str) -> Iterator[Captured]:
    head = file.read(24)
    if len(head) < 24:
        return
    magic, link_type = struct.unpack_from(f"{order}I16xI", head)
    unit_ns = 1 if magic == _NANOSECONDS else 1000
    record = struct.Struct(f"{order}IIII")
    while len(head := file.read(record.size)) == record.size:
        second, rest, length, _ = record.unpack(head)
        data = file.read(min(length, _LONGEST))
        if len(data) != length:
            return
        yield Captured(link_type & 0xFFFF, second * 10**9 + rest * unit_ns, data)


def _next_generation(file: BinaryIO) -> Iterator[Captured]:
    order, interfaces = "<", list[tuple[int, int, int]]()
    for order, kind, body in _blocks(file):
        if kind == _SECTION:
            interfaces = []
        elif kind == _INTERFACE and len(body) >= 8:
            interfaces.append(_interface(order, body))
        elif kind == _ENHANCED and len(body) >= 20:
            number, high, low, length = struct.unpack_from(f"{order}IIII", body)
            if number < len(interfaces) and length <= len(body) - 20:
                link_type, ticks_per_s, offset_s = interfaces[number]
                second, ticks = divmod(high << 32 | low, ticks_per_s)
                time_ns = (second + offset_s) * 10**9 + ticks * 10**9 // ticks_per_s
                yield Captured(link_type, time_ns, body[20 : 20 + length])


def _blocks(file: BinaryIO) -> Iterator[tuple[str, int, bytes]]:
    order = "<"
    while len(head := file.read(8)) == 8:
        if head[:4] == NEXT_GENERATION_MAGIC:
            mark = file.read(4)
            order = "<" if mark == struct.pack("<I", _BYTE_ORDER) else ">"
            head += mark
        kind, length = struct.unpack_from(f"{order}II", head)
        rest = length - len(head)
        if not 4 <= rest <= _LONGEST or len(body := file.read(rest)) != rest:
            return
        yield order, kind, body[:-4]


def _interface(order: str, body: bytes) -> tuple[int, int, int]:
    """Link type, ticks per second, and offset in seconds."""
    (link_type,) = struct.unpack_from(f"{order}H", body)
    ticks_per_s, offset_s, place = 10**6, 0, 8
    while place + 4 <= len(body):
        code, length = struct.unpack_from(f"{order}HH", body, place)
        value = body[place + 4 : place + 4 + length]
        if code == _TIME_RESOLUTION and len(value) == 1:
            ticks_per_s = (2 if value[0] & 0x80 else 10) ** (value[0] & 0x7F)
        elif code == _TIME_OFFSET and len(value) == 8:
            (offset_s,) = struct.unpack(f"{order}q", value)
        place += 4 + -(-length // 4) * 4
    return link_type, ticks_per_s, offset_s


SOCKETCAN, RTAC_SERIAL, RAW_IP = 227, 250, 101
_USER = range(147, 163)
_EXTENDED, _REMOTE, _ERROR = 1 << 31, 1 << 30, 1 << 29
_BITRATE_SWITCH, _FD = 1, 4
_CAN_HEAD = struct.Struct(">IBBxx")
_SERIAL_HEAD = struct.Struct(">IIBBxx")
_SENT, _RECEIVED = 1, 2
_UDP, _IPV4, _IPV6 = 17, 0x0800, 0x86DD


class Content(NamedTuple):
    """Payload of a captured record."""

    flow: str
    """Sender or direction, as far as the link shows it: records of one flow belong together."""
    payload: bytes
    """Bytes; on CAN frame records."""
    is_can: bool = False


def decode_record(link_type: int, data: bytes) -> Content | None:
    """Decode the payload of a record; None if it has none that could be replayed."""
    try:
        if link_type in _USER:
            return Content("bytes", data)
        reader = _READERS.get(link_type)
        return None if reader is None else reader(data)
    except (struct.error, IndexError, ValueError):  # truncated
        return None


def is_known(link_type: int) -> bool:
    """Whether records of this link type can be decoded."""
    return link_type in _READERS or link_type in _USER


def can_record(frame: Frame) -> bytes:
    """Record of a CAN frame, link type `SOCKETCAN`."""
    can_id = frame.can_id | frame.is_extended * _EXTENDED
    flags = frame.is_fd * _FD | frame.bitrate_switch * _BITRATE_SWITCH
    return _CAN_HEAD.pack(can_id, len(frame.data), flags) + frame.data


def serial_record(time_ns: int, data: bytes) -> bytes:
    """Record of bytes that the device sent, link type `RTAC_SERIAL`; time since 1970."""
    second, rest_ns = divmod(time_ns, 10**9)
    return _SERIAL_HEAD.pack(second & 0xFFFFFFFF, rest_ns // 1000, _SENT, 0) + data


def udp_record(destination: str, data: bytes) -> bytes:
    """Record of a datagram to HOST:PORT, link type `RAW_IP`. The sender is unknown: its address and port are 0."""
    host, _, port = destination.rpartition(":")
    try:
        address = ipaddress.ip_address(host.strip("[]"))
    except ValueError:  # a name
        address = ipaddress.ip_address("0.0.0.0")
    length = 8 + len(data)
    udp = struct.pack(">HHHH", 0, int(port), length, 0) + data
    if address.version == 4:
        head = struct.pack(">BBHHHBBHI4s", 0x45, 0, 20 + length, 0, 0, 64, _UDP, 0, 0, address.packed)
        return head[:10] + struct.pack(">H", _checksum(head)) + head[12:] + udp
    source = bytes(16)
    summed = _checksum(source + address.packed + struct.pack(">II", length, _UDP) + udp) or 0xFFFF
    head = struct.pack(">IHBB16s16s", 6 << 28, length, _UDP, 64, source, address.packed)
    return head + udp[:6] + struct.pack(">H", summed) + data


def _checksum(data: bytes) -> int:
    """Internet checksum (RFC 1071)."""
    words = struct.unpack(f">{-(-len(data) // 2)}H", data + b"\0" * (len(data) % 2))
    total: int = sum(words)
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF


def _of_can(data: bytes) -> Content | None:
    can_id, length, flags = _CAN_HEAD.unpack_from(data)
    if can_id & (_REMOTE | _ERROR):
        return None
    content = data[_CAN_HEAD.size : _CAN_HEAD.size + length]
    is_extended, is_fd = bool(can_id & _EXTENDED), bool(flags & _FD) or length > 8
    if len(content) != length or length > 64:
        return None
    frame = Frame(can_id & 0x1FFFFFFF, content, is_fd, is_fd and bool(flags & _BITRATE_SWITCH), is_extended)
    return Content("the bus", pack_frames([frame]), is_can=True)


def _of_serial(data: bytes) -> Content | None:
    event = _SERIAL_HEAD.unpack_from(data)[2]
    directions = {_SENT: "sent", _RECEIVED: "received"}
    return Content(directions[event], data[_SERIAL_HEAD.size :]) if event in directions else None


def _of_ethernet(data: bytes) -> Content | None:
    (protocol,) = struct.unpack_from(">H", data, 12)
    return _of_ip(data[14:]) if protocol in (_IPV4, _IPV6) else None


def _of_ip(data: bytes) -> Content | None:
    if data[0] >> 4 == 6:
        protocol, head, end = data[6], 40, 40 + struct.unpack_from(">H", data, 4)[0]
        target = f"[{ipaddress.IPv6Address(data[24:40])}]"
    else:
        total, fragment, protocol = struct.unpack_from(">HxxHxB", data, 2)
        head, end = (data[0] & 15) * 4, total
        target = str(ipaddress.IPv4Address(data[16:20]))
        if fragment & 0x3FFF:  # a fragment of a datagram
            return None
    if protocol != _UDP or not head + 8 <= end <= len(data):
        return None
    (port,) = struct.unpack_from(">H", data, head + 2)
    return Content(f"udp to {target}:{port}", data[head + 8 : end])


_READERS: dict[int, Callable[[bytes], Content | None]] = {
    0: lambda data: _of_ip(data[4:]),  # BSD loopback
    1: _of_ethernet,
    RAW_IP: _of_ip,
    108: lambda data: _of_ip(data[4:]),  # OpenBSD loopback
    113: lambda data: _of_ip(data[16:]),  # Linux, all devices
    SOCKETCAN: _of_can,
    228: _of_ip,  # IPv4 alone
    229: _of_ip,  # IPv6 alone
    RTAC_SERIAL: _of_serial,
    276: lambda data: _of_ip(data[20:]),  # Linux, all devices, second version
}


LOG_SUFFIXES = (".log", ".asc", ".blf", ".trc")


def read_log(path: Path) -> tuple[list[tuple[int, bytes]], dict[str, int], int]:
    """Read the data frames of a log.

    Returns:
        Data frames as (nanoseconds, frame record), number of data frames by bus, number of error and remote frames.

    Raises:
        InputError: python-can cannot read the file.
    """
    from can.io import MESSAGE_READERS

    check_file(path, f"must be a log in the format of {path.suffix}", MOST_BYTES_IN_MEMORY)
    logging.getLogger("can").setLevel(logging.CRITICAL)
    frames: list[tuple[int, bytes]] = []
    buses: Counter[str] = Counter()
    others, suffix = 0, path.suffix.lower()
    reader_of: Any = MESSAGE_READERS[suffix]
    try:
        # Opened here because a reader that rejects the header of a file leaves the file open.
        with path.open("rb" if suffix == ".blf" else "r") as file, reader_of(file) as reader:
            for message in reader:
                if message.is_error_frame or message.is_remote_frame:
                    others += 1
                    continue
                buses[str(message.channel)] += 1
                frames.append((round(message.timestamp * 1e9), pack_frames([frame_of(message)])))
    # The readers raise various exceptions for malformed lines and objects.
    except Exception as error:
        found = Finding(
            f"not readable after {len(frames)} frames: {one_line(str(error)) or type(error).__name__}"
        )
        raise InputError(str(path), None, found, f"must be a log in the format of {path.suffix}") from None
    return frames, dict(buses), others


def write_log(path: Path, packets: Iterable[tuple[int, bytes]]) -> None:
    """Write frame records, with times in nanoseconds since 1970, in the format that the suffix names."""
    from can import Logger

    with Logger(path) as logger:
        for time_ns, payload in packets:
            for frame in unpack_frames(payload):
                logger(message_of(frame, time_ns * 1e-9, channel="can0"))
