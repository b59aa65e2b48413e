"""The host's side of a byte link: commands out, bytes in, messages on, whatever arrives.

The receiver raises nothing and holds a bounded amount of memory; what could not be used is counted.
"""

from __future__ import annotations

from dataclasses import dataclass

from lidar_protocol import commands, packet
from lidar_protocol.can_frames import CanFrame
from lidar_protocol.commands import Argument
from lidar_protocol.definitions import Interface
from lidar_protocol.errors import DecodeError, Fault
from lidar_protocol.fields import Counter, Value
from lidar_protocol.framing import LinkCounters
from lidar_protocol.headers import Kind
from lidar_protocol.message import Acknowledge, Housekeeping, Received


@dataclass(frozen=True, slots=True)
class Host:
    """Who commands a unit. It keeps no state: the caller counts the sequence numbers."""

    interface: Interface
    unit: int = 0

    def encode_command(self, name: str, **values: Argument) -> bytes:
        """A command, framed: `sequence` and its arguments by name, a word of an enumeration or a number.

        Raises:
            EncodeError: the interface has no such command, or an argument is missing, unknown or cannot be sent.
        """
        return commands.encode(self.interface, self.unit, name, values)

    def encode_command_frame(self, name: str, **values: Argument) -> CanFrame:
        """The same as a CAN frame."""
        return commands.encode_frame(self.interface, self.unit, name, values)


@dataclass(slots=True)
class SerialCounters(LinkCounters):
    """What has come in on a byte link."""

    sequence_gaps: int = 0
    """Times that shots were missing between two messages of a unit."""
    lost_packets: int = 0
    """Shots that were missing."""
    restarts: int = 0
    """Times that a unit's shot number did not go up."""


class SerialReceiver:
    """Messages out of a stream of bytes, in any portions."""

    def __init__(self, interface: Interface) -> None:
        self.counters = SerialCounters()
        self._interface = interface
        longest = interface.maximum_packet_bytes
        self._frames = interface.link.framing.reader(longest, self._read, self.counters)
        self._last: dict[int, int] = {}
        self._cycle = _shot_cycle(interface) or interface.link.header.sequence_cycle
        self._by_shot = _shot_cycle(interface) > 0

    @property
    def buffered_bytes(self) -> int:
        """Bytes that may belong to a frame whose end has not come yet; never more than the longest frame."""
        return self._frames.buffered_bytes

    def receive(self, data: bytes) -> list[Received]:
        """The messages that are complete with `data`."""
        return self._frames.receive(data)

    def _read(self, frame: bytes) -> Received:
        (kind, unit, sequence), body = packet.unseal(self._interface.link, frame)
        if kind != "measurement":
            return read_block(self._interface, kind, unit, body)
        message = packet.measurement(self._interface, unit, sequence, body)
        number = message.header["shot"] if self._by_shot else sequence
        if number is not None:
            self._count_missing(unit, int(number))
        return message

    def _count_missing(self, unit: int, number: int) -> None:
        last = self._last.get(unit, number - 1)
        self._last[unit] = number
        missing = (number - last - 1) % self._cycle
        if missing >= self._cycle // 2:
            self.counters.restarts += 1
        elif missing:
            self.counters.sequence_gaps += 1
            self.counters.lost_packets += missing


def read_block(interface: Interface, kind: Kind, unit: int, body: bytes) -> Acknowledge | Housekeeping:
    """An acknowledgement or housekeeping.

    Raises:
        DecodeError: it is neither, as long as it should not be, or of another version.
    """
    layouts = {"acknowledge": interface.acknowledge, "housekeeping": interface.housekeeping}
    layout = layouts.get(kind)
    if layout is None:
        raise DecodeError(Fault.FOREIGN, f"a {kind}, which devices do not send")
    if len(body) != layout.length:
        raise DecodeError(Fault.BAD_LENGTH, f"{len(body)} bytes are not the {layout.length} of {kind}")
    values = layout.unpack(body)
    packet.check_version(interface, values)
    return acknowledge(interface, unit, values) if kind == "acknowledge" else Housekeeping(unit, values)


def acknowledge(interface: Interface, unit: int, values: dict[str, Value]) -> Acknowledge:
    """The fields of an acknowledgement, with names for its numbers."""
    sequence, verdict, code = values.get("sequence"), values.get("verdict"), values.get("command")
    known = interface.commands.by_code if interface.commands else {}
    command = known.get(-1 if code is None else int(code))
    return Acknowledge(
        unit=unit,
        command=command.name if command else None,
        sequence=None if sequence is None else int(sequence),
        verdict=interface.word("verdict", int(verdict or 0)) or str(verdict),
        values=values,
    )


def _shot_cycle(interface: Interface) -> int:
    """After how many shots the number in a packet is the same again; 0 where packets do not carry it."""
    codecs = {placed.field.name: placed.field.codec for placed in interface.packet.header.placed}
    codec = codecs.get("shot")
    return 1 << codec.bits if isinstance(codec, Counter) else 0
