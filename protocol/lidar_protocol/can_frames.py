"""Encode a shot as CAN frames: the messages of one set, first for the whole shot, then slot by slot."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple, cast

from lidar_protocol.definitions import (
    CanBlock,
    CanDefinition,
    CanMessage,
    CanPlan,
    CanSet,
    CommandDefinition,
    HostMessageDefinition,
    Interface,
)
from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Value
from lidar_protocol.packet import check_unit

Values = Mapping[str, Value]


class CanFrame(NamedTuple):
    """A CAN frame with a standard (11-bit) identifier."""

    can_id: int
    data: bytes
    is_fd: bool = False
    bitrate_switch: bool = False


_frame = cast(Callable[[tuple[object, ...]], CanFrame], partial(tuple.__new__, CanFrame))
"""Make a frame of a tuple of its fields, in half the time of calling the class."""


class Address(NamedTuple):
    """Unit, message and slot of an identifier."""

    unit: int
    message: CanMessage
    slot: int


def definition(interface: Interface) -> CanDefinition:
    """CAN part of an interface.

    Raises:
        EncodeError: the interface has no messages on CAN.
    """
    if interface.can is None:
        raise EncodeError(f"the interface {interface.name} has no messages on CAN")
    return interface.can


def encode(
    interface: Interface, unit: int, can_set: CanSet, header: Values, beams: Sequence[Values]
) -> list[CanFrame]:
    """Encode one shot.

    Args:
        unit: unit number, from 0.
        can_set: `core` and `full` are classic CAN, `fd` is CAN FD.
        header: fields as for `packet.encode`.
        beams: fields as for `packet.encode`; beam k takes slot k.

    Raises:
        EncodeError: a field is missing or cannot be sent, or there are more beams than slots.
    """
    can = definition(interface)
    plan = can.plans.get((unit, can_set, len(beams))) or _plan(interface, can, unit, can_set, len(beams))
    shot = header.get("shot")
    if shot is None:
        raise EncodeError("shot is missing: the shot counter follows from it")
    counter = int(shot) & can.counter_mask
    own = {**plan.own, "shot_counter": counter}
    blocks: list[bytes] = []
    try:
        for pack, each_beam, flag, absent_blocks in plan.messages:
            if not each_beam:
                blocks.append(pack(header, own))
                continue
            for beam in beams:
                here = flag is None or beam[flag]
                blocks.append(pack(beam, own) if here else absent_blocks[counter])
    except KeyError as missing:
        raise EncodeError(f"{missing.args[0]} is missing") from None
    return [*map(_frame, zip(plan.identifiers, blocks, plan.are_fd, plan.are_fd))]  # noqa: B905


def _plan(interface: Interface, can: CanDefinition, unit: int, can_set: CanSet, beam_count: int) -> CanPlan:
    check_unit(interface, unit)
    if not 1 <= beam_count <= can.beam_slots:
        raise EncodeError(f"{beam_count} beams: there are {can.beam_slots} slots on CAN")
    if can_set not in can.sets:
        raise EncodeError(f"set {can_set}: the interface has {', '.join(can.sets)}")
    messages = can.sets[can_set]
    identifiers = tuple(
        can.can_id(unit, message, slot)
        for message in messages
        for slot in range(beam_count if message.each_beam else 1)
    )
    ways = tuple(
        (message.layout.packing, message.each_beam, message.absent_unless, message.absent_blocks)
        for message in messages
    )
    own: dict[str, Value] = {
        "details": can_set == "full",
        "interface_version": interface.version,
        "beam_count": beam_count,
    }
    plan = CanPlan(identifiers, (can_set == "fd",) * len(identifiers), ways, own)
    can.plans[unit, can_set, beam_count] = plan
    return plan


def addresses(interface: Interface) -> dict[int, Address]:
    """Identifiers of the measurement messages of all units."""
    can = definition(interface)
    return {
        can.can_id(unit, message, slot): Address(unit, message, slot)
        for unit in range(interface.units)
        for message in can.messages
        for slot in range(can.beam_slots if message.each_beam else 1)
    }


def block_addresses(interface: Interface) -> dict[int, tuple[int, CanBlock]]:
    """Identifiers of acknowledgements and housekeeping of all units: unit and message."""
    can = definition(interface)
    return {can.can_id(unit, block): (unit, block) for unit in range(interface.units) for block in can.blocks}


def command_addresses(interface: Interface, unit: int) -> dict[int, CommandDefinition]:
    """Identifiers of commands to a unit."""
    can = definition(interface)
    base = can.id_base + unit * can.unit_stride
    commands = interface.commands.commands if interface.commands else ()
    return {base + each.can_id: each for each in commands if each.can_id is not None}


def host_message_addresses(interface: Interface, unit: int) -> dict[int, tuple[HostMessageDefinition, int]]:
    """Identifiers of messages to a unit: the message, and the place of the frame in it."""
    can = definition(interface)
    messages = interface.commands.messages if interface.commands else ()
    return {
        can.can_id(unit, part): (message, place)
        for message in messages
        for place, part in enumerate(message.can_parts)
    }
