"""Packet captures: read pcap (microseconds or nanoseconds) and pcapng, write pcap with nanoseconds.

Layouts follow draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng. A truncated capture yields the records before the
truncation.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from lidar_emu.errors import Finding, InputError

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


class _Interface(NamedTuple):
    link_type: int
    ticks_per_s: int
    offset_s: int


def _next_generation(file: BinaryIO) -> Iterator[Captured]:
    order, interfaces = "<", list[_Interface]()
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


def _interface(order: str, body: bytes) -> _Interface:
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
    return _Interface(link_type, ticks_per_s, offset_s)
