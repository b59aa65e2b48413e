"""Host side of the link: encode commands, and decode received bytes to messages.

Receivers accept any bytes and any frames: they raise no exception, hold a bounded amount of memory, and count what they
reject.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from lidar_protocol import can_frames, commands, packet
from lidar_protocol.can_frames import CanFrame
from lidar_protocol.commands import Argument
from lidar_protocol.definitions import CanMessage, Interface
from lidar_protocol.errors import DecodeError, Fault
from lidar_protocol.fields import Counter, Value
from lidar_protocol.framing import LinkCounters
from lidar_protocol.headers import Kind
from lidar_protocol.layout import Layout, joined
from lidar_protocol.packet import Acknowledge, Housekeeping, Message, Received


@dataclass(frozen=True, slots=True)
class Host:
    """Encoder of commands to a unit. It is stateless: the caller counts the sequence numbers."""

    interface: Interface
    unit: int = 0

    def encode_command(self, name: str, /, **values: Argument) -> bytes:
        """Encode a command as a framed packet.

        Args:
            name: name of the command.
            values: `sequence` and the arguments; numbers, or names of enumerations.

        Raises:
            EncodeError: the interface has no such command, or an argument is missing, unknown or cannot be sent.
        """
        return commands.encode(self.interface, self.unit, name, values)

    def encode_command_frame(self, name: str, /, **values: Argument) -> CanFrame:
        """Encode a command as a CAN frame; arguments and errors as in `encode_command`."""
        return commands.encode_frame(self.interface, self.unit, name, values)

    def encode_message(self, name: str, /, **values: Argument) -> bytes:
        """Encode a message that is no command, such as `navigation`, as a framed packet.

        Args:
            name: name of the message.
            values: `sequence` and all other fields by key: numbers, or names of enumerations. None and NaN stand for no
                value, where the field has a code for it.

        Raises:
            EncodeError: the interface has no such message, or a value is missing, unknown or cannot be sent.
        """
        return commands.encode_message(self.interface, self.unit, name, values)

    def encode_message_frames(self, name: str, /, **values: Argument) -> list[CanFrame]:
        """Encode a message as CAN frames, in the order of transmission; arguments and errors as in
        `encode_message`."""
        return commands.encode_message_frames(self.interface, self.unit, name, values)


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
    layout = interface.replies.get(kind)
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


@dataclass(slots=True)
class CanCounters:
    """Counters of received CAN traffic. Each transmitted shot is counted as a message, as incomplete or as lost."""

    frames: int = 0
    """Frames, good or bad."""
    messages: int = 0
    """Shots whose set was complete, acknowledgements, and frames of housekeeping."""
    unknown_ids: int = 0
    """Frames with an unknown identifier, or of the wrong frame format for it."""
    bad_length: int = 0
    """Frames whose length differs from their message's."""
    foreign: int = 0
    """Frames of another interface version."""
    orphans: int = 0
    """Frames that no open set expects, e.g. because the header of their shot was lost; they are dropped."""
    incomplete: int = 0
    """Shots of which a frame is missing after the header, or whose header has an impossible number of beams;
    dropped."""
    sequence_gaps: int = 0
    """Number of gaps in the shot counter of headers."""
    lost_shots: int = 0
    """Shots without a header, modulo the cycle of the shot counter in each gap.

    A restart of the device cannot be distinguished from a gap by the counter: it counts as a gap of less than a cycle.
    """


class _Set(NamedTuple):
    places: dict[int, int]
    """Index of each identifier's frame in `_Shot.parts`: messages of the whole shot first, then beam by beam."""
    rest: Layout | None
    """Joined layout of the messages of the whole shot after the header."""
    beam: Layout | None
    """Joined layout of all messages of a beam."""
    flags: tuple[tuple[str, slice, frozenset[bytes]], ...]
    """Flags implied by the content of a message: name, indices of the message, and contents for which it is false."""


_NO_SET = _Set({}, None, None, ())


@dataclass(slots=True)
class _Shot:
    unit: int
    counter: int | None = None
    """None before the first header."""
    header: dict[str, Value] = field(default_factory=dict)
    can_set: _Set = _NO_SET
    awaited: dict[int, int] = field(default_factory=dict)
    """Identifiers not received yet, with their indices; empty once the shot is complete or dropped."""
    parts: list[bytes] = field(default_factory=list)
    """Data of the frames after the header."""


class _Expected(NamedTuple):
    shot: _Shot
    is_fd: bool
    length: int
    header: CanMessage | None
    """The message, if it is the header of a set."""


class CanReceiver:
    """Decoder of the frames of a CAN bus. It assembles one shot of each unit at a time, starting with its header.

    Messages after the header may arrive in any order. Without times of arrival one gap cannot be detected: the loss of
    everything from a frame of a set to the same frame of the set one cycle of the shot counter later.
    """

    def __init__(self, interface: Interface) -> None:
        self.counters = CanCounters()
        self._interface = interface
        self._can = can_frames.definition(interface)
        self._shift, self._mask = self._can.counter_shift, self._can.counter_mask
        self._shots = [_Shot(unit) for unit in range(interface.units)]
        self._expected = {
            can_id: _Expected(
                self._shots[unit],
                message.is_fd,
                message.layout.length,
                message if message.opens_set else None,
            )
            for can_id, (unit, message, _) in can_frames.addresses(interface).items()
        }
        self._blocks = can_frames.block_addresses(interface)
        self._sets: dict[tuple[int, str, int], _Set] = {}

    @property
    def buffered_frames(self) -> int:
        """Number of frames of incomplete shots; bounded by the number of identifiers."""
        return sum(1 + len(shot.parts) - len(shot.awaited) for shot in self._shots if shot.awaited)

    def receive(self, can_id: int, data: bytes, is_fd: bool) -> list[Received]:
        """Decode a frame; returns the message that it completes, if any."""
        counters = self.counters
        counters.frames += 1
        expected = self._expected.get(can_id)
        if expected is None or expected[1] != is_fd:
            return self._block(can_id, data, is_fd)
        shot, _, length, header = expected
        if len(data) != length:
            counters.bad_length += 1
            return []
        counter = data[0] >> self._shift & self._mask
        if header is not None:
            if not self._begin(shot, header, counter, data):
                return []
        else:
            place = shot.awaited.pop(can_id, None)
            if place is None or counter != shot.counter:
                counters.orphans += 1
                if place is not None or shot.awaited:
                    self._give_up(shot)
                return []
            shot.parts[place] = data
        if shot.awaited:
            return []
        counters.messages += 1
        return [_complete(shot)]

    def _begin(self, shot: _Shot, message: CanMessage, counter: int, data: bytes) -> bool:
        if shot.awaited:
            self._give_up(shot)
        if shot.counter is not None and (lost := (counter - shot.counter - 1) & self._mask):
            self.counters.sequence_gaps += 1
            self.counters.lost_shots += lost
        shot.counter = counter
        shot.header = header = message.layout.unpacking(data, 0)
        beam_count = int(header["beam_count"] or 0)
        details = header.pop("details", None)
        if not 0 < beam_count <= self._can.beam_slots:
            self.counters.incomplete += 1
            return False
        # A header without details belongs to one set alone.
        can_set = min(message.sets) if details is None else "full" if details else "core"
        key = shot.unit, can_set, beam_count
        shot.can_set = self._sets.get(key) or self._sets.setdefault(key, self._set(*key))
        shot.awaited = shot.can_set.places.copy()
        shot.parts = [b""] * len(shot.awaited)
        return True

    def _give_up(self, shot: _Shot) -> None:
        shot.awaited = {}
        self.counters.incomplete += 1

    def _block(self, can_id: int, data: bytes, is_fd: bool) -> list[Received]:
        if is_fd or can_id not in self._blocks:
            self.counters.unknown_ids += 1
            return []
        unit, block = self._blocks[can_id]
        if len(data) != block.layout.length:
            self.counters.bad_length += 1
            return []
        values = block.layout.unpack(data)
        if values.get("interface_version", self._interface.version) != self._interface.version:
            self.counters.foreign += 1
            return []
        self.counters.messages += 1
        if block is self._can.acknowledge:
            return [acknowledge(self._interface, unit, values)]
        return [Housekeeping(unit, values)]

    def _set(self, unit: int, can_set: str, beam_count: int) -> _Set:
        _, *messages = self._can.sets.get(can_set, (None,))
        rest = [message for message in messages if not message.each_beam]
        own = [message for message in messages if message.each_beam]
        order = [(message, 0) for message in rest]
        order += [(message, slot) for slot in range(beam_count) for message in own]
        return _Set(
            places={self._can.can_id(unit, *each): place for place, each in enumerate(order)},
            rest=joined([message.layout for message in rest]) if rest else None,
            beam=joined([message.layout for message in own]) if own else None,
            flags=tuple(
                (
                    message.absent_unless,
                    slice(len(rest) + k, None, len(own)),
                    frozenset(message.absent_blocks),
                )
                for k, message in enumerate(own)
                if message.absent_unless is not None
            ),
        )


def _complete(shot: _Shot) -> Message:
    _, rest, beam, flags = shot.can_set
    parts, header = shot.parts, shot.header
    data = b"".join(parts)
    if rest is not None:
        header |= rest.unpacking(data, 0)
        data = data[rest.length :]
    beams = beam.unpacking_each(data) if beam else [{} for _ in range(int(header["beam_count"] or 0))]
    for flag, places, absent in flags:
        for values, own in zip(beams, parts[places], strict=True):
            values[flag] = own not in absent
    return Message(shot.unit, header, tuple(beams))
