"""Generate a Wireshark dissector: the interface as Lua tables, and the functions that read them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from string import Template
from typing import Any

from lidar_icd.framings import framing_text
from lidar_protocol.crc import Crc, table_of
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Codec, Constant, Counter, Flag, Number, Real, Time
from lidar_protocol.headers import SpacePacketHeader
from lidar_protocol.layout import Layout, PlacedField

_LINE = 118
_EXACT_BITS = 53
"""Bits of a whole number that Lua's numbers hold exactly in every version that Wireshark has."""

Value = Any
"""What a Lua table holds: None, bool, int, float, str, list, or dict."""


def dissector(interface: Interface) -> str:
    """Generate the dissector in Lua, for Wireshark 3.6 and later."""
    template = (files("lidar_icd") / "dissector_template.lua").read_text(encoding="utf-8")
    return Template(template).substitute(
        name=" ".join(interface.name.split()),  # stays on its line of a comment
        version=interface.version,
        protocol=identifier(interface),
        interface=lua(_interface(interface)),
    )


def lua(value: Value, indent: int = 0) -> str:
    """Write a value as a Lua expression, in lines of moderate length."""
    if value is None:
        return "nil"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return _quoted(value)
    margin = "    " * (indent + 1)
    entries = _entries(value, indent + 1)
    inner = ", ".join(entries)
    if len(margin) + len(inner) < _LINE and "\n" not in inner:
        return f"{{ {inner} }}" if inner else "{}"
    if all(isinstance(item, int) for item in value):
        entries = _filled(entries, _LINE - len(margin))
    lines = "".join(f"{margin}{entry},\n" for entry in entries)
    return f"{{\n{lines}{'    ' * indent}}}"


def _filled(entries: list[str], most: int) -> list[str]:
    lines = [entries[0]]
    for entry in entries[1:]:
        if len(lines[-1]) + len(entry) + 3 > most:
            lines.append(entry)
        else:
            lines[-1] += f", {entry}"
    return lines


def _entries(value: Mapping[str | int, Value] | Sequence[Value], indent: int) -> list[str]:
    if not isinstance(value, Mapping):
        return [lua(item, indent) for item in value]
    keys = {key: f"[{key}]" if isinstance(key, int) else key for key in value}
    return [f"{keys[key]} = {lua(item, indent)}" for key, item in value.items() if item is not None]


def _quoted(text: str) -> str:
    """Write a string so that none of its characters ends it, whatever it is."""
    plain = (
        chr(byte) if 32 <= byte < 127 and byte not in b'"\\' else f"\\{byte:03d}" for byte in text.encode()
    )
    return f'"{"".join(plain)}"'


def _interface(interface: Interface) -> dict[str, Value]:
    link, packet = interface.link, interface.packet
    commands = interface.commands
    longest = max(interface.maximum_packet_bytes, interface.maximum_command_bytes)
    return {
        "title": f"{interface.name}, version {interface.version}",
        "big_endian": interface.byte_order == "big",
        "framing": dict(framing_text(link.framing).wireshark(longest)),
        "crc": None if link.crc is None else _crc(link.crc, link.covered, link.byte_order),
        "header": _header(interface),
        "units": interface.units,
        "shot": _layout(interface, packet.header),
        "beam": _layout(interface, packet.beam),
        "acknowledge": _layout(interface, interface.acknowledge),
        "housekeeping": _layout(interface, interface.housekeeping),
        "command_header": None if commands is None else _layout(interface, commands.header),
        "commands": None
        if commands is None
        else {
            command.code: {"name": command.name, "layout": _layout(interface, command.packet)}
            for command in commands.packets
        },
        "can": _can(interface),
    }


def _crc(crc: Crc, covered: str, byte_order: str) -> dict[str, Value]:
    return {
        "length": crc.length,
        "start": crc.start,
        "reflected": crc.reflected,
        "final_xor": crc.final_xor,
        "covered": covered,
        "big_endian": byte_order == "big",
        "table": list(table_of(crc)),
    }


def _header(interface: Interface) -> dict[str, Value]:
    header = interface.link.header
    if isinstance(header, SpacePacketHeader):
        kinds = {header.identification(kind, 0): kind for kind in header.apids}
        return {"kind": "ccsds", "length": header.length, "kinds": kinds}
    kinds = {code: kind for kind, code in header.messages.items()}
    return {
        "kind": "plain",
        "length": header.length,
        "kinds": kinds,
        "layout": _layout(interface, header.layout),
    }


def _can(interface: Interface) -> dict[str, Value] | None:
    can = interface.can
    if can is None:
        return None
    messages = [
        {
            "id": message.id,
            "slots": can.beam_slots if message.each_beam else None,
            "name": message.name,
            "layout": _layout(interface, message.layout),
        }
        for message in can.messages
    ]
    messages += [
        {"id": block.id, "name": block.name, "layout": _layout(interface, block.layout)}
        for block in can.blocks
    ]
    messages += [
        {"id": command.can_id, "name": f"command_{command.name}", "layout": _layout(interface, command.can)}
        for command in (interface.commands.commands if interface.commands else ())
        if command.can is not None
    ]
    messages += [
        {"id": part.id, "name": part.name, "layout": _layout(interface, part.layout)}
        for message in (interface.commands.messages if interface.commands else ())
        for part in message.can_parts
    ]
    return {"base": can.id_base, "stride": can.unit_stride, "messages": messages}


def _layout(interface: Interface, layout: Layout | None) -> dict[str, Value] | None:
    if layout is None:
        return None
    return {"length": layout.length, "fields": [dict(_field(interface, each)) for each in layout.placed]}


def _field(interface: Interface, placed: PlacedField) -> Iterator[tuple[str, Value]]:
    field, codec = placed.field, placed.field.codec
    yield "key", field.key
    yield "bit", placed.first_bit
    yield "bits", codec.bits
    yield from _codec(codec)
    if field.unit:
        yield "unit", field.unit
    if field.meaning:
        yield "meaning", field.meaning
    words = interface.enumerations.get(field.enumeration or "")
    if words:
        yield "words", {code: word for word, code in words.items()}


def _codec(codec: Codec) -> Iterator[tuple[str, Value]]:
    match codec:
        case Flag():
            yield "kind", "flag"
        case Constant() | Counter():
            yield "kind", "whole"
        case Time():
            yield "kind", "time"
        case Real():
            low, high = codec.limits
            yield "kind", "real"
            yield from (("lowest", low), ("highest", high))
        case Number():
            yield "kind", "whole" if codec.whole else "scaled"
            yield from _number(codec)


def _number(codec: Number) -> Iterator[tuple[str, Value]]:
    if codec.signed:
        yield "signed", True
    if not codec.whole:
        yield "steps_per_unit", codec.steps_per_unit
    elif codec.offset:
        yield "offset", codec.offset
    if not codec.is_full:
        wide = codec.bits > _EXACT_BITS
        for name, limit in (("lowest", codec.lowest), ("highest", codec.highest)):
            yield name, f"{limit % (1 << 64):016x}" if wide else limit
    if codec.absent is not None:
        yield "absent", codec.absent


def identifier(interface: Interface) -> str:
    """Name of the interface in small letters, digits and underscores.

    A name that does not start with "lidar" gets it as a prefix, so that no protocol of Wireshark has the same one.
    """
    name = re.sub(r"[^a-z0-9]+", "_", interface.name.lower()).strip("_")
    return name if name.startswith("lidar") else f"lidar_{name}".rstrip("_")
