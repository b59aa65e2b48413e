"""Interface definitions: TOML, read and checked once, into frozen data."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cache, cached_property
from importlib.resources import files
from typing import Literal

from lidar_protocol.ccsds import APID_LIMIT, OVERHEAD_BYTES
from lidar_protocol.errors import DefinitionError
from lidar_protocol.field_table import Entry, Enumerations, read_layout
from lidar_protocol.fields import Counter
from lidar_protocol.layout import Layout
from lidar_protocol.toml_table import TomlTable

CanSet = Literal["core", "full", "fd"]
"""The messages of one shot: what a classic bus can carry at speed, everything on a classic bus, or CAN FD."""

COUNTER_BITS = 4
_STANDARD_ID_LIMIT = 1 << 11
_CLASSIC_LENGTHS = range(1, 9)
_FD_LENGTHS = (*_CLASSIC_LENGTHS, 12, 16, 20, 24, 32, 48, 64)


@dataclass(frozen=True)
class PacketDefinition:
    """The body of a packet: `header`, then `beam` once for each beam."""

    apid: int
    """Of unit 0; the other units follow."""
    maximum_beams: int
    header: Layout
    beam: Layout


@dataclass(frozen=True)
class CanMessage:
    """A message, or one for each beam slot."""

    name: str
    id: int
    """Relative to the unit's first identifier; of slot 0."""
    each_beam: bool
    sets: frozenset[str]
    absent_unless: str | None
    """Flag without which a beam's message is sent as absent, and which its reception implies."""
    layout: Layout

    @property
    def is_fd(self) -> bool:
        return "fd" in self.sets

    @cached_property
    def opens_set(self) -> bool:
        """It is the header, which states how many beams follow."""
        return any(placed.field.name == "beam_count" for placed in self.layout.placed)


@dataclass(frozen=True)
class CanDefinition:
    """Identifiers and messages on CAN."""

    id_base: int
    unit_stride: int
    beam_slots: int
    messages: tuple[CanMessage, ...]

    def can_id(self, unit: int, message: CanMessage, slot: int = 0) -> int:
        """The identifier of a unit's message."""
        return self.id_base + unit * self.unit_stride + message.id + slot


@dataclass(frozen=True)
class Interface:
    """Everything that sender and receiver must agree upon."""

    name: str
    version: int
    units: int
    epoch: str
    enumerations: Enumerations
    packet: PacketDefinition
    can: CanDefinition

    @cached_property
    def maximum_packet_bytes(self) -> int:
        """Length of the longest packet, CCSDS header and CRC included."""
        beams = self.packet.maximum_beams * self.packet.beam.length
        return OVERHEAD_BYTES + self.packet.header.length + beams


@cache
def default_interface() -> Interface:
    """The interface that comes with the package."""
    source = files("lidar_protocol") / "default.toml"
    return load(source.read_text(encoding="utf-8"), "default.toml")


def load(text: str, where: str) -> Interface:
    """Read a definition; `where` names it in errors.

    Raises:
        DefinitionError: one line that names the place, the value and what is allowed.
    """
    try:
        tree = tomllib.loads(text, parse_float=Decimal)
    except tomllib.TOMLDecodeError as error:
        raise DefinitionError(where, str(error), "TOML 1.0") from None
    root = TomlTable(f"{where}:", tree)
    general = root.table("interface")
    byte_order = general.text("byte_order")
    if byte_order != "big":
        raise general.refusal("byte_order", byte_order, "big")
    units = general.integer("units", 1, 256)
    reader = _Reader(_read_enumerations(root.table("enumerations")))
    interface = Interface(
        name=general.text("name"),
        version=general.integer("version", 0, 255),
        units=units,
        epoch=general.text("epoch"),
        enumerations=reader.enumerations,
        packet=reader.packet(root.table("packet"), units),
        can=reader.can(root.table("can"), units),
    )
    general.finish()
    root.finish()
    return interface


def _read_enumerations(table: TomlTable) -> Enumerations:
    words = {name: table.table(name) for name in table.names()}
    return {name: {word: own.integer(word, 0, 255) for word in own.names()} for name, own in words.items()}


class _Reader:
    """Remembers the packet's fields, so that messages on CAN can refer to them by name."""

    def __init__(self, enumerations: Enumerations) -> None:
        self.enumerations = enumerations
        self._blocks: dict[str, list[Entry]] = {}
        self._known: dict[object, Entry] = {}

    def packet(self, table: TomlTable, units: int) -> PacketDefinition:
        definition = PacketDefinition(
            apid=table.integer("apid", 0, APID_LIMIT - units),
            maximum_beams=table.integer("maximum_beams", 1, 255),
            header=self._packet_block(table, "header"),
            beam=self._packet_block(table, "beam"),
        )
        table.finish()
        return definition

    def _packet_block(self, table: TomlTable, name: str) -> Layout:
        entries: list[Entry] = [entry.rest() for entry in table.tables(name)]
        self._blocks[name] = entries
        self._known |= {entry["name"]: entry for entry in entries if "name" in entry}
        return read_layout(f"{table.where}.{name}", entries, self.enumerations, range(1, 1024))

    def can(self, table: TomlTable, units: int) -> CanDefinition:
        shared = table.table("fields")
        self._known |= {name: {"name": name, **shared.table(name).rest()} for name in shared.names()}
        definition = CanDefinition(
            id_base=table.integer("id_base", 0, _STANDARD_ID_LIMIT - 1),
            unit_stride=table.integer("unit_stride", 1, _STANDARD_ID_LIMIT),
            beam_slots=table.integer("beam_slots", 1, 64),
            messages=tuple(self._message(entry) for entry in table.tables("messages")),
        )
        table.finish()
        _check_ids(definition, units, table.where)
        return definition

    def _message(self, table: TomlTable) -> CanMessage:
        sets = [str(item) for item in table.items("sets")]
        if sets != ["fd"] and not set(sets) <= {"core", "full"}:
            raise table.refusal("sets", sets, "core, full or both; or fd alone")
        entries = [entry for item in table.tables("fields") for entry in self._resolved(item)]
        lengths = _FD_LENGTHS if sets == ["fd"] else _CLASSIC_LENGTHS
        message = CanMessage(
            name=table.text("name"),
            id=table.integer("id", 0, _STANDARD_ID_LIMIT - 1),
            each_beam=table.boolean("each_beam"),
            sets=frozenset(sets),
            absent_unless=table.text("absent_unless", "") or None,
            layout=read_layout(f"{table.where}.fields", entries, self.enumerations, lengths),
        )
        table.finish()
        first, bit = message.layout.placed[0]
        if (first.name, bit, first.codec) != ("shot_counter", 0, Counter(COUNTER_BITS)):
            raise table.refusal("fields", first.name, f"shot_counter first, {COUNTER_BITS} bits that wrap")
        return message

    def _resolved(self, table: TomlTable) -> Sequence[Entry]:
        """A field with what it takes from the packet's; or all fields of a block."""
        if "all_of" in table:
            block = table.text("all_of")
            table.finish()
            if block not in self._blocks:
                raise table.refusal("all_of", block, " or ".join(self._blocks))
            return self._blocks[block]
        own = table.rest()
        base = dict(self._known.get(own.get("name"), {}))
        if "type" in own:  # codes belong to a type
            base.pop("none", None)
            base.pop("absent", None)
        return [base | own]


def _check_ids(can: CanDefinition, units: int, where: str) -> None:
    taken: set[int] = set()
    for message in can.messages:
        own = set(range(message.id, message.id + (can.beam_slots if message.each_beam else 1)))
        if own & taken or max(own) >= can.unit_stride:
            allowed = f"identifiers of its own, all slots below unit_stride {can.unit_stride:#x}"
            raise DefinitionError(f"{where}.messages: {message.name}.id", message.id, allowed)
        taken |= own
    last = can.id_base + (units - 1) * can.unit_stride + max(taken)
    if last >= _STANDARD_ID_LIMIT:
        allowed = f"{units} units within 11 bits; the last identifier would be {last:#x}"
        raise DefinitionError(f"{where}.id_base", can.id_base, allowed)
