"""Fields and layouts from their tables in an interface definition."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import ceil, floor

from lidar_protocol.errors import DefinitionError
from lidar_protocol.fields import Codec, Counter, Field, Flag, Number, Time
from lidar_protocol.layout import Layout, Placed
from lidar_protocol.toml_table import TomlTable

Enumerations = Mapping[str, Mapping[str, int]]
Entry = Mapping[str, object]

_TYPE = re.compile(r"([ui])([1-9]|[12]\d|3[0-2])")
_OUTSIDE = ("none", "nearest")


def read_layout(
    where: str, entries: Sequence[Entry], enumerations: Enumerations, lengths: Sequence[int]
) -> Layout:
    """The layout of a list of fields and spare bits; its length is the first of `lengths` that holds it.

    Raises:
        DefinitionError: a field cannot be used, a name comes twice, or the fields fit into none of `lengths`.
    """
    placed: list[Placed] = []
    bit = 0
    for place, entry in enumerate(entries):
        table = TomlTable(f"{where}[{place}]", entry)
        if "spare" in table:
            bit += table.integer("spare", 1, 64)
            table.finish()
            continue
        field = read_field(table, enumerations)
        if any(field.name == other.field.name for other in placed):
            raise table.refusal("name", field.name, "a name that the message does not have yet")
        placed.append(Placed(field, bit))
        bit += field.codec.bits
    if not placed:
        raise DefinitionError(where, "spare bits alone", "at least one field")
    for length in lengths:
        if bit <= 8 * length:
            return Layout(length, tuple(placed))
    raise DefinitionError(where, f"{bit} bits", f"at most {8 * lengths[-1]}")


def read_field(table: TomlTable, enumerations: Enumerations) -> Field:
    """The field that a table describes.

    Raises:
        DefinitionError: a key is missing, unknown or cannot be used.
    """
    name, kind = table.text("name"), table.text("type")
    unit, meaning = table.text("unit", ""), table.text("meaning", "")
    enumeration = table.text("values", "") or None
    if enumeration is not None and enumeration not in enumerations:
        raise table.refusal("values", enumeration, ", ".join(enumerations))
    codec = _read_codec(table, kind)
    table.finish()
    return Field(name, codec, unit, meaning, enumeration)


def _read_codec(table: TomlTable, kind: str) -> Codec:
    if kind == "bool":
        return Flag()
    if kind == "cuc":
        return Time()
    match = _TYPE.fullmatch(kind)
    if match is None:
        raise table.refusal("type", kind, "bool, cuc, u1 to u32, i1 to i32")
    bits = int(match[2])
    if table.boolean("wraps"):
        return Counter(bits)
    return _read_number(table, bits, signed=match[1] == "i")


def _read_number(table: TomlTable, bits: int, signed: bool) -> Number:
    whole = "scale" not in table
    scale = Fraction(1) if whole else Fraction(table.decimal("scale"))
    if scale <= 0:
        raise table.refusal("scale", float(scale), "a number above 0")
    offset = table.integer("offset", -(2**31), 2**31, 0) if whole else 0
    none, absent = table.optional_integer("none"), table.optional_integer("absent")
    codes = [code for code in (none, absent) if code is not None]
    lowest, highest = _limits(table, bits, signed, codes)
    if "range" in table:
        least, most = ((Fraction(limit) - offset) / scale for limit in table.decimal_pair("range"))
        lowest, highest = max(lowest, ceil(least)), min(highest, floor(most))
    if lowest > highest or any(lowest <= code <= highest for code in codes):
        stated = {"none": none, "absent": absent}
        raise DefinitionError(table.where, stated, "codes that are not values in range")
    outside = table.text("outside", "none")
    if outside not in _OUTSIDE:
        raise table.refusal("outside", outside, " or ".join(_OUTSIDE))
    return Number(
        bits=bits,
        signed=signed,
        lowest=lowest,
        highest=highest,
        steps_per_unit=float(1 / scale),
        offset=offset,
        whole=whole,
        none=none,
        absent=absent,
        nearest=outside == "nearest",
    )


def _limits(table: TomlTable, bits: int, signed: bool, codes: Sequence[int]) -> tuple[int, int]:
    """Raw limits of a type, less the codes that lie at its ends."""
    lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    for code in codes:
        if not lowest <= code <= highest:
            raise DefinitionError(table.where, code, f"codes from {lowest} to {highest}")
    while lowest in codes:
        lowest += 1
    while highest in codes:
        highest -= 1
    return lowest, highest
