"""Interface definitions as frozen data: everything that sender and receiver must agree upon."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from lidar_protocol.compiled import Pack
from lidar_protocol.crc import Crc
from lidar_protocol.field_table import Enumerations
from lidar_protocol.fields import Value
from lidar_protocol.framing import Framing
from lidar_protocol.headers import PacketHeader
from lidar_protocol.layout import ByteOrder, Layout

CanSet = Literal["core", "full", "fd"]
"""The messages of one shot: what a classic bus can carry at speed, everything on a classic bus, or CAN FD."""

Covered = Literal["packet", "body", "frame"]
"""What a CRC is computed over: all of the packet before it, that without its header, or all of the frame."""


@dataclass(frozen=True)
class ByteLink:
    """How packets travel on a serial line."""

    framing: Framing
    header: PacketHeader
    crc: Crc | None
    covered: Covered
    byte_order: ByteOrder
    """Of the CRC."""

    @cached_property
    def crc_length(self) -> int:
        """Bytes of the CRC."""
        return 0 if self.crc is None else self.crc.length

    @cached_property
    def checksum(self) -> Callable[[bytes], int]:
        """From what is covered to the CRC."""
        assert self.crc is not None
        return self.crc.function

    @cached_property
    def overhead(self) -> int:
        """Bytes of a packet beside its body."""
        return self.header.length + self.crc_length


@dataclass(frozen=True)
class PacketDefinition:
    """The body of a measurement: `header`, then `beam`, if there is one, for each beam."""

    header: Layout
    beam: Layout | None
    maximum_beams: int

    @cached_property
    def of_beams(self) -> tuple[tuple[str, str, int], ...]:
        """The fields of the header that belong to a beam: key, name and beam."""
        fields = (placed.field for placed in self.header.placed)
        return tuple((field.key, field.name, field.beam) for field in fields if field.beam is not None)

    @cached_property
    def beams_in_header(self) -> int:
        """How many beams the fields of the header belong to."""
        return max((beam + 1 for _, _, beam in self.of_beams), default=0)

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of all fields."""
        return self.header.names | (self.beam.names if self.beam else frozenset())

    @property
    def longest(self) -> int:
        """Bytes of the longest body."""
        return self.header.length + (self.maximum_beams * self.beam.length if self.beam else 0)


@dataclass(frozen=True)
class CommandDefinition:
    """A command: on a byte link code, sequence number and arguments; on CAN its identifier stands for the code."""

    name: str
    code: int
    meaning: str
    packet: Layout
    arguments: tuple[str, ...]
    can: Layout | None
    can_id: int | None
    """Relative to the unit's first identifier."""


@dataclass(frozen=True)
class Commands:
    """What a host can ask for."""

    header: Layout
    """The fields with which every command starts, `command` and `sequence` among them."""
    commands: tuple[CommandDefinition, ...]

    @cached_property
    def by_name(self) -> Mapping[str, CommandDefinition]:
        return {command.name: command for command in self.commands}

    @cached_property
    def by_code(self) -> Mapping[int, CommandDefinition]:
        return {command.code: command for command in self.commands}

    @cached_property
    def sequence_steps(self) -> int:
        """How many sequence numbers there are; after the last one comes 0."""
        return next(1 << p.field.codec.bits for p in self.header.placed if p.field.name == "sequence")


@dataclass(frozen=True)
class CanMessage:
    """A message, or one for each beam slot."""

    name: str
    id: int
    """Relative to the unit's first identifier; of slot 0."""
    each_beam: bool
    sets: frozenset[str]
    absent_unless: str | None
    """Flag without which a beam's message is sent as absent, and which its reception implies."""
    layout: Layout

    @property
    def is_fd(self) -> bool:
        return "fd" in self.sets

    @cached_property
    def opens_set(self) -> bool:
        """It is the header, which states how many beams follow."""
        return "beam_count" in self.layout.names

    @cached_property
    def absent_blocks(self) -> tuple[bytes, ...]:
        """An absent beam's message, for each value of the shot counter."""
        bits, absent = self.layout.placed[0].field.codec.bits, self.layout.absent
        shift = 8 - bits if self.layout.byte_order == "big" else 0
        return tuple(bytes((absent[0] | n << shift,)) + absent[1:] for n in range(1 << bits))

    @cached_property
    def absent_set(self) -> frozenset[bytes]:
        """The same, to look up."""
        return frozenset(self.absent_blocks)


@dataclass(frozen=True)
class CanBlock:
    """A message that stands alone: an acknowledgement, or a part of the housekeeping."""

    name: str
    id: int
    layout: Layout


class CanPlan(NamedTuple):
    """What is the same in every shot of a unit, a set and a number of beams."""

    identifiers: tuple[int, ...]
    are_fd: tuple[bool, ...]
    messages: tuple[tuple[Pack, bool, str | None, tuple[bytes, ...]], ...]
    """How a message is packed, whether it is one for each beam, the flag without which a beam is absent, and what is
    sent of it then, for each shot counter."""
    own: dict[str, Value]
    """What the library fills in, but for the shot counter."""


@dataclass(frozen=True)
class CanDefinition:
    """Identifiers and messages on CAN."""

    id_base: int
    unit_stride: int
    beam_slots: int
    counter_bits: int
    """Of the shot counter, with which every message of a shot starts."""
    messages: tuple[CanMessage, ...]
    acknowledge: CanBlock | None
    housekeeping: tuple[CanBlock, ...]

    def shot_counter(self, data: bytes) -> int:
        """The counter with which every message of a shot starts."""
        return data[0] >> self.counter_shift & self.counter_mask

    def can_id(self, unit: int, message: CanMessage | CanBlock, slot: int = 0) -> int:
        """The identifier of a unit's message."""
        return self.id_base + unit * self.unit_stride + message.id + slot

    @cached_property
    def blocks(self) -> tuple[CanBlock, ...]:
        """The messages that stand alone."""
        return (*([self.acknowledge] if self.acknowledge else []), *self.housekeeping)

    @cached_property
    def plans(self) -> dict[tuple[int, CanSet, int], CanPlan]:
        """Those that were needed so far: by unit, set and number of beams."""
        return {}

    @cached_property
    def counter_mask(self) -> int:
        return (1 << self.counter_bits) - 1

    @cached_property
    def counter_shift(self) -> int:
        return 8 - self.counter_bits if self.messages[0].layout.byte_order == "big" else 0

    @cached_property
    def sets(self) -> Mapping[str, tuple[CanMessage, ...]]:
        """The messages of each set, in the order of sending."""
        names = {name: None for message in self.messages for name in sorted(message.sets)}
        return {name: tuple(each for each in self.messages if name in each.sets) for name in names}


@dataclass(frozen=True)
class Interface:
    """Everything that sender and receiver must agree upon."""

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

    @cached_property
    def maximum_packet_bytes(self) -> int:
        """Length of the longest packet from the device, header and CRC included."""
        others = [layout.length for layout in (self.acknowledge, self.housekeeping) if layout is not None]
        return self.link.overhead + max(self.packet.longest, *others, 0)

    @cached_property
    def longest_command(self) -> int:
        """Length of the longest packet to the device."""
        bodies = [command.packet.length for command in self.commands.commands] if self.commands else [0]
        return self.link.overhead + max(bodies)

    @cached_property
    def maximum_command_bytes(self) -> int:
        """Up to where packets to the device are read: so that a command that is too long is told from noise."""
        return self.longest_command + 64

    def word(self, enumeration: str | None, value: int) -> str | None:
        """The name of a value of an enumeration; None where it has none."""
        words = self.enumerations.get(enumeration or "", {})
        return next((word for word, own in words.items() if own == value), None)
