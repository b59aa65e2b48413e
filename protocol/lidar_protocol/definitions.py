"""Interface definitions as frozen data classes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from lidar_protocol.crc import Crc
from lidar_protocol.definition_fields import Enumerations
from lidar_protocol.fields import Value
from lidar_protocol.framing import Framing
from lidar_protocol.headers import Kind, PacketHeader
from lidar_protocol.layout import ByteOrder, Layout, Pack

CanSet = Literal["core", "full", "fd"]
"""Set of messages for one shot: the essential values on classic CAN, all values on classic CAN, or CAN FD."""

Covered = Literal["packet", "body", "frame"]
"""Bytes that a CRC covers: the packet before it, the packet without its header, or the whole frame before it."""


@dataclass(frozen=True)
class ByteLink:
    """Framing, header and CRC of packets on a byte link."""

    framing: Framing
    header: PacketHeader
    crc: Crc | None
    covered: Covered
    byte_order: ByteOrder
    """Byte order of the CRC."""

    @cached_property
    def crc_length(self) -> int:
        """Length of the CRC in bytes; 0 without a CRC."""
        return 0 if self.crc is None else self.crc.length

    @cached_property
    def checksum(self) -> Callable[[bytes], int]:
        """Function from the covered bytes to the CRC."""
        assert self.crc is not None
        return self.crc.function

    @cached_property
    def overhead(self) -> int:
        """Length in bytes of header and CRC."""
        return self.header.length + self.crc_length


@dataclass(frozen=True)
class PacketDefinition:
    """Body of a measurement: the block `header`, then for each beam the block `beam`, if there is one."""

    header: Layout
    beam: Layout | None
    maximum_beams: int

    @cached_property
    def of_beams(self) -> tuple[tuple[str, str, int], ...]:
        """Fields of the header that belong to a beam: key, name and beam number."""
        fields = (placed.field for placed in self.header.placed)
        return tuple((field.key, field.name, field.beam) for field in fields if field.beam is not None)

    @cached_property
    def beams_in_header(self) -> int:
        """Number of beams that have fields in the header."""
        return max((beam + 1 for _, _, beam in self.of_beams), default=0)

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of all fields."""
        return self.header.names | (self.beam.names if self.beam else frozenset())

    @property
    def longest(self) -> int:
        """Length in bytes of the longest body."""
        return self.header.length + (self.maximum_beams * self.beam.length if self.beam else 0)


@dataclass(frozen=True)
class CommandDefinition:
    """A command: code, sequence number and arguments on a byte link; on CAN the identifier replaces the code."""

    name: str
    code: int
    meaning: str
    packet: Layout
    arguments: tuple[str, ...]
    can: Layout | None
    can_id: int | None
    """Identifier on CAN, relative to the first identifier of the unit."""


@dataclass(frozen=True)
class HostMessageDefinition(CommandDefinition):
    """A message that the host sends unasked, such as its navigation solution: laid out as a command, and never
    acknowledged; on CAN it is divided into frames."""

    can_parts: tuple[CanBlock, ...] = ()
    """Frames on CAN in the order of transmission, each with the sequence number; empty: not sent on CAN."""


@dataclass(frozen=True)
class Commands:
    """Commands of an interface, and the other messages of the host."""

    header: Layout
    """Fields at the start of every command and message, including `command` and `sequence`."""
    commands: tuple[CommandDefinition, ...]
    messages: tuple[HostMessageDefinition, ...] = ()

    @cached_property
    def by_name(self) -> Mapping[str, CommandDefinition]:
        return {command.name: command for command in self.commands}

    @cached_property
    def messages_by_name(self) -> Mapping[str, HostMessageDefinition]:
        return {message.name: message for message in self.messages}

    @cached_property
    def packets(self) -> tuple[CommandDefinition, ...]:
        """Commands and messages: all packets of the host."""
        return (*self.commands, *self.messages)

    @cached_property
    def by_code(self) -> Mapping[int, CommandDefinition]:
        """Commands and messages by their codes, which are unique among both."""
        return {packet.code: packet for packet in self.packets}

    @cached_property
    def sequence_steps(self) -> int:
        """Number of sequence numbers, after which they wrap to 0."""
        return next(1 << p.field.codec.bits for p in self.header.placed if p.field.name == "sequence")


@dataclass(frozen=True)
class CanMessage:
    """A CAN message of a measurement, sent once or for each beam slot."""

    name: str
    id: int
    """Identifier of slot 0, relative to the first identifier of the unit."""
    each_beam: bool
    sets: frozenset[str]
    absent_unless: str | None
    """Flag of the beam: if it is false, the message is sent as absent; any other content implies that it is true."""
    layout: Layout

    @property
    def is_fd(self) -> bool:
        return "fd" in self.sets

    @cached_property
    def opens_set(self) -> bool:
        """Whether the message is the header of a set, which holds the number of beams."""
        return "beam_count" in self.layout.names

    @cached_property
    def absent_blocks(self) -> tuple[bytes, ...]:
        """Message of an absent beam for each value of the shot counter."""
        bits, absent = self.layout.placed[0].field.codec.bits, self.layout.absent
        shift = 8 - bits if self.layout.byte_order == "big" else 0
        return tuple(bytes((absent[0] | n << shift,)) + absent[1:] for n in range(1 << bits))


@dataclass(frozen=True)
class CanBlock:
    """A single CAN message: an acknowledgement, or a part of the housekeeping."""

    name: str
    id: int
    layout: Layout


class CanPlan(NamedTuple):
    """Cached values that are the same in all shots with one unit, set and number of beams."""

    identifiers: tuple[int, ...]
    are_fd: tuple[bool, ...]
    messages: tuple[tuple[Pack, bool, str | None, tuple[bytes, ...]], ...]
    """For each message: its packing function, whether it is sent for each beam, the flag of absent beams, and the
    message of an absent beam for each shot counter."""
    own: dict[str, Value]
    """Fields that the library fills in, except the shot counter."""


@dataclass(frozen=True)
class CanDefinition:
    """CAN part of an interface: identifiers and messages."""

    id_base: int
    unit_stride: int
    beam_slots: int
    counter_bits: int
    """Length in bits of the shot counter at the start of every message of a shot."""
    messages: tuple[CanMessage, ...]
    acknowledge: CanBlock | None
    housekeeping: tuple[CanBlock, ...]

    def can_id(self, unit: int, message: CanMessage | CanBlock, slot: int = 0) -> int:
        """Identifier of a message of a unit."""
        return self.id_base + unit * self.unit_stride + message.id + slot

    @cached_property
    def blocks(self) -> tuple[CanBlock, ...]:
        """Acknowledgement and housekeeping messages."""
        return (*([self.acknowledge] if self.acknowledge else []), *self.housekeeping)

    @cached_property
    def plans(self) -> dict[tuple[int, CanSet, int], CanPlan]:
        """Cache of plans, by unit, set and number of beams."""
        return {}

    @cached_property
    def counter_mask(self) -> int:
        return (1 << self.counter_bits) - 1

    @cached_property
    def counter_shift(self) -> int:
        return 8 - self.counter_bits if self.messages[0].layout.byte_order == "big" else 0

    @cached_property
    def sets(self) -> Mapping[str, tuple[CanMessage, ...]]:
        """Messages of each set, in the order of transmission."""
        names = {name: None for message in self.messages for name in sorted(message.sets)}
        return {name: tuple(each for each in self.messages if name in each.sets) for name in names}


@dataclass(frozen=True)
class Interface:
    """An interface definition: everything that device and host must agree on."""

    name: str
    version: int
    units: int
    epoch: str
    byte_order: ByteOrder
    enumerations: Enumerations
    link: ByteLink
    packet: PacketDefinition
    commands: Commands | None
    acknowledge: Layout | None
    housekeeping: Layout | None
    can: CanDefinition | None
    serial_format: str
    """Characters of a UART: data bits, parity (N, E or O) and stop bits, as `8N1`."""

    @cached_property
    def replies(self) -> dict[Kind, Layout]:
        """Bodies of acknowledgements and of housekeeping, as far as the interface has them, by the kind of packet."""
        known: dict[Kind, Layout | None] = {
            "acknowledge": self.acknowledge,
            "housekeeping": self.housekeeping,
        }
        return {kind: layout for kind, layout in known.items() if layout is not None}

    @cached_property
    def maximum_packet_bytes(self) -> int:
        """Length of the longest packet from the device, including header and CRC."""
        return self.link.overhead + max(
            self.packet.longest, *(each.length for each in self.replies.values()), 0
        )

    @cached_property
    def longest_command(self) -> int:
        """Length of the longest command."""
        bodies = [command.packet.length for command in self.commands.commands] if self.commands else [0]
        return self.link.overhead + max(bodies)

    @cached_property
    def maximum_command_bytes(self) -> int:
        """Maximum length of packets that a device reads. It exceeds the longest one, so that a command that is too
        long is rejected as malformed instead of being counted as noise."""
        return max(self.longest_command, self.longest_host_message) + 64

    @cached_property
    def longest_host_message(self) -> int:
        """Length of the longest message of the host; 0 if it has none."""
        messages = self.commands.messages if self.commands else ()
        return max((self.link.overhead + message.packet.length for message in messages), default=0)

    def word(self, enumeration: str | None, value: int) -> str | None:
        """Name of a value of an enumeration; None if it has no name."""
        words = self.enumerations.get(enumeration or "", {})
        return next((word for word, own in words.items() if own == value), None)
