"""A shot as CAN frames: the messages of one set, those of the whole shot first, then slot by slot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from lidar_protocol.definitions import (
    CanBlock,
    CanDefinition,
    CanMessage,
    CanSet,
    CommandDefinition,
    Interface,
)
from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Value
from lidar_protocol.packet import check_unit

Values = Mapping[str, Value]


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


def definition(interface: Interface) -> CanDefinition:
    """What the interface says of CAN.

    Raises:
        EncodeError: it says nothing.
    """
    if interface.can is None:
        raise EncodeError(f"the interface {interface.name} has no messages on CAN")
    return interface.can


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
    can = definition(interface)
    check_unit(interface, unit)
    if not 1 <= len(beams) <= can.beam_slots:
        raise EncodeError(f"{len(beams)} beams: there are {can.beam_slots} slots on CAN")
    if can_set not in can.sets:
        raise EncodeError(f"set {can_set}: the interface has {', '.join(can.sets)}")
    shot = header.get("shot")
    if shot is None:
        raise EncodeError("shot is missing: the shot counter follows from it")
    own: Values = {
        "shot_counter": shot,
        "details": can_set == "full",
        "interface_version": interface.version,
        "beam_count": len(beams),
    }
    counter = int(shot) % (1 << can.counter_bits)
    base, is_fd = can.id_base + unit * can.unit_stride, can_set == "fd"
    frames: list[CanFrame] = []
    new = tuple.__new__  # half the time of calling the class
    try:
        for message in can.sets[can_set]:
            can_id, pack = base + message.id, message.layout.packing
            if not message.each_beam:
                frames.append(new(CanFrame, (can_id, pack(header, own), is_fd, is_fd)))
                continue
            flag = message.absent_unless
            for beam in beams:
                here = flag is None or beam.get(flag)
                data = pack(beam, own) if here else message.absent_blocks[counter]
                frames.append(new(CanFrame, (can_id, data, is_fd, is_fd)))
                can_id += 1
    except KeyError as missing:
        raise EncodeError(f"{missing.args[0]} is missing") from None
    return frames


def addresses(interface: Interface) -> dict[tuple[int, bool], Address]:
    """Every identifier of every unit's shots, with whether its frame is CAN FD."""
    can = definition(interface)
    return {
        (can.can_id(unit, message, slot), message.is_fd): Address(unit, message, slot)
        for unit in range(interface.units)
        for message in can.messages
        for slot in range(can.beam_slots if message.each_beam else 1)
    }


def block_addresses(interface: Interface) -> dict[int, tuple[int, CanBlock]]:
    """Every identifier of acknowledgements and housekeeping: unit and message."""
    can = definition(interface)
    return {can.can_id(unit, block): (unit, block) for unit in range(interface.units) for block in can.blocks}


def command_addresses(interface: Interface, unit: int) -> dict[int, CommandDefinition]:
    """Every identifier of commands to a unit."""
    can = definition(interface)
    base = can.id_base + unit * can.unit_stride
    commands = interface.commands.commands if interface.commands else ()
    return {base + each.can_id: each for each in commands if each.can_id is not None}
