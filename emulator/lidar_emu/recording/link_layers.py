"""Link layers of captures: payloads of captured records, and records for payloads that a device sends.

Link types and layouts follow https://www.tcpdump.org/linktypes.html.
"""

from __future__ import annotations

import ipaddress
import struct
from collections.abc import Callable
from typing import NamedTuple

from lidar_emu.transports.frames import Frame, pack_frames

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
    return (
        struct.pack(">IHBB16s16s", 6 << 28, length, _UDP, 64, source, address.packed)
        + udp[:6]
        + struct.pack(">H", summed)
        + data
    )


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
