"""Host side of a byte link: encode commands, and decode received bytes to messages.

The receiver accepts any bytes: it raises no exception, holds a bounded amount of memory, and counts rejected bytes.
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
    """Encoder of commands to a unit. It is stateless: the caller counts the sequence numbers."""

    interface: Interface
    unit: int = 0

    def encode_command(self, name: str, **values: Argument) -> bytes:
        """Encode a command as a framed packet.

        Args:
            name: name of the command.
            values: `sequence` and the arguments; numbers, or names of enumerations.

        Raises:
            EncodeError: the interface has no such command, or an argument is missing, unknown or cannot be sent.
        """
        return commands.encode(self.interface, self.unit, name, values)

    def encode_command_frame(self, name: str, **values: Argument) -> CanFrame:
        """Encode a command as a CAN frame; arguments and errors as in `encode_command`."""
        return commands.encode_frame(self.interface, self.unit, name, values)


@dataclass(slots=True)
class SerialCounters(LinkCounters):
    """Counters of a receiver on a byte link."""

    sequence_gaps: int = 0
    """Number of gaps between the messages of a unit."""
    lost_packets: int = 0
    """Number of missing shots."""
    restarts: int = 0
    """Number of times that the shot number of a unit did not increase."""


class SerialReceiver:
    """Decoder of messages from a stream of bytes in portions of any size."""

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
        """Number of bytes that may belong to an incomplete frame; at most the longest frame."""
        return self._frames.buffered_bytes

    def receive(self, data: bytes) -> list[Received]:
        """Decode received bytes; returns the messages that they complete."""
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
    """Decode the body of an acknowledgement or of housekeeping.

    Raises:
        DecodeError: the kind, the length or the interface version is another one.
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
    """Make an acknowledgement of its fields, with names of the command and the verdict."""
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
    """Number of shots after which the shot number in a packet wraps; 0 if packets do not carry it."""
    codecs = {placed.field.name: placed.field.codec for placed in interface.packet.header.placed}
    codec = codecs.get("shot")
    return 1 << codec.bits if isinstance(codec, Counter) else 0
