"""The host's side of the link: bytes or frames in, messages out, whatever arrives.

The receivers raise nothing and hold a bounded amount of memory; what could not be used is counted.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from lidar_protocol import can_frames, cobs, packet
from lidar_protocol.can_frames import Address
from lidar_protocol.definitions import COUNTER_BITS, Interface
from lidar_protocol.errors import DecodeError, Fault
from lidar_protocol.fields import Value
from lidar_protocol.message import Message

_SHOT_CYCLE = 1 << 32
_COUNTER_CYCLE = 1 << COUNTER_BITS


@dataclass(slots=True)
class SerialCounters:
    """What has come in on a byte link."""

    frames: int = 0
    """Runs of bytes between delimiters, good or bad; empty ones do not count."""
    messages: int = 0
    """Frames that held a good packet."""
    bad_cobs: int = 0
    """Frames that cannot be unstuffed."""
    bad_length: int = 0
    """Frames that are too long, or not as long as they state."""
    bad_crc: int = 0
    """Packets with a wrong CRC."""
    foreign: int = 0
    """Good packets of another kind, APID or interface version."""
    skipped_bytes: int = 0
    """Bytes in frames that held no message, delimiters left out."""
    sequence_gaps: int = 0
    """Times that shots were missing between two messages of a unit."""
    lost_packets: int = 0
    """Shots that were missing."""
    restarts: int = 0
    """Times that a unit's shot number did not go up."""

    def count(self, fault: Fault) -> None:
        """One more of a kind."""
        setattr(self, fault, getattr(self, fault) + 1)


class SerialReceiver:
    """Messages out of a stream of bytes, in any portions."""

    def __init__(self, interface: Interface) -> None:
        self.counters = SerialCounters()
        self._interface = interface
        self._longest = cobs.stuffed_length(interface.maximum_packet_bytes)
        self._frame = bytearray()
        self._too_long = False
        self._last_shots: dict[int, int] = {}

    @property
    def buffered_bytes(self) -> int:
        """Bytes of a frame whose end has not come yet; never more than the longest frame."""
        return len(self._frame)

    def receive(self, data: bytes) -> list[Message]:
        """The messages that are complete with `data`."""
        *endings, rest = data.split(cobs.DELIMITER)
        messages: list[Message] = []
        for ending in endings:
            self._append(ending)
            message = self._end_of_frame()
            if message is not None:
                messages.append(message)
        self._append(rest)
        return messages

    def _append(self, piece: bytes) -> None:
        if self._too_long or len(self._frame) + len(piece) > self._longest:
            self.counters.skipped_bytes += len(self._frame) + len(piece)
            self._frame.clear()
            self._too_long = True
        else:
            self._frame += piece

    def _end_of_frame(self) -> Message | None:
        frame, too_long = bytes(self._frame), self._too_long
        self._frame.clear()
        self._too_long = False
        if not frame and not too_long:
            return None
        self.counters.frames += 1
        try:
            if too_long:
                raise DecodeError(Fault.BAD_LENGTH, "longer than the longest packet")
            message = packet.decode(self._interface, cobs.decode(frame))
        except DecodeError as error:
            self.counters.count(error.fault)
            self.counters.skipped_bytes += len(frame)
            return None
        self.counters.messages += 1
        self._count_missing(message)
        return message

    def _count_missing(self, message: Message) -> None:
        shot = message.shot
        if shot is None:
            return
        last = self._last_shots.get(message.unit, shot - 1)
        self._last_shots[message.unit] = shot
        missing = (shot - last - 1) % _SHOT_CYCLE
        if missing >= _SHOT_CYCLE // 2:
            self.counters.restarts += 1
        elif missing:
            self.counters.sequence_gaps += 1
            self.counters.lost_packets += missing


@dataclass(slots=True)
class CanCounters:
    """What has come in from a CAN bus. Each shot sent is a message, incomplete or lost."""

    frames: int = 0
    """Frames, good or bad."""
    messages: int = 0
    """Shots whose set was complete."""
    unknown_ids: int = 0
    """Frames with an identifier of something else, or the wrong kind of frame for it."""
    bad_length: int = 0
    """Frames that are not as long as their message."""
    orphans: int = 0
    """Frames that no open set waits for, as where the header of their shot was lost; they are dropped."""
    incomplete: int = 0
    """Shots whose header came, but not all that it announced, or no possible number of beams; they are dropped."""
    sequence_gaps: int = 0
    """Times that the header's counter was not the next one."""
    lost_shots: int = 0
    """Shots whose header did not come, modulo 16 in each gap.

    The counter alone does not tell a restart of the device from a gap: it counts as a gap of 0 to 15 shots.
    """


_Place = tuple[str, int]
"""Name and slot of a message."""


@dataclass(slots=True)
class _Shot:
    """What has come in of a shot, from its header on."""

    counter: int
    beam_count: int
    expected: frozenset[_Place]
    seen: set[_Place] = field(default_factory=set)
    header: dict[str, Value] = field(default_factory=dict)
    beams: dict[int, dict[str, Value]] = field(default_factory=dict)
    open: bool = True
    """Neither complete nor given up."""


class CanReceiver:
    """Messages out of the frames of a bus: one shot of each unit at a time, from its header on.

    The messages after the header may come in any order. Without times of arrival one gap cannot be seen: one that
    goes from some frame of a set to the same frame of the sixteenth set after it.
    """

    def __init__(self, interface: Interface) -> None:
        self.counters = CanCounters()
        self._can = interface.can
        self._addresses = can_frames.addresses(interface)
        self._shots: dict[int, _Shot] = {}

    @property
    def buffered_frames(self) -> int:
        """Frames of shots that are not complete yet; never more than a unit has identifiers."""
        return sum(len(shot.seen) for shot in self._shots.values() if shot.open)

    def receive(self, can_id: int, data: bytes, is_fd: bool) -> list[Message]:
        """The message that is complete with this frame, if there is one."""
        self.counters.frames += 1
        address = self._addresses.get((can_id, is_fd))
        if address is None:
            self.counters.unknown_ids += 1
            return []
        if len(data) != address.message.layout.length:
            self.counters.bad_length += 1
            return []
        values = can_frames.decode(address.message, data)
        counter = int(values.pop("shot_counter") or 0)
        shot = (
            self._begin(address, counter, values)
            if address.message.opens_set
            else self._open(address, counter)
        )
        if shot is None:
            return []
        self._take(shot, address, values)
        if shot.seen != shot.expected:
            return []
        shot.open = False
        self.counters.messages += 1
        beams = (shot.beams[slot] for slot in range(shot.beam_count))
        return [Message(address.unit, shot.header, tuple(beams))]

    def _begin(self, address: Address, counter: int, header: dict[str, Value]) -> _Shot | None:
        """The shot of this header; None if it states no possible number of beams."""
        self._give_up(address.unit)
        last = self._shots.get(address.unit)
        if last is not None:
            missing = (counter - last.counter - 1) % _COUNTER_CYCLE
            self.counters.sequence_gaps += missing > 0
            self.counters.lost_shots += missing
        beam_count = int(header["beam_count"] or 0)
        details = header.pop("details", False)
        can_set = "fd" if address.message.is_fd else "full" if details else "core"
        shot = _Shot(counter, beam_count, self._expected(can_set, beam_count))
        self._shots[address.unit] = shot
        if not beam_count:
            self._give_up(address.unit)
            return None
        return shot

    def _open(self, address: Address, counter: int) -> _Shot | None:
        """The unit's open shot, if it waits for this message; otherwise that shot is over."""
        shot, place = self._shots.get(address.unit), (address.message.name, address.slot)
        if shot is not None and shot.open and counter == shot.counter and place in shot.expected - shot.seen:
            return shot
        self.counters.orphans += 1
        self._give_up(address.unit)
        return None

    def _give_up(self, unit: int) -> None:
        """No more frames for the unit's shot."""
        shot = self._shots.get(unit)
        if shot is not None and shot.open:
            shot.open = False
            self.counters.incomplete += 1

    def _take(self, shot: _Shot, address: Address, values: dict[str, Value]) -> None:
        message, slot = address.message, address.slot
        shot.seen.add((message.name, slot))
        if message.each_beam:
            shot.beams.setdefault(slot, {}).update(values)
        else:
            shot.header.update(values)

    def _expected(self, can_set: str, beam_count: int) -> frozenset[_Place]:
        return frozenset(
            (message.name, slot)
            for message in self._can.messages
            if can_set in message.sets
            for slot in range(beam_count if message.each_beam else 1)
        )
