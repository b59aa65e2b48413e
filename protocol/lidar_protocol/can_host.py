"""The host's side of a CAN bus: frames in, messages on, whatever arrives.

The receiver raises nothing and holds a bounded amount of memory; what could not be used is counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from lidar_protocol import can_frames
from lidar_protocol.can_frames import Address
from lidar_protocol.definitions import CanBlock, CanMessage, Interface
from lidar_protocol.fields import Value
from lidar_protocol.host import acknowledge
from lidar_protocol.message import Acknowledge, Housekeeping, Message, Received


@dataclass(slots=True)
class CanCounters:
    """What has come in from a CAN bus. Each shot sent is a message, incomplete or lost."""

    frames: int = 0
    """Frames, good or bad."""
    messages: int = 0
    """Shots whose set was complete, acknowledgements, and frames of housekeeping."""
    unknown_ids: int = 0
    """Frames with an identifier of something else, or the wrong kind of frame for it."""
    bad_length: int = 0
    """Frames that are not as long as their message."""
    foreign: int = 0
    """Frames of another interface version."""
    orphans: int = 0
    """Frames that no open set waits for, as where the header of their shot was lost; they are dropped."""
    incomplete: int = 0
    """Shots whose header came, but not all that it announced, or no possible number of beams; they are dropped."""
    sequence_gaps: int = 0
    """Times that the header's counter was not the next one."""
    lost_shots: int = 0
    """Shots whose header did not come, modulo the cycle of the shot counter in each gap.

    The counter alone does not tell a restart of the device from a gap: it counts as a gap of less than a cycle.
    """


_NOTHING: dict[str, Value] = {}
"""What is known of a beam before its first message; replaced, never filled."""


class _Listened(NamedTuple):
    """What to do with an identifier."""

    unit: int
    length: int
    unpack: Callable[[bytes, int], dict[str, Value]]
    flag: str | None
    absent: frozenset[bytes]
    bit: int
    """Stands for its place in a set."""
    message: CanMessage
    slot: int | None
    """Place in `_Shot.beams`; None of a message that begins a shot."""


@dataclass(slots=True)
class _Shot:
    """What has come in of a shot, from its header on."""

    counter: int
    missing: int
    """Bits of what it still waits for; 0 once it is complete or given up."""
    expected: int
    """Bits of all that it waits for."""
    beams: list[dict[str, Value]]
    """The header, then the beams."""


class CanReceiver:
    """Messages out of the frames of a bus: one shot of each unit at a time, from its header on.

    The messages after the header may come in any order. Without times of arrival one gap cannot be seen: one that
    goes from some frame of a set to the same frame of the set one cycle of the shot counter after it.
    """

    def __init__(self, interface: Interface) -> None:
        self.counters = CanCounters()
        self._interface = interface
        self._can = can_frames.definition(interface)
        self._shift, self._mask = self._can.counter_shift, self._can.counter_mask
        self._bits: dict[tuple[str, int], int] = {}
        self._listened = {
            key: self._listen(address) for key, address in can_frames.addresses(interface).items()
        }
        self._blocks = can_frames.block_addresses(interface)
        self._expected: dict[tuple[str, int], int] = {}
        self._shots: dict[int, _Shot] = {}

    @property
    def buffered_frames(self) -> int:
        """Frames of shots that are not complete yet; never more than a unit has identifiers."""
        shots = (shot for shot in self._shots.values() if shot.missing)
        return sum((shot.expected & ~shot.missing).bit_count() for shot in shots)

    def receive(self, can_id: int, data: bytes, is_fd: bool) -> list[Received]:
        """The message that is complete with this frame, if there is one."""
        counters = self.counters
        counters.frames += 1
        listened = self._listened.get((can_id, is_fd))
        if listened is None:
            return self._block(can_id, data, is_fd)
        unit, length, unpack, flag, absent, bit, message, slot = listened
        if len(data) != length:
            counters.bad_length += 1
            return []
        counter = data[0] >> self._shift & self._mask
        if slot is None:
            shot = self._begin(unit, message, counter, unpack(data, 0))
            if shot is None:
                return []
        else:
            known = self._shots.get(unit)
            if known is None or not known.missing & bit or counter != known.counter:
                counters.orphans += 1
                self._give_up(unit)
                return []
            shot = known
            values = unpack(data, 0)
            if flag is not None:
                values[flag] = data not in absent
            known_values = shot.beams[slot]
            shot.beams[slot] = known_values | values if known_values else values
        shot.missing &= ~bit
        if shot.missing:
            return []
        counters.messages += 1
        header, *beams = shot.beams
        return [Message(unit, header, tuple(beams))]

    def _begin(self, unit: int, message: CanMessage, counter: int, header: dict[str, Value]) -> _Shot | None:
        """The shot of this header; None if it states no possible number of beams."""
        last = self._shots.get(unit)
        if last is not None:
            self._give_up(unit)
            missing = (counter - last.counter - 1) & self._mask
            if missing:
                self.counters.sequence_gaps += 1
                self.counters.lost_shots += missing
        beam_count = int(header["beam_count"] or 0)
        details = header.pop("details", None)
        if not 0 < beam_count <= self._can.beam_slots:
            self.counters.incomplete += 1
            self._shots[unit] = _Shot(counter, 0, 0, [])
            return None
        # A header without details is that of one set alone.
        can_set = min(message.sets) if details is None else "full" if details else "core"
        expected = self._places(can_set, beam_count)
        shot = _Shot(counter, expected, expected, [header, *[_NOTHING] * beam_count])
        self._shots[unit] = shot
        return shot

    def _give_up(self, unit: int) -> None:
        """No more frames for the unit's shot."""
        shot = self._shots.get(unit)
        if shot is not None and shot.missing:
            shot.missing = shot.expected = 0
            self.counters.incomplete += 1

    def _block(self, can_id: int, data: bytes, is_fd: bool) -> list[Received]:
        """An acknowledgement, or a part of the housekeeping."""
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
        return [self._read(unit, block, values)]

    def _read(self, unit: int, block: CanBlock, values: dict[str, Value]) -> Acknowledge | Housekeeping:
        if block is self._can.acknowledge:
            return acknowledge(self._interface, unit, values)
        return Housekeeping(unit, values)

    def _listen(self, address: Address) -> _Listened:
        unit, message, slot = address
        layout, flag = message.layout, message.absent_unless
        place = None if message.opens_set else slot + 1 if message.each_beam else 0
        bit = self._bits.setdefault((message.name, slot), 1 << len(self._bits))
        absent = message.absent_set if flag else frozenset[bytes]()
        return _Listened(unit, layout.length, layout.unpacking, flag, absent, bit, message, place)

    def _places(self, can_set: str, beam_count: int) -> int:
        """The bits of all messages of a set."""
        if (can_set, beam_count) not in self._expected:
            self._expected[can_set, beam_count] = sum(
                self._bits[message.name, slot]
                for message in self._can.sets.get(can_set, ())
                for slot in range(beam_count if message.each_beam else 1)
            )
        return self._expected[can_set, beam_count]
