"""Read fields and layouts from tables of an interface definition, key by key, with errors that name the place."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from difflib import get_close_matches
from fractions import Fraction
from itertools import permutations
from math import ceil, floor
from typing import Final

from lidar_protocol.errors import DefinitionError, UnknownKeyError
from lidar_protocol.fields import Codec, Constant, Counter, Field, Flag, Number, Real, Time
from lidar_protocol.layout import FILLED_IN, ByteOrder, Layout, PlacedField

_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")
_A_NAME = "at most 32 lower-case letters, digits and underscores, the first a letter"
_WORDS_OF_C = """
alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t char8_t class compl
concept const const_cast consteval constexpr constinit continue co_await co_return co_yield decltype default delete
do double dynamic_cast else enum explicit export extern false float for friend goto if inline int long mutable
namespace new noexcept not not_eq nullptr operator or or_eq private protected public register reinterpret_cast
requires restrict return short signed sizeof static static_assert static_cast struct switch template this
thread_local throw true try typedef typeid typename union unsigned using virtual void volatile wchar_t while xor
xor_eq
"""
"""Keywords of C and C++: members of structures in lidar.h have the names of fields."""


class TomlTable:
    """A table whose keys are taken one by one; `finish` refuses the remaining ones."""

    def __init__(self, where: str, value: object) -> None:
        if not isinstance(value, dict):
            raise DefinitionError(where, value, "a table")
        self.where = where
        self._left = dict(value)
        self._known: dict[str, None] = {}

    def __contains__(self, key: str) -> bool:
        self._known[key] = None
        return key in self._left

    def text(self, key: str, default: str | None = None, expected: str = "a text") -> str:
        """A text; required without a default."""
        value = self._take(key, default, expected)
        if not isinstance(value, str):
            raise self.refusal(key, value, expected)
        return value

    def name(self, key: str) -> str:
        """A name that is valid in all generated languages and formats; required."""
        value = self.text(key, expected=_A_NAME)
        if not _NAME.fullmatch(value):
            raise self.refusal(key, value, _A_NAME)
        if value in _WORDS_OF_C.split():
            raise self.refusal(key, value, "no keyword of C or C++")
        return value

    def choice(self, key: str, choices: Collection[str], default: str | None = None) -> str:
        """One of several texts; required without a default."""
        value = self._take(key, default, " or ".join(choices))
        if not isinstance(value, str) or value not in choices:
            raise self.refusal(key, value, " or ".join(choices))
        return value

    def boolean(self, key: str) -> bool:
        """`true` or `false`; false where left out."""
        value = self._take(key, False, "true or false")
        if not isinstance(value, bool):
            raise self.refusal(key, value, "true or false")
        return value

    def integer(self, key: str, lowest: int, highest: int, default: int | None = None) -> int:
        """A whole number from `lowest` to `highest`; required without a default."""
        expected = f"a whole number from {lowest} to {highest}"
        value = self._take(key, default, expected)
        if isinstance(value, bool) or not isinstance(value, int) or not lowest <= value <= highest:
            raise self.refusal(key, value, expected)
        return value

    def optional_integer(self, key: str) -> int | None:
        """A whole number, or None where it is left out."""
        return self.integer(key, -(2**63), 2**64) if key in self else None

    def decimal(self, key: str) -> Decimal:
        """A number, exactly as written."""
        return self._as_decimal(key, self._take(key, None, "a number"))

    def decimal_pair(self, key: str) -> tuple[Decimal, Decimal]:
        """Two numbers in ascending order, exactly as written."""
        value = self._take(key, None, "two numbers")
        if not isinstance(value, list) or len(value) != 2:
            raise self.refusal(key, value, "two numbers")
        low, high = (self._as_decimal(key, item) for item in value)
        if low >= high:
            raise self.refusal(key, value, "two numbers in ascending order")
        return low, high

    def items(self, key: str) -> list[object]:
        """A non-empty list."""
        value = self._take(key, None, "a list")
        if not isinstance(value, list) or not value:
            raise self.refusal(key, value, "a list that is not empty")
        return value

    def table(self, key: str) -> TomlTable:
        """A table within this one."""
        return TomlTable(self._at(key), self._take(key, None, "a table"))

    def peek(self, key: str) -> TomlTable:
        """A table within this one, without taking it."""
        return TomlTable(self._at(key), self._left[key])

    def optional_table(self, key: str) -> TomlTable | None:
        """A table within this one, or None where it is left out."""
        return self.table(key) if key in self else None

    def optional_tables(self, key: str) -> list[TomlTable]:
        """A list of tables; empty where it is left out."""
        return self.tables(key) if key in self else []

    def tables(self, key: str) -> list[TomlTable]:
        """A list of tables."""
        return [TomlTable(f"{self._at(key)}[{place}]", item) for place, item in enumerate(self.items(key))]

    def names(self) -> list[str]:
        """Remaining keys."""
        return list(self._left)

    def check_name(self, key: str) -> None:
        """Refuse a key that is no name, see `name`."""
        if not _NAME.fullmatch(key):
            raise DefinitionError(self.where, key, f"tables named with {_A_NAME}")

    def rest(self) -> dict[str, object]:
        """Take all remaining keys."""
        rest, self._left = self._left, {}
        return rest

    def finish(self) -> None:
        """Refuse the remaining keys."""
        if self._left:
            first, *_ = self._left
            hint = "".join(f"did you mean {near}? " for near in get_close_matches(first, self._known, 1))
            raise UnknownKeyError(self._at(first), None, f"{hint}known here: {', '.join(self._known)}")

    def refusal(self, key: str, value: object, expected: str) -> DefinitionError:
        """Error for the value of a key."""
        return DefinitionError(self._at(key), value, expected)

    def _at(self, key: str) -> str:
        return f"{self.where} {key}" if self.where.endswith(":") else f"{self.where}.{key}"

    def _take(self, key: str, default: object, expected: str) -> object:
        self._known[key] = None
        if key in self._left:
            return self._left.pop(key)
        if default is None:
            renamed = "".join(f", or rename {near}" for near in get_close_matches(key, self._left, 1))
            raise self.refusal(key, None, expected + renamed)
        return default

    def _as_decimal(self, key: str, value: object) -> Decimal:
        if isinstance(value, bool) or not isinstance(value, int | Decimal):
            raise self.refusal(key, value, "a number")
        number = Decimal(value)
        # A fraction of 1e999999999 takes all memory.
        if not number.is_finite() or abs(number.adjusted()) > _MOST_DIGITS:
            raise self.refusal(key, str(number), f"a finite number of at most {_MOST_DIGITS} digits")
        return number


Enumerations = Mapping[str, Mapping[str, int]]
Entry = Mapping[str, object]

_TYPE = re.compile(r"([ui])([1-9]|[1-5]\d|6[0-4])")
_TYPES = "bool, cuc, f32, f64, u1 to u64, i1 to i64"
_REALS = {"f32": (32, 3.4028234663852886e38), "f64": (64, 1.7976931348623157e308)}
_OUTSIDE = ("none", "nearest")
_MOST_DIGITS = 400
"""More than 64-bit floating point has, before or after the point."""
_MOST_BEAMS = 64


def read_layout(
    where: str,
    entries: Sequence[Entry],
    enumerations: Enumerations,
    lengths: Sequence[int],
    byte_order: ByteOrder,
    of_beams: bool = False,
) -> Layout:
    """Read the layout of a list of fields and spare bits.

    Args:
        where: place in the definition, for error messages.
        enumerations: enumerations that fields may refer to.
        lengths: allowed lengths in bytes, ascending; the first sufficient one is taken.
        of_beams: whether a field may belong to one beam.

    Raises:
        DefinitionError: a field cannot be used, a name occurs twice, or the fields do not fit into any of `lengths`.
    """
    placed: list[PlacedField] = []
    bit = 0
    for place, entry in enumerate(entries):
        table = TomlTable(f"{where}[{place}]", entry)
        if "spare" in table:
            bit += table.integer("spare", 1, 64)
            table.finish()
            continue
        field = read_field(table, enumerations, of_beams)
        if any(field.key == other.field.key for other in placed):
            raise table.refusal("name", field.name, "a name that is unique in the message")
        if any(f"has_{a}" == b for o in placed for a, b in permutations((field.key, o.field.key))):
            remedy = "a name that is no other field's with has_ before it: lidar.h has such a member"
            raise table.refusal("name", field.name, remedy)
        if isinstance(field.codec, Real) and bit % 8:
            raise table.refusal("type", f"f{field.codec.bits}", "placed at the start of a byte")
        placed.append(PlacedField(field, bit))
        bit += field.codec.bits
    if not placed:
        raise DefinitionError(where, "spare bits alone", "at least one field")
    for length in lengths:
        if bit <= 8 * length:
            return Layout(length, tuple(placed), byte_order)
    raise DefinitionError(where, f"{bit} bits", f"at most {8 * lengths[-1]} bits")


def read_field(table: TomlTable, enumerations: Enumerations, of_beams: bool = False) -> Field:
    """Read a field from its table.

    Raises:
        DefinitionError: a key is missing, unknown or cannot be used.
    """
    name, kind = table.name("name"), table.text("type", expected=_TYPES)
    unit, meaning = table.text("unit", ""), table.text("meaning", "")
    enumeration = table.text("values", "") or None
    if enumeration is not None and enumeration not in enumerations:
        raise table.refusal("values", enumeration, ", ".join(enumerations))
    beam = table.integer("beam", 0, _MOST_BEAMS - 1) if of_beams and "beam" in table else None
    codec = _read_codec(table, kind)
    table.finish()
    return Field(name, codec, unit, meaning, enumeration, beam)


def _read_codec(table: TomlTable, kind: str) -> Codec:
    if kind == "bool":
        return Flag()
    if kind == "cuc":
        return Time()
    if kind in _REALS:
        return _read_real(table, *_REALS[kind])
    match = _TYPE.fullmatch(kind)
    if match is None:
        raise table.refusal("type", kind, _TYPES)
    bits = int(match[2])
    if "constant" in table:
        return Constant(bits, table.integer("constant", 0, (1 << bits) - 1))
    if table.boolean("wraps"):
        return Counter(bits)
    return _read_number(table, bits, signed=match[1] == "i")


def _read_real(table: TomlTable, bits: int, largest: float) -> Real:
    lowest, highest = -largest, largest
    if "range" in table:
        low, high = table.decimal_pair("range")
        if float(low) < lowest or float(high) > highest:
            raise table.refusal("range", [float(low), float(high)], f"within -{largest:g} to {largest:g}")
        lowest, highest = float(low), float(high)
    return Real(bits, lowest, highest, nearest=_outside(table) == "nearest")


def _outside(table: TomlTable) -> str:
    outside = table.text("outside", "none")
    if outside not in _OUTSIDE:
        raise table.refusal("outside", outside, " or ".join(_OUTSIDE))
    return outside


def _read_number(table: TomlTable, bits: int, signed: bool) -> Number:
    whole = "scale" not in table
    scale = Fraction(1) if whole else Fraction(written := table.decimal("scale"))
    if not 1e-30 <= scale <= 1e30:
        raise table.refusal("scale", str(written), "a number above 0, from 1e-30 to 1e30")
    offset = table.integer("offset", -(2**31), 2**31, 0) if whole else 0
    none, absent = table.optional_integer("none"), table.optional_integer("absent")
    codes = [code for code in (none, absent) if code is not None]
    lowest, highest = _limits(table, bits, signed, codes)
    if "range" in table:
        least, most = ((Fraction(limit) - offset) / scale for limit in table.decimal_pair("range"))
        lowest, highest = max(lowest, ceil(least)), min(highest, floor(most))
    if lowest > highest or any(lowest <= code <= highest for code in codes):
        stated = {"none": none, "absent": absent}
        raise DefinitionError(table.where, stated, "codes outside the range of the values")
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
        nearest=_outside(table) == "nearest",
    )


def _limits(table: TomlTable, bits: int, signed: bool, codes: Sequence[int]) -> tuple[int, int]:
    lowest, highest = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    for code in codes:
        if not lowest <= code <= highest:
            raise DefinitionError(table.where, code, f"a code from {lowest} to {highest}")
    while lowest in codes:
        lowest += 1
    while highest in codes:
        highest -= 1
    return lowest, highest


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
        name = own.get("name")
        same = known.get(name, {}) if isinstance(name, str) else {}
        base = {key: value for key, value in same.items() if key != "beam"}
        if "type" in own:  # codes belong to a type
            base.pop("none", None)
            base.pop("absent", None)
        if not own.keys() & {"type", "spare"} and "type" not in base:
            raise table.refusal("name", name, "the name of a field of the packet, or beside a type")
        return [base | own]


def by_name(entries: Sequence[Entry]) -> dict[object, Entry]:
    """Tables of fields by the names of the fields."""
    return {entry["name"]: entry for entry in entries if "name" in entry}


def require_capacity(layout: Layout, where: str, name: str, most: int) -> None:
    """Refuse a field whose type cannot hold the values up to `most` that the library fills in.

    Raises:
        DefinitionError: the type cannot hold them.
    """
    codec = next((placed.field.codec for placed in layout.placed if placed.field.name == name), None)
    if codec is None or isinstance(codec, Counter | Constant):
        return
    if not isinstance(codec, Number) or not codec.whole or codec.limits[1] < most:
        raise DefinitionError(
            f"{where}: {name}.type", f"{codec.bits} bits", f"a type of whole numbers that holds {most}"
        )
