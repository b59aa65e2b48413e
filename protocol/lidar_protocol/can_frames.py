"""A shot as CAN frames: the messages of one set, those of the whole shot first, then slot by slot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from lidar_protocol.definitions import COUNTER_BITS, CanMessage, CanSet, Interface
from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Value

Values = Mapping[str, Value]

_COUNTER_SHIFT = 8 - COUNTER_BITS


class CanFrame(NamedTuple):
    """A frame with a standard (11-bit) identifier."""

    can_id: int
    data: bytes
    is_fd: bool = False
    bitrate_switch: bool = False


class Address(NamedTuple):
    """Whose and which message an identifier stands for."""

    unit: int
    message: CanMessage
    slot: int


def encode(
    interface: Interface, unit: int, can_set: CanSet, header: Values, beams: Sequence[Values]
) -> list[CanFrame]:
    """The frames of one shot.

    Args:
        unit: from 0.
        can_set: `core` and `full` are classic CAN, `fd` is CAN FD.
        header: as for a packet.
        beams: as for a packet; beam k takes slot k.

    Raises:
        EncodeError: a field is missing or cannot be sent, or there are more beams than slots.
    """
    can = interface.can
    if not 0 <= unit < interface.units:
        raise EncodeError(f"unit {unit}: allowed are 0 to {interface.units - 1}")
    if not 1 <= len(beams) <= can.beam_slots:
        raise EncodeError(f"{len(beams)} beams: there are {can.beam_slots} slots on CAN")
    shot = header.get("shot")
    filled_in = {
        "shot_counter": shot,
        "details": can_set == "full",
        "interface_version": interface.version,
        "beam_count": len(beams),
    }
    whole = {**header, **filled_in}
    slots = [{**beam, "shot_counter": shot} for beam in beams]
    frames: list[CanFrame] = []
    for message in can.messages:
        if can_set in message.sets:
            first_id, is_fd = can.can_id(unit, message), message.is_fd
            for slot, values in enumerate(slots if message.each_beam else (whole,)):
                frames.append(CanFrame(first_id + slot, _data(message, values), is_fd, is_fd))
    return frames


def decode(message: CanMessage, data: bytes) -> dict[str, Value]:
    """The values in a message of the right length, the flag that its reception implies included."""
    values = message.layout.unpack(data)
    if message.absent_unless is not None:
        absent = message.layout.absent
        values[message.absent_unless] = data[1:] != absent[1:] or _low(data) != _low(absent)
    return values


def addresses(interface: Interface) -> dict[tuple[int, bool], Address]:
    """Every identifier of every unit, with whether its frame is CAN FD."""
    can = interface.can
    return {
        (can.can_id(unit, message, slot), message.is_fd): Address(unit, message, slot)
        for unit in range(interface.units)
        for message in can.messages
        for slot in range(can.beam_slots if message.each_beam else 1)
    }


def shot_counter(data: bytes) -> int:
    """The counter with which every message starts."""
    return data[0] >> _COUNTER_SHIFT


def _data(message: CanMessage, values: Values) -> bytes:
    if message.absent_unless is None or values.get(message.absent_unless):
        return message.layout.pack(values)
    absent = message.layout.absent
    counter = int(values["shot_counter"] or 0) % (1 << COUNTER_BITS)
    return bytes((counter << _COUNTER_SHIFT | _low(absent),)) + absent[1:]


def _low(data: bytes) -> int:
    """What the first byte holds beside the counter."""
    return data[0] % (1 << _COUNTER_SHIFT)
