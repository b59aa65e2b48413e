"""Read the byte link from an interface definition: framing, CRC and packet header."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import cast

from lidar_protocol.crc import CRCS
from lidar_protocol.definition_context import Context, require_capacity
from lidar_protocol.definitions import ByteLink, Covered
from lidar_protocol.errors import DefinitionError
from lidar_protocol.framing import Framing, Stuffed, Synced
from lidar_protocol.headers import APID_LIMIT, Kind, PacketHeader, PlainHeader, SpacePacketHeader
from lidar_protocol.layout import ByteOrder, Layout
from lidar_protocol.toml_table import TomlTable

_LENGTH_BYTES = {"u8": 1, "u16": 2, "u32": 4}
_HEADER_FIELDS = ("message", "unit", "sequence", "length")


def read_link(root: TomlTable, context: Context, timed: Mapping[Kind, bool], longest_body: int) -> ByteLink:
    """Read the byte link.

    Args:
        root: the whole definition.
        context: context of the definition.
        timed: for each kind of packet, whether its body starts with a time code.
        longest_body: length in bytes of the longest body.
    """
    framing = _framing(root.table("framing"), context.byte_order)
    crc_table = root.table("crc")
    kind = crc_table.choice("kind", ("none", *CRCS))
    crc = CRCS.get(kind)
    choices = ("packet", "body", "frame") if framing.covers_head else ("packet", "body")
    covered = cast(Covered, crc_table.choice("over", choices, "packet"))
    order = cast(ByteOrder, crc_table.choice("byte_order", ("big", "little"), context.byte_order))
    crc_table.finish()
    header = _header(root.table("header"), context, timed)
    link = ByteLink(framing, header, crc, covered, order)
    longest = link.overhead + longest_body
    if isinstance(header, PlainHeader):
        require_capacity(header.layout, "header.fields", "length", longest)
    elif longest > header.length + 65536:
        raise DefinitionError("packet", f"{longest} bytes", "at most 65542 in a space packet")
    if framing.longest_packet is not None and longest > framing.longest_packet:
        allowed = f"a type that holds {longest}, the length of the longest packet"
        raise DefinitionError("framing.length", framing.longest_packet, allowed)
    return link


def _framing(table: TomlTable, byte_order: ByteOrder) -> Framing:
    framing = _FRAMINGS[table.choice("kind", tuple(_FRAMINGS))](table, byte_order)
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


_FRAMINGS: dict[str, Callable[[TomlTable, ByteOrder], Framing]] = {
    "cobs": lambda *_: Stuffed("cobs"),
    "slip": lambda *_: Stuffed("slip"),
    "sync": _synced,
}


def _header(table: TomlTable, context: Context, timed: Mapping[Kind, bool]) -> PacketHeader:
    kind = table.choice("kind", ("ccsds", "plain"))
    header = _space_packet(table, context, timed) if kind == "ccsds" else _plain(table, context, timed)
    table.finish()
    return header


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
        raise DefinitionError("interface.units", context.units, "1 where the header has no field unit")
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
