"""Read and check interface definitions in TOML."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from decimal import Decimal
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final, TypeVar, cast

from lidar_protocol.definition_fields import Context, TomlTable, require_capacity
from lidar_protocol.definition_link import read_can, read_link
from lidar_protocol.definitions import (
    CommandDefinition,
    Commands,
    HostMessageDefinition,
    Interface,
    PacketDefinition,
)
from lidar_protocol.errors import DefinitionError
from lidar_protocol.fields import Time
from lidar_protocol.headers import Kind
from lidar_protocol.layout import ByteOrder, Layout

SHIPPED: Final = ("default", "altimeter")
"""Names of the interfaces in the package."""

VERDICTS: Final = ("accepted", "unknown", "malformed", "bad_sequence", "out_of_state", "out_of_range")
"""Verdicts that the enumeration of an acknowledgement must have."""

_MOST_BYTES = 1_000_000
_MOST_BEAMS = 64
_MOST_CODE = 2**16 - 1
_T = TypeVar("_T", bound=CommandDefinition)


@cache
def shipped_interface(name: str) -> Interface:
    """Load one of the interfaces in the package."""
    return load((files("lidar_protocol") / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml")


def default_interface() -> Interface:
    """Load the default interface."""
    return shipped_interface("default")


def load_file(path: str | Path) -> Interface:
    """Read a definition from a file.

    Raises:
        DefinitionError: as `load`, or the file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
        text = data.decode("utf-8")
    except OSError as error:
        raise DefinitionError(str(path), error.strerror, "a TOML file") from None
    except ValueError:
        raise DefinitionError(str(path), "bytes that are not UTF-8", "a TOML file") from None
    if len(data) > _MOST_BYTES:
        raise DefinitionError(str(path), "more", f"at most {_MOST_BYTES} bytes")
    return load(text, str(path))


def load(text: str, where: str) -> Interface:
    """Read a definition; `where` names it in error messages.

    Raises:
        DefinitionError: the definition cannot be used.
    """
    try:
        tree = tomllib.loads(text, parse_float=Decimal)
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise DefinitionError(where, str(error), "TOML 1.0") from None
    return _interface(TomlTable(f"{where}:", tree))


def _interface(root: TomlTable) -> Interface:
    general = root.table("interface")
    commands_table, messages_table = root.optional_table("commands"), root.optional_table("host_messages")
    words = root.optional_table("enumerations")
    tables = {name: words.table(name) for name in words.names()} if words else {}
    enumerations: dict[str, Mapping[str, int]] = {
        name: {word: own.integer(word, 0, 2**32 - 1) for word in own.names()} for name, own in tables.items()
    }
    enumerations["command"] = _codes(commands_table, messages_table)
    context = Context(
        byte_order=cast(ByteOrder, general.choice("byte_order", ("big", "little"))),
        units=general.integer("units", 1, 256),
        version=general.integer("version", 0, 2**16 - 1),
        enumerations=enumerations,
    )
    packet = _packet(root.table("packet"), context)
    commands = _commands(root, commands_table, messages_table, context)
    acknowledge = _block(root, "acknowledge", {"command", "interface_version"}, context)
    housekeeping = _block(root, "housekeeping", {"interface_version"}, context)
    if acknowledge is not None:
        _check_acknowledge(acknowledge, f"{root.where} acknowledge", context)
    bodies: dict[Kind, Layout | None] = {
        "measurement": packet.header,
        "command": commands.header if commands else None,
        "acknowledge": acknowledge,
        "housekeeping": housekeeping,
    }
    firsts = {kind: layout.placed[0] for kind, layout in bodies.items() if layout is not None}
    timed = {
        kind: isinstance(each.field.codec, Time) and each.first_bit == 0 for kind, each in firsts.items()
    }
    lengths = [layout.length for layout in bodies.values() if layout is not None]
    lengths += [each.packet.length for each in commands.packets] if commands else []
    longest = max(packet.longest, *lengths)
    link = read_link(root, context, timed, longest)
    can = None
    if (can_table := root.optional_table("can")) is not None:
        can, commands = read_can(can_table, context, commands)
    interface = Interface(
        name=general.text("name"),
        version=context.version,
        units=context.units,
        epoch=general.text("epoch"),
        byte_order=context.byte_order,
        enumerations=enumerations,
        link=link,
        packet=packet,
        commands=commands,
        acknowledge=acknowledge,
        housekeeping=housekeeping,
        can=can,
        serial_format=_serial_format(root.optional_table("uart")),
    )
    general.finish()
    root.finish()
    return interface


def _serial_format(table: TomlTable | None) -> str:
    if table is None:
        return "8N1"
    parity = table.choice("parity", ("none", "even", "odd"), "none")
    stop_bits = table.integer("stop_bits", 1, 2, 1)
    table.finish()
    return f"8{parity[0].upper()}{stop_bits}"


def _packet(table: TomlTable, context: Context) -> PacketDefinition:
    own = frozenset({"interface_version", "beam_count"})
    context.blocks["header"] = [entry.rest() for entry in table.tables("header")]
    header = context.layout(f"{table.where}.header", context.blocks["header"], own, of_beams=True)
    beam, most = None, _MOST_BEAMS
    if "beam" in table:
        context.blocks["beam"] = [entry.rest() for entry in table.tables("beam")]
        beam = context.layout(f"{table.where}.beam", context.blocks["beam"], frozenset())
        most = table.integer("maximum_beams", 1, 255)
    table.finish()
    require_capacity(header, f"{table.where}.header", "beam_count", most)
    return PacketDefinition(header, beam, most)


def _block(root: TomlTable, name: str, own: set[str], context: Context) -> Layout | None:
    tables = root.optional_tables(name)
    if not tables:
        return None
    context.blocks[name] = [entry.rest() for entry in tables]
    return context.layout(f"{root.where} {name}", context.blocks[name], frozenset(own))


def _check_acknowledge(layout: Layout, where: str, context: Context) -> None:
    fields = {placed.field.name: placed.field for placed in layout.placed}
    for name in ("sequence", "verdict"):
        if name not in fields:
            raise DefinitionError(where, ", ".join(fields), f"fields with {name} among them")
    words = context.enumerations.get(fields["verdict"].enumeration or "", {})
    if missing := [word for word in VERDICTS if word not in words]:
        expected = f"an enumeration with the words {', '.join(missing)}"
        raise DefinitionError(f"{where}: verdict.values", fields["verdict"].enumeration, expected)


def _codes(*tables: TomlTable | None) -> dict[str, int]:
    codes: dict[str, int] = {}
    for table, name in ((each, name) for each in tables if each for name in each.names()):
        table.check_name(name)
        code = table.peek(name).integer("code", 0, _MOST_CODE)
        if name in codes:
            raise DefinitionError(f"{table.where}.{name}", name, "a name that no command has")
        if code in codes.values():
            raise DefinitionError(f"{table.where}.{name}.code", code, "a unique code")
        codes[name] = code
    return codes


def _commands(
    root: TomlTable, table: TomlTable | None, messages: TomlTable | None, context: Context
) -> Commands | None:
    if table is None:
        if messages is not None:
            raise DefinitionError(messages.where, "messages", "left out without [commands]")
        return None
    where, own = f"{root.where} command_header", frozenset({"command"})
    head = context.blocks["command_header"] = [entry.rest() for entry in root.tables("command_header")]
    header = context.layout(where, head, own)
    for name in ("command", "sequence"):
        if name not in header.names:
            raise DefinitionError(where, ", ".join(sorted(header.names)), f"fields with {name} among them")
    codes = context.enumerations["command"]
    require_capacity(header, where, "command", max(codes.values(), default=0))
    commands = _definitions(CommandDefinition, table, context)
    if not commands:
        raise DefinitionError(table.where, "none", "at least one command")
    if messages is not None:
        counted = {"meaning": "Number of the message: the last one of its kind plus one, 0 after the largest"}
        context.blocks["message_header"] = [
            {**entry, **counted} if entry.get("name") == "sequence" else entry for entry in head
        ]
    return Commands(header, commands, _definitions(HostMessageDefinition, messages, context))


def _definitions(kind: type[_T], table: TomlTable | None, context: Context) -> tuple[_T, ...]:
    return tuple(_definition(kind, table, name, context) for name in table.names()) if table else ()


def _definition(kind: type[_T], table: TomlTable, name: str, context: Context) -> _T:
    own = table.table(name)
    own.integer("code", 0, _MOST_CODE)
    meaning = own.text("meaning", "")
    arguments = [entry.rest() for entry in own.optional_tables("fields")]
    own.finish()
    context.blocks[f"commands.{name}"] = arguments
    of_beams = kind is HostMessageDefinition
    header = context.blocks["message_header" if of_beams else "command_header"]
    layout = context.layout(own.where, [*header, *arguments], frozenset({"command"}), of_beams=of_beams)
    head = sum("name" in entry for entry in header)
    names = tuple(placed.field.key for placed in layout.placed[head:])
    return kind(name, context.enumerations["command"][name], meaning, layout, names, None, None)
