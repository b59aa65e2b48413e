"""A shot as a space packet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lidar_protocol import ccsds
from lidar_protocol.definitions import Interface
from lidar_protocol.errors import DecodeError, EncodeError, Fault
from lidar_protocol.fields import Value
from lidar_protocol.message import Message

Values = Mapping[str, Value]


def encode(interface: Interface, unit: int, header: Values, beams: Sequence[Values]) -> bytes:
    """The packet of one shot, without framing.

    Args:
        unit: from 0.
        header: the fields of the header, less `interface_version` and `beam_count`, which are filled in.
        beams: for each beam the fields of a beam block. None and NaN mean that there is no value.

    Raises:
        EncodeError: a field is missing or cannot be sent, or there are too many beams or none.
    """
    definition = interface.packet
    if not 0 <= unit < interface.units:
        raise EncodeError(f"unit {unit}: allowed are 0 to {interface.units - 1}")
    if not 1 <= len(beams) <= definition.maximum_beams:
        raise EncodeError(f"{len(beams)} beams: a packet carries 1 to {definition.maximum_beams}")
    filled_in = {"interface_version": interface.version, "beam_count": len(beams)}
    body = definition.header.pack({**header, **filled_in})
    body += b"".join([definition.beam.pack(beam) for beam in beams])
    shot = int(header["shot"] or 0)
    return ccsds.seal(definition.apid + unit, shot % ccsds.SEQUENCE_LIMIT, body)


def decode(interface: Interface, packet: bytes) -> Message:
    """The shot in a packet.

    Raises:
        DecodeError: the packet is damaged, or not one of this interface.
    """
    definition = interface.packet
    primary, body = ccsds.unseal(packet)
    unit = primary.apid - definition.apid
    if not 0 <= unit < interface.units:
        raise DecodeError(Fault.FOREIGN, f"APID {primary.apid:#x} is none of this interface")
    first, step = definition.header.length, definition.beam.length
    header = definition.header.unpack(body[:first])
    if header["interface_version"] != interface.version:
        raise DecodeError(
            Fault.FOREIGN, f"interface version {header['interface_version']}, not {interface.version}"
        )
    count = header["beam_count"]
    if count is None or len(body) != first + step * int(count):
        raise DecodeError(
            Fault.BAD_LENGTH, f"{len(body)} bytes do not hold the number of beams that they state"
        )
    beams = [definition.beam.unpack(body[start : start + step]) for start in range(first, len(body), step)]
    return Message(unit, header, tuple(beams))
