"""Packet headers: kind, unit and sequence count."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final, Literal, get_args

from lidar_protocol.errors import DecodeError, Fault
from lidar_protocol.fields import Constant
from lidar_protocol.layout import Layout

Kind = Literal["measurement", "command", "acknowledge", "housekeeping"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

APID_LIMIT: Final = (1 << 11) - 1
"""The highest APID marks idle packets."""

_CCSDS = struct.Struct(">HHH")
_TELECOMMAND, _SECONDARY_HEADER = 0x1000, 0x0800
_UNSEGMENTED = 0xC000
_SEQUENCE_CYCLE = 1 << 14


Origin = tuple[Kind, int, int | None]
"""Kind, unit and sequence count of a packet."""


@dataclass(frozen=True)
class SpacePacketHeader:
    """Primary header of a CCSDS space packet (133.0-B), always big-endian."""

    apids: Mapping[Kind, int]
    """APIDs of unit 0; the APIDs of the other units follow consecutively."""
    units: int
    timed: frozenset[Kind]
    """Kinds whose body starts with a time code, the secondary header."""

    length: ClassVar[int] = _CCSDS.size
    sequence_cycle: ClassVar[int] = _SEQUENCE_CYCLE

    def identification(self, kind: Kind, unit: int) -> int:
        """First 16 bits: version, type, secondary header flag and APID."""
        flags = (_TELECOMMAND if kind == "command" else 0) | (_SECONDARY_HEADER if kind in self.timed else 0)
        return flags | self.apids[kind] + unit

    def pack(self, kind: Kind, unit: int, sequence: int, packet_length: int) -> bytes:
        """Encode the header of a packet of `packet_length` bytes, including the CRC."""
        return _CCSDS.pack(
            self._identifications[kind] + unit,
            _UNSEGMENTED | sequence % _SEQUENCE_CYCLE,
            packet_length - _CCSDS.size - 1,
        )

    def check_length(self, packet: bytes) -> None:
        """Check the length of a packet against its header.

        Raises:
            DecodeError: the lengths differ.
        """
        stated = (packet[4] << 8 | packet[5]) + _CCSDS.size + 1
        if len(packet) != stated:
            raise DecodeError(Fault.BAD_LENGTH, f"the header states {stated} bytes, there are {len(packet)}")

    def unpack(self, packet: bytes) -> Origin:
        """Decode the header of an undamaged packet.

        Raises:
            DecodeError: the packet does not belong to this interface.
        """
        origin = self._known.get(packet[0] << 8 | packet[1])
        sequence = packet[2] << 8 | packet[3]
        if origin is None or sequence < _UNSEGMENTED:
            raise DecodeError(
                Fault.FOREIGN, f"{packet[:4].hex()} is not the start of a packet of this interface"
            )
        kind, unit = origin
        return kind, unit, sequence % _SEQUENCE_CYCLE

    @cached_property
    def _identifications(self) -> Mapping[Kind, int]:
        return {kind: self.identification(kind, 0) for kind in self.apids}

    @cached_property
    def _known(self) -> Mapping[int, tuple[Kind, int]]:
        return {
            self.identification(kind, unit): (kind, unit) for kind in self.apids for unit in range(self.units)
        }


@dataclass(frozen=True)
class PlainHeader:
    """A header of fields from the definition: some of message, unit, sequence and length, and constants."""

    layout: Layout
    messages: Mapping[Kind, int]
    """Value of the field `message` for each kind; without that field there is only one kind."""
    units: int

    @property
    def length(self) -> int:
        """Length of the header in bytes."""
        return self.layout.length

    @cached_property
    def sequence_cycle(self) -> int:
        """Number of packets after which the sequence count wraps; 0 without a sequence count."""
        bits = [each.field.codec.bits for each in self.layout.placed if each.field.name == "sequence"]
        return 1 << bits[0] if bits else 0

    def pack(self, kind: Kind, unit: int, sequence: int, packet_length: int) -> bytes:
        """Encode the header of a packet of `packet_length` bytes, including the CRC."""
        values = {"unit": unit, "sequence": sequence, "length": packet_length, "message": self.messages[kind]}
        return self.layout.pack({**values, **self._constants})

    def check_length(self, packet: bytes) -> None:
        """Check the length of a packet against its header, if the header states it.

        Raises:
            DecodeError: the lengths differ.
        """
        stated = self.layout.unpack(packet).get("length")
        if stated is not None and stated != len(packet):
            raise DecodeError(Fault.BAD_LENGTH, f"the header states {stated} bytes, there are {len(packet)}")

    def unpack(self, packet: bytes) -> Origin:
        """Decode the header of an undamaged packet.

        Raises:
            DecodeError: the packet does not belong to this interface.
        """
        values = self.layout.unpack(packet)
        kind = self._kinds.get(values.get("message"))
        unit = int(values.get("unit", 0) or 0)
        if (
            kind is None
            or unit >= self.units
            or any(values[name] != code for name, code in self._constants.items())
        ):
            raise DecodeError(
                Fault.FOREIGN, f"{packet[: self.length].hex()} is not the start of a packet of this interface"
            )
        sequence = values.get("sequence")
        return kind, unit, None if sequence is None else int(sequence)

    @cached_property
    def _constants(self) -> Mapping[str, int]:
        codecs = {each.field.name: each.field.codec for each in self.layout.placed}
        return {name: codec.code for name, codec in codecs.items() if isinstance(codec, Constant)}

    @cached_property
    def _kinds(self) -> Mapping[object, Kind]:
        if "message" not in self.layout.names:
            (kind,) = self.messages
            return {None: kind}
        return {code: kind for kind, code in self.messages.items()}


PacketHeader = SpacePacketHeader | PlainHeader
