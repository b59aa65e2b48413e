"""Packets without framing: header, body and CRC of any kind, and the body of a measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from lidar_protocol.definitions import ByteLink, Interface
from lidar_protocol.errors import DecodeError, EncodeError, Fault
from lidar_protocol.fields import Value
from lidar_protocol.headers import Kind, Origin


class Message(NamedTuple):
    """One shot of one unit.

    `header` and each of `beams` hold values by the names of the interface definition, in the units of the names; None
    stands for the code "none". The set `core` on CAN carries fewer values than a packet.
    """

    unit: int
    header: Mapping[str, Value]
    beams: tuple[Mapping[str, Value], ...]
    sequence: int | None = None
    """Sequence count of the packet, if its header has one."""

    @property
    def time_ns(self) -> int | None:
        """Time of validity from the epoch, with the resolution of the interface."""
        return self._time("time")

    @property
    def due_ns(self) -> int | None:
        """Scheduled time of transmission from the epoch."""
        return self._time("due")

    @property
    def shot(self) -> int | None:
        """Shot number."""
        shot = self.header.get("shot")
        return None if shot is None else int(shot)

    def _time(self, name: str) -> int | None:
        time_ns = self.header.get(f"{name}_ns")
        if time_ns is not None:
            return int(time_ns)
        time_s = self.header.get(f"{name}_s")
        return None if time_s is None else round(time_s * 1e9)


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """Acknowledgement of a command."""

    unit: int
    command: str | None
    """Name of the command; None if the interface does not have its code."""
    sequence: int | None
    """Sequence number of the command."""
    verdict: str
    """`accepted`, or the reason for rejection, by the names of the interface."""
    values: Mapping[str, Value]
    """All fields by name."""


@dataclass(frozen=True, slots=True)
class Housekeeping:
    """Housekeeping of a device; on CAN the part in one frame."""

    unit: int
    values: Mapping[str, Value]


Received = Message | Acknowledge | Housekeeping


@dataclass(frozen=True, slots=True)
class Command:
    """A valid command."""

    unit: int
    name: str
    sequence: int
    values: Mapping[str, Value]
    """Arguments by name."""


@dataclass(frozen=True, slots=True)
class HostMessage:
    """A valid message of the host that is no command, such as its navigation solution."""

    unit: int
    name: str
    sequence: int
    values: Mapping[str, Value]
    """All other fields by key; None stands for the code "none"."""


@dataclass(frozen=True, slots=True)
class BadCommand:
    """An undamaged packet to this unit that is not a valid command or message of the interface: to be rejected."""

    unit: int
    code: int | None
    """Code of the command, if it can be decoded."""
    sequence: int | None
    """Sequence number; None if the packet ends before it."""
    verdict: str
    """`unknown`, `malformed` or `out_of_range`."""
    text: str
    """Description of the error."""


Values = Mapping[str, Value]


def seal(link: ByteLink, kind: Kind, unit: int, sequence: int, body: bytes) -> bytes:
    """Encode a packet: header, body and CRC."""
    packet = link.header.pack(kind, unit, sequence, link.overhead + len(body)) + body
    return packet if link.crc is None else packet + _checksum(link, packet)


def unseal(link: ByteLink, packet: bytes) -> tuple[Origin, bytes]:
    """Check a packet, and return its origin and its body.

    Raises:
        DecodeError: the length or the CRC is wrong, or the packet does not belong to the interface.
    """
    check_length(link, packet)
    end = len(packet) - link.crc_length
    if link.crc is not None and packet[end:] != _checksum(link, packet[:end]):
        raise DecodeError(Fault.BAD_CRC, "the CRC does not match")
    return link.header.unpack(packet), packet[link.header.length : end]


def check_length(link: ByteLink, packet: bytes) -> bytes:
    """Return a packet that has the length that it states; nothing else is checked.

    Raises:
        DecodeError: the packet is shorter than header and CRC with a body, or has another length.
    """
    if len(packet) <= link.overhead:
        raise DecodeError(Fault.BAD_LENGTH, f"{len(packet)} bytes are less than a packet")
    link.header.check_length(packet)
    return packet


def _checksum(link: ByteLink, packet: bytes) -> bytes:
    match link.covered:
        case "packet":
            covered = packet
        case "body":
            covered = packet[link.header.length :]
        case "frame":
            covered = link.framing.head(len(packet) + link.crc_length) + packet
    return link.checksum(covered).to_bytes(link.crc_length, link.byte_order)


def check_unit(interface: Interface, unit: int) -> None:
    """Refuse a unit that the interface does not have.

    Raises:
        EncodeError: the interface does not have the unit.
    """
    if not 0 <= unit < interface.units:
        raise EncodeError(f"unit {unit}: must be 0 to {interface.units - 1}")


def encode(interface: Interface, unit: int, header: Values, beams: Sequence[Values]) -> bytes:
    """Encode a shot as a packet without framing.

    Args:
        unit: unit number, from 0.
        header: fields of the header, without `interface_version` and `beam_count`, which are filled in; and `shot`.
        beams: for each beam the fields of a beam block. None and NaN stand for no value.

    Raises:
        EncodeError: a field is missing or cannot be sent, or there are too many beams or none.
    """
    definition = interface.packet
    check_unit(interface, unit)
    if not 1 <= len(beams) <= definition.maximum_beams:
        raise EncodeError(f"{len(beams)} beams: a packet carries 1 to {definition.maximum_beams}")
    shot = header.get("shot")
    if shot is None:
        raise EncodeError("shot is missing: the sequence count follows from it")
    if len(beams) < definition.beams_in_header:
        raise EncodeError(f"{len(beams)} beams: the packet holds {definition.beams_in_header}")
    of_beams = {key: beams[beam].get(name) for key, name, beam in definition.of_beams}
    values = {**header, **of_beams} if of_beams else header
    own = {"interface_version": interface.version, "beam_count": len(beams)}
    try:
        body = definition.header.packing(values, own)
        if definition.beam is not None:
            pack = definition.beam.packing
            body += b"".join([pack(beam, own) for beam in beams])
    except KeyError as missing:
        raise EncodeError(f"{missing.args[0]} is missing") from None
    return seal(interface.link, "measurement", unit, int(shot), body)


def decode(interface: Interface, packet: bytes) -> Message:
    """Decode the shot in a packet.

    Raises:
        DecodeError: the packet is damaged, or not a shot of this interface.
    """
    (kind, unit, sequence), body = unseal(interface.link, packet)
    if kind != "measurement":
        raise DecodeError(Fault.FOREIGN, f"a packet of another kind: {kind}")
    return measurement(interface, unit, sequence, body)


def measurement(interface: Interface, unit: int, sequence: int | None, body: bytes) -> Message:
    """Decode the shot in the body of a packet.

    Raises:
        DecodeError: the length is wrong, or the interface version is another one.
    """
    definition = interface.packet
    first = definition.header.length
    if len(body) < first:
        raise DecodeError(Fault.BAD_LENGTH, f"{len(body)} bytes are less than a header")
    header = definition.header.unpacking(body, 0)
    check_version(interface, header)
    if definition.beam is None:
        if len(body) != first:
            raise DecodeError(Fault.BAD_LENGTH, f"{len(body)} bytes are not the {first} of a shot")
        return Message(unit, header, _take_beams(interface, header), sequence)
    count, rest = divmod(len(body) - first, definition.beam.length)
    stated = header.get("beam_count", count)
    if rest or not count or stated != count:
        raise DecodeError(
            Fault.BAD_LENGTH, f"{len(body)} bytes do not hold the number of beams that they state"
        )
    beams = definition.beam.unpacking_each(body[first:])
    if definition.of_beams:
        for beam, own in zip(beams, _take_beams(interface, header), strict=False):
            beam.update(own)
    return Message(unit, header, tuple(beams), sequence)


def check_version(interface: Interface, values: Values) -> None:
    """Refuse values with another interface version.

    Raises:
        DecodeError: the interface version is another one.
    """
    if values.get("interface_version", interface.version) != interface.version:
        raise DecodeError(
            Fault.FOREIGN, f"interface version {values['interface_version']}, not {interface.version}"
        )


def _take_beams(interface: Interface, header: dict[str, Value]) -> tuple[dict[str, Value], ...]:
    beams: tuple[dict[str, Value], ...] = tuple({} for _ in range(interface.packet.beams_in_header))
    for key, name, beam in interface.packet.of_beams:
        beams[beam][name] = header.pop(key)
    return beams
