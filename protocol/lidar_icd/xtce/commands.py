"""Telecommands of an XTCE database: their arguments and the bytes between them."""

from __future__ import annotations

from lidar_icd.xtce.types import (
    NS_PER_TICK,
    Element,
    add,
    add_encoding,
    add_flag_or_real,
    add_range,
    add_scale,
    add_typed,
)
from lidar_protocol.compiled import PlacedField
from lidar_protocol.definitions import CommandDefinition, Interface
from lidar_protocol.fields import Codec, Constant, Field, Flag, Number, Real, Time
from lidar_protocol.headers import SpacePacketHeader

_UNSEGMENTED = 0xC000
"""Second word of a packet: sequence flags, and a count of 0, which devices do not use."""


def add_commands(interface: Interface, metadata: Element) -> None:
    """Add all commands of an interface. What sends them appends the CRC."""
    assert interface.commands is not None
    assert isinstance(interface.link.header, SpacePacketHeader)
    types, commands = add(metadata, "ArgumentTypeSet"), add(metadata, "MetaCommandSet")
    unit = add(types, "IntegerArgumentType", name="unit_type", signed=False)
    add(unit, "UnitSet")
    add_scale(add_encoding(unit, 11), interface.link.header.apids["command"], 1.0)
    add_range(unit, (0, interface.units - 1))
    for command in interface.commands.commands:
        _add_command(types, commands, interface, command)


def _add_command(types: Element, commands: Element, interface: Interface, command: CommandDefinition) -> None:
    meta = add(commands, "MetaCommand", name=command.name, shortDescription=command.meaning or None)
    arguments = add(meta, "ArgumentList")
    entries = add(add(meta, "CommandContainer", name=command.name), "EntryList")
    link, bit, layout = interface.link, 0, command.packet
    assert isinstance(link.header, SpacePacketHeader)
    _add_argument(arguments, "unit", "unit_type", 0, "Number of the device")
    _add_fixed(entries, link.header.identification("command", 0) >> 11, 5)
    add(entries, "ArgumentRefEntry", argumentRef="unit")
    _add_fixed(entries, _UNSEGMENTED << 16 | layout.length + link.crc_length - 1, 32)
    for placed in sorted(layout.placed, key=lambda each: each.first_bit):
        _add_fixed(entries, 0, placed.first_bit - bit)
        _add_field(types, arguments, entries, interface, command, placed)
        bit = placed.first_bit + placed.field.codec.bits
    _add_fixed(entries, 0, 8 * layout.length - bit)


def _add_field(
    types: Element,
    arguments: Element,
    entries: Element,
    interface: Interface,
    command: CommandDefinition,
    placed: PlacedField,
) -> None:
    field, codec = placed.field, placed.field.codec
    own = {"command": command.code, "interface_version": interface.version}
    if isinstance(codec, Constant):
        _add_fixed(entries, codec.code, codec.bits)
    elif field.name in own:
        _add_fixed(entries, own[field.name], codec.bits)
    else:
        name = f"{command.name}_{field.key}_type"
        _add_argument_type(types, interface, field, name)
        initial = 0 if field.name == "sequence" else None
        _add_argument(arguments, field.key, name, initial, field.meaning)
        add(entries, "ArgumentRefEntry", argumentRef=field.key)


def _add_argument(arguments: Element, name: str, type_name: str, initial: int | None, meaning: str) -> None:
    of_argument = {"initialValue": initial, "shortDescription": meaning or None}
    add(arguments, "Argument", name=name, argumentTypeRef=type_name, **of_argument)


def _add_argument_type(types: Element, interface: Interface, field: Field, name: str) -> None:
    codec = field.codec
    words = interface.enumerations.get(field.enumeration or "")
    if words and not isinstance(codec, Flag):
        enumerated = add_typed(types, "EnumeratedArgumentType", name, field)
        add_encoding(enumerated, codec.bits, codec.signed)
        entries = add(enumerated, "EnumerationList")
        for word, code in words.items():
            add(entries, "Enumeration", value=code, label=word)
    elif isinstance(codec, Flag | Real):
        add_flag_or_real(types, "Argument", name, field)
    else:
        _add_number(types, name, field, codec)


def _add_number(types: Element, name: str, field: Field, codec: Codec) -> None:
    """Add a number. The calibrator of an argument converts the value to the raw one, a parameter's the raw value."""
    is_float = isinstance(codec, Time) or (isinstance(codec, Number) and not codec.whole)
    tag = "FloatArgumentType" if is_float else "IntegerArgumentType"
    signed = {} if is_float else {"signed": codec.signed}
    number = add_typed(types, tag, name, field, sizeInBits=64, **signed)
    encoding = add_encoding(number, codec.bits, codec.signed)
    if isinstance(codec, Time):
        add_scale(encoding, 0, 1 / NS_PER_TICK)
        add_range(number, (0, (1 << codec.bits) * NS_PER_TICK))
    elif isinstance(codec, Number):
        if not codec.whole or codec.offset:
            add_scale(encoding, -codec.offset, codec.steps_per_unit)
        add_range(number, codec.limits)


def _add_fixed(entries: Element, value: int, bits: int) -> None:
    if bits:
        digits = f"{value:0{2 * -(-bits // 8)}X}"
        add(entries, "FixedValueEntry", binaryValue=digits, sizeInBits=bits)
