"""CCSDS space packets (133.0-B): the primary header, and the CRC at the end (as in 132.0-B and ECSS).

Only what this device sends: telemetry, unsegmented, with a secondary header that is the time code.
"""

from __future__ import annotations

import binascii
import struct
from typing import NamedTuple

from lidar_protocol.errors import DecodeError, Fault

PRIMARY_HEADER_BYTES = 6
CRC_BYTES = 2
OVERHEAD_BYTES = PRIMARY_HEADER_BYTES + CRC_BYTES
APID_LIMIT = 1 << 11
SEQUENCE_LIMIT = 1 << 14

_HEADER = struct.Struct(">HHH")
_TELEMETRY_WITH_SECONDARY_HEADER = 0x0800
_UNSEGMENTED = 0xC000


class PrimaryHeader(NamedTuple):
    """The fields of a primary header that vary."""

    apid: int
    sequence_count: int


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, not reflected; 0x29B1 for b"123456789"."""
    return binascii.crc_hqx(data, 0xFFFF)


def seal(apid: int, sequence_count: int, body: bytes) -> bytes:
    """A whole packet: primary header, `body` (secondary header included) and CRC."""
    header = _HEADER.pack(
        _TELEMETRY_WITH_SECONDARY_HEADER | apid,
        _UNSEGMENTED | sequence_count,
        len(body) + CRC_BYTES - 1,
    )
    packet = header + body
    return packet + crc16(packet).to_bytes(CRC_BYTES, "big")


def unseal(packet: bytes) -> tuple[PrimaryHeader, bytes]:
    """Header and body of a packet, without its CRC.

    Raises:
        DecodeError: the length or the CRC is wrong, or the packet is of another kind.
    """
    if len(packet) <= OVERHEAD_BYTES:
        raise DecodeError(Fault.BAD_LENGTH, f"{len(packet)} bytes are less than a packet")
    identification, sequence, length = _HEADER.unpack_from(packet)
    if len(packet) != PRIMARY_HEADER_BYTES + length + 1:
        stated = PRIMARY_HEADER_BYTES + length + 1
        raise DecodeError(Fault.BAD_LENGTH, f"the header states {stated} bytes, there are {len(packet)}")
    if crc16(packet):  # the CRC over a packet and its own CRC is zero
        raise DecodeError(Fault.BAD_CRC, "the CRC does not match")
    kind, apid = divmod(identification, APID_LIMIT)
    if kind != _TELEMETRY_WITH_SECONDARY_HEADER // APID_LIMIT or sequence < _UNSEGMENTED:
        raise DecodeError(Fault.FOREIGN, "not an unsegmented telemetry packet with a secondary header")
    header = PrimaryHeader(apid, sequence % SEQUENCE_LIMIT)
    return header, packet[PRIMARY_HEADER_BYTES:-CRC_BYTES]
