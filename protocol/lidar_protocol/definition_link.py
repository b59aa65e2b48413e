"""The links of an interface definition: framing, CRC and packets, and messages on CAN."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import cast

from lidar_protocol.crc import CRCS
from lidar_protocol.definition_fields import Context, Entry, TomlTable, by_name, require_capacity
from lidar_protocol.definitions import (
    ByteLink,
    CanBlock,
    CanDefinition,
    CanMessage,
    Commands,
    Covered,
    HostMessageDefinition,
)
from lidar_protocol.errors import DefinitionError
from lidar_protocol.fields import Counter
from lidar_protocol.framing import Framing, Stuffed, Synced
from lidar_protocol.headers import APID_LIMIT, Kind, PacketHeader, PlainHeader, SpacePacketHeader
from lidar_protocol.layout import ByteOrder, Layout

_LENGTH_BYTES = {"u8": 1, "u16": 2, "u32": 4}
_HEADER_FIELDS = ("message", "unit", "sequence", "length")


def read_link(root: TomlTable, context: Context, timed: Mapping[Kind, bool], longest_body: int) -> ByteLink:
    """Read the byte link.

    Args:
        timed: for each kind of packet, whether its body starts with a time code.
        longest_body: length in bytes of the longest body.
    """
    framing = _framing(root.table("framing"), context.byte_order)
    crc_table = root.table("crc")
    crc = CRCS.get(crc_table.choice("kind", ("none", *CRCS)))
    choices = ("packet", "body", "frame") if framing.covers_head else ("packet", "body")
    covered = cast(Covered, crc_table.choice("over", choices, "packet"))
    order = cast(ByteOrder, crc_table.choice("byte_order", ("big", "little"), context.byte_order))
    crc_table.finish()
    table = root.table("header")
    kind = table.choice("kind", ("ccsds", "plain"))
    header: PacketHeader = (_space_packet if kind == "ccsds" else _plain)(table, context, timed)
    table.finish()
    link = ByteLink(framing, header, crc, covered, order)
    longest = link.overhead + longest_body
    if isinstance(header, PlainHeader):
        require_capacity(header.layout, f"{root.where} header.fields", "length", longest)
    elif longest > header.length + 65536:
        raise DefinitionError(f"{root.where} packet", f"{longest} bytes", "at most 65542 in a space packet")
    if framing.longest_packet is not None and longest > framing.longest_packet:
        allowed = f"a type that holds {longest}, the length of the longest packet"
        raise DefinitionError(f"{root.where} framing.length", framing.longest_packet, allowed)
    return link


def _framing(table: TomlTable, byte_order: ByteOrder) -> Framing:
    kind = table.choice("kind", ("cobs", "slip", "sync"))
    framing = _synced(table, byte_order) if kind == "sync" else Stuffed("slip" if kind == "slip" else "cobs")
    table.finish()
    return framing


def _synced(table: TomlTable, byte_order: ByteOrder) -> Synced:
    word = table.text("sync")
    try:
        sync = bytes.fromhex(word)
    except ValueError:
        sync = b""
    if not 1 <= len(sync) <= 8:
        raise table.refusal("sync", word, "1 to 8 bytes in hexadecimal digits, such as 1ACFFC1D")
    length = table.choice("length", _LENGTH_BYTES)
    counts = table.choice("length_counts", ("packet", "frame"), "packet")
    return Synced(sync, _LENGTH_BYTES[length], byte_order, "frame" if counts == "frame" else "packet")


def _space_packet(table: TomlTable, context: Context, timed: Mapping[Kind, bool]) -> SpacePacketHeader:
    own = table.table("apid")
    apids = {kind: own.integer(kind, 0, APID_LIMIT - context.units) for kind in timed}
    own.finish()
    telemetry = {kind: apid for kind, apid in apids.items() if kind != "command"}
    for kind, apid in telemetry.items():
        for other, theirs in telemetry.items():
            if kind < other and abs(apid - theirs) < context.units:
                expected = (
                    f"the first of {context.units} APIDs that no other packet has; {other} starts at {theirs}"
                )
                raise own.refusal(kind, apid, expected)
    return SpacePacketHeader(apids, context.units, frozenset(kind for kind in timed if timed[kind]))


def _plain(table: TomlTable, context: Context, kinds: Iterable[Kind]) -> PlainHeader:
    entries = [entry.rest() for entry in table.tables("fields")]
    for entry in entries:
        if entry.get("name") == "sequence":
            entry.setdefault("wraps", True)
    layout = context.layout(f"{table.where}.fields", entries, frozenset())
    _check_plain(layout, table, context)
    messages = _messages(table, layout, list(kinds))
    require_capacity(layout, table.where, "message", max(messages.values()))
    return PlainHeader(layout, messages, context.units)


def _check_plain(layout: Layout, table: TomlTable, context: Context) -> None:
    constants = {placed.field.name for placed in layout.placed if hasattr(placed.field.codec, "code")}
    if strange := layout.names - constants - set(_HEADER_FIELDS):
        expected = f"{', '.join(_HEADER_FIELDS)} or a field with a constant"
        raise DefinitionError(f"{table.where}.fields", ", ".join(sorted(strange)), expected)
    if "unit" not in layout.names and context.units > 1:
        expected = f"a field for the {context.units} units of interface.units"
        raise DefinitionError(f"{table.where}.fields: unit", None, expected)
    require_capacity(layout, table.where, "unit", context.units - 1)


def _messages(table: TomlTable, layout: Layout, kinds: list[Kind]) -> dict[Kind, int]:
    if "message" not in layout.names:
        if len(kinds) > 1:
            raise DefinitionError(
                f"{table.where}.fields",
                ", ".join(kinds),
                "a single kind of packet where the header has no field message",
            )
        return dict.fromkeys(kinds, 0)
    own = table.table("message")
    messages = {kind: own.integer(kind, 0, 2**32 - 1) for kind in kinds}
    own.finish()
    for kind, code in messages.items():
        if list(messages.values()).count(code) > 1:
            raise own.refusal(kind, code, "a unique number")
    return messages


_STANDARD_ID_LIMIT = 1 << 11
_CLASSIC_LENGTHS = range(1, 9)
_FD_LENGTHS = (*_CLASSIC_LENGTHS, 12, 16, 20, 24, 32, 48, 64)
_COUNTER_BITS = range(2, 9)
_OF_A_SHOT = frozenset({"shot_counter", "details", "interface_version", "beam_count"})


def read_can(
    table: TomlTable, context: Context, commands: Commands | None
) -> tuple[CanDefinition, Commands | None]:
    """Read the CAN part; returns it, and the commands with their identifiers if they have any."""
    known = by_name([*context.blocks["header"], *context.blocks.get("beam", [])])
    shared = table.optional_table("fields")
    for name in shared.names() if shared else []:
        known[name] = {"name": name, **shared.table(name).rest()} if shared else {}
    slots = table.integer("beam_slots", 1, 64)
    messages = tuple(_message(entry, context, known) for entry in table.tables("messages"))
    acknowledge = table.optional_table("acknowledge")
    definition = CanDefinition(
        id_base=table.integer("id_base", 0, _STANDARD_ID_LIMIT - 1),
        unit_stride=table.integer("unit_stride", 1, _STANDARD_ID_LIMIT),
        beam_slots=slots,
        counter_bits=_counter_bits(messages, table),
        messages=messages,
        acknowledge=_block(acknowledge, context, "acknowledge", {"command", "interface_version"})
        if acknowledge
        else None,
        housekeeping=tuple(
            _block(entry, context, "housekeeping", {"interface_version"})
            for entry in table.optional_tables("housekeeping")
        ),
    )
    own = table.optional_table("commands")
    if own is not None:
        commands = _with_ids(own, commands, context)
    parts = table.optional_tables("host_messages")
    if parts:
        commands = _with_parts(parts, commands, context)
    table.finish()
    _check_sets(definition, table.where)
    _check_ids(definition, commands, context.units, table.where)
    return definition, commands


def _message(table: TomlTable, context: Context, known: Mapping[object, Entry]) -> CanMessage:
    sets = [str(item) for item in table.items("sets")]
    if sets != ["fd"] and not set(sets) <= {"core", "full"}:
        raise table.refusal("sets", sets, "core, full or both, or fd alone")
    entries = [entry for item in table.tables("fields") for entry in context.resolved(item, known)]
    lengths = _FD_LENGTHS if sets == ["fd"] else _CLASSIC_LENGTHS
    message = CanMessage(
        name=table.name("name"),
        id=table.integer("id", 0, _STANDARD_ID_LIMIT - 1),
        each_beam=table.boolean("each_beam"),
        sets=frozenset(sets),
        absent_unless=table.text("absent_unless", "") or None,
        layout=context.layout(f"{table.where}.fields", entries, _OF_A_SHOT, lengths),
    )
    table.finish()
    first, bit = message.layout.placed[0]
    counts = isinstance(first.codec, Counter) and first.codec.bits in _COUNTER_BITS
    if first.name != "shot_counter" or bit or not counts:
        raise table.refusal(
            "fields", first.name, "shot_counter, with 2 to 8 bits that wrap, in the first place"
        )
    if message.absent_unless is not None and (
        not message.each_beam or message.absent_unless in message.layout.names
    ):
        raise table.refusal(
            "absent_unless", message.absent_unless, "a flag that this beam's message does not hold"
        )
    return message


def _block(table: TomlTable, context: Context, of: str, own: set[str]) -> CanBlock:
    if of not in context.blocks:
        raise DefinitionError(table.where, "a message", f"left out without [[{of}]]")
    known = by_name(context.blocks[of])
    entries = [entry for item in table.tables("fields") for entry in context.resolved(item, known)]
    layout = context.layout(f"{table.where}.fields", entries, frozenset(own), _CLASSIC_LENGTHS)
    block = CanBlock(table.name("name") if "name" in table else of, table.integer("id", 0, 2047), layout)
    table.finish()
    return block


def _with_ids(table: TomlTable, commands: Commands | None, context: Context) -> Commands:
    first = table.integer("id", 0, _STANDARD_ID_LIMIT - 1)
    table.finish()
    if commands is None:
        raise DefinitionError(table.where, "identifiers", "left out without [commands]")
    entries = [entry for entry in context.blocks["command_header"] if entry.get("name") != "command"]
    with_ids = []
    for command in commands.commands:
        where = f"{table.where}: {command.name}"
        own: Sequence[Entry] = [*entries, *context.blocks[f"commands.{command.name}"]]
        layout = context.layout(where, own, frozenset(), _CLASSIC_LENGTHS)
        with_ids.append(replace(command, can=layout, can_id=first + command.code))
    return replace(commands, commands=tuple(with_ids))


def _with_parts(tables: Sequence[TomlTable], commands: Commands | None, context: Context) -> Commands:
    where = tables[0].where.removesuffix("[0]")
    if commands is None or not commands.messages:
        raise DefinitionError(where, "frames", "left out without [host_messages]")
    parts: dict[str, list[CanBlock]] = {}
    for table in tables:
        message = table.choice("message", commands.messages_by_name)
        parts.setdefault(message, []).append(_part(table, message, context))
    divided = tuple(_divided(each, parts.get(each.name, []), where) for each in commands.messages)
    return replace(commands, messages=divided)


def _part(table: TomlTable, message: str, context: Context) -> CanBlock:
    known = by_name(context.blocks[f"commands.{message}"])
    head = [entry for entry in context.blocks["message_header"] if entry.get("name") == "sequence"]
    own = [entry for item in table.tables("fields") for entry in context.resolved(item, known)]
    where = f"{table.where}.fields"
    layout = context.layout(where, [*head, *own], frozenset(), _CLASSIC_LENGTHS, of_beams=True)
    part = CanBlock(table.name("name"), table.integer("id", 0, _STANDARD_ID_LIMIT - 1), layout)
    table.finish()
    return part


def _divided(message: HostMessageDefinition, parts: Sequence[CanBlock], where: str) -> HostMessageDefinition:
    sent = [
        placed.field.key for part in parts for placed in part.layout.placed if placed.field.name != "sequence"
    ]
    if parts and sorted(sent) != sorted(message.arguments):
        wrong = sorted({*sent} ^ {*message.arguments}) or sorted({key for key in sent if sent.count(key) > 1})
        expected = f"divided into frames with each field of {message.name} in one of them"
        raise DefinitionError(f"{where}: {message.name}", ", ".join(wrong), expected)
    return replace(message, can_parts=tuple(parts))


def _counter_bits(messages: Sequence[CanMessage], table: TomlTable) -> int:
    bits = {message.layout.placed[0].field.codec.bits for message in messages}
    if len(bits) > 1:
        raise table.refusal("fields.shot_counter", sorted(bits), "equally long in all messages")
    return bits.pop()


def _check_sets(can: CanDefinition, where: str) -> None:
    for name, messages in can.sets.items():
        first, *others = messages
        if not first.opens_set or first.each_beam or any(other.opens_set for other in others):
            raise DefinitionError(
                f"{where}.messages: set {name}", first.name, "the only message with beam_count, and the first"
            )
        place = f"{where}.messages: {first.name}"
        if len(first.sets) > 1 and "details" not in first.layout.names:
            expected = "one set alone where no flag details distinguishes them"
            raise DefinitionError(f"{place}.sets", "core, full", expected)
        require_capacity(first.layout, place, "beam_count", can.beam_slots)


def _check_ids(can: CanDefinition, commands: Commands | None, units: int, where: str) -> None:
    taken: dict[int, str] = {}
    wanted = [(each.name, each.id, can.beam_slots if each.each_beam else 1) for each in can.messages]
    wanted += [(block.name, block.id, 1) for block in can.blocks]
    for command in commands.commands if commands else ():
        if command.can_id is not None:
            wanted.append((command.name, command.can_id, 1))
    wanted += [
        (part.name, part.id, 1)
        for message in (commands.messages if commands else ())
        for part in message.can_parts
    ]
    for name, first, count in wanted:
        own = range(first, first + count)
        if any(each in taken for each in own) or own[-1] >= can.unit_stride:
            expected = f"an identifier that no other message has, with all slots below unit_stride {can.unit_stride:#x}"
            raise DefinitionError(f"{where}.messages: {name}.id", first, expected)
        taken |= dict.fromkeys(own, name)
    last = can.id_base + (units - 1) * can.unit_stride + max(taken)
    if last >= _STANDARD_ID_LIMIT:
        expected = f"low enough for {units} units within 11 bits; the last identifier would be {last:#x}"
        raise DefinitionError(f"{where}.id_base", can.id_base, expected)
