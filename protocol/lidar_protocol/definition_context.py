"""Context for reading the parts of an interface definition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from lidar_protocol.definition_fields import Entry, Enumerations, read_layout
from lidar_protocol.errors import DefinitionError
from lidar_protocol.fields import Codec, Constant, Counter, Number
from lidar_protocol.layout import FILLED_IN, ByteOrder, Layout
from lidar_protocol.toml_table import TomlTable

BODY_LENGTHS: Final = range(1, 4097)


@dataclass
class Context:
    """Byte order, units, enumerations, and tables of fields that later parts refer to."""

    byte_order: ByteOrder
    units: int
    version: int
    enumerations: Enumerations
    blocks: dict[str, Sequence[Entry]] = field(default_factory=dict)
    """Lists of fields, by block, that a CAN message can include."""

    def layout(
        self,
        where: str,
        entries: Sequence[Entry],
        own: frozenset[str],
        lengths: Sequence[int] = BODY_LENGTHS,
        of_beams: bool = False,
    ) -> Layout:
        """Read the layout of a list of fields; `own` are those in it that the library may fill in."""
        layout = read_layout(where, entries, self.enumerations, lengths, self.byte_order, of_beams)
        if strange := (layout.names & FILLED_IN) - own:
            raise DefinitionError(
                where, ", ".join(sorted(strange)), "other names: the library fills these fields in, elsewhere"
            )
        require_capacity(layout, where, "interface_version", self.version)
        for placed in layout.placed:
            if placed.field.name == "shot" and not isinstance(placed.field.codec, Counter):
                raise DefinitionError(f"{where}: shot.wraps", False, "true: shots are counted without end")
        return layout

    def resolved(self, table: TomlTable, known: Mapping[object, Entry]) -> Sequence[Entry]:
        """Table of a field, completed from the field of the same name; or all fields of a block."""
        if "all_of" in table:
            block = table.choice("all_of", self.blocks)
            table.finish()
            return self.blocks[block]
        own = table.rest()
        base = {key: value for key, value in known.get(own.get("name"), {}).items() if key != "beam"}
        if "type" in own:  # codes belong to a type
            base.pop("none", None)
            base.pop("absent", None)
        if not own.keys() & {"type", "spare"} and "type" not in base:
            raise table.refusal(
                "name", own.get("name"), "the name of a field of the packet, or beside a type"
            )
        return [base | own]


def by_name(entries: Sequence[Entry]) -> dict[object, Entry]:
    """Tables of fields by the names of the fields."""
    return {entry["name"]: entry for entry in entries if "name" in entry}


def codec_of(layout: Layout, name: str) -> Codec | None:
    """Codec of a field; None if the layout does not have it."""
    return next((placed.field.codec for placed in layout.placed if placed.field.name == name), None)


def require_capacity(layout: Layout, where: str, name: str, most: int) -> None:
    """Refuse a field whose type cannot hold the values up to `most` that the library fills in.

    Raises:
        DefinitionError: the type cannot hold them.
    """
    codec = codec_of(layout, name)
    if codec is None or isinstance(codec, Counter | Constant):
        return
    if not isinstance(codec, Number) or not codec.whole or codec.limits[1] < most:
        raise DefinitionError(
            f"{where}: {name}.type", f"{codec.bits} bits", f"a type of whole numbers that holds {most}"
        )
