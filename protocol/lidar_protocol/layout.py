"""Layouts of fields in blocks of bytes, each compiled to functions once, when an interface is loaded.

A loop over the fields would cost a microsecond for three fields. Instead, each block becomes one `struct` of runs of
bytes, and one expression per field; a field of 1, 2, 4 or 8 whole bytes is a run of its own. For a flag, a 7-bit number
and a u16 with a code for none:

    def pack(values, own):
        return struct_pack(
            (128 if values['fired'] else 0) | (...),
            65535 if (v := values['range_m']) is None else ...,
        )

    def unpack(block, offset):
        c0_0, c1_0, = struct_unpack(block, offset)
        values = {'fired': (c0_0 & 128) != 0, ..., 'range_m': r / 1000.0 if (r := c1_0) <= 65534 else None}
        return values

    def unpack_each(blocks):
        found = []
        for c0_0, c1_0, in iter_struct(blocks):
            values = {...}
            found.append(values)
        return found

The source consists only of numbers, operators and names that were checked when the definition was read.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import floor
from typing import Any, Final, Literal, NamedTuple

from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Counter, Field, Flag, Real, Value

ByteOrder = Literal["big", "little"]
Pack = Callable[[Mapping[str, Value], Mapping[str, Value]], bytes]
"""(values, own) -> block. KeyError names a value that is missing."""
Unpack = Callable[[bytes, int], dict[str, Value]]
"""(bytes, offset of the block) -> values."""
UnpackEach = Callable[[bytes], list[dict[str, Value]]]
"""Consecutive blocks -> the values of each."""


class Functions(NamedTuple):
    """Compiled functions of a block."""

    pack: Pack
    unpack: Unpack
    unpack_each: UnpackEach


_LETTERS = {8: "Q", 4: "I", 2: "H", 1: "B"}


class PlacedField(NamedTuple):
    """A field and its position: `first_bit` counts from the first bit of byte 0, the most significant bit in a
    big-endian block and the least significant bit in a little-endian block."""

    field: Field
    first_bit: int

    @property
    def first_byte(self) -> int:
        return self.first_bit // 8

    @property
    def end_byte(self) -> int:
        return (self.first_bit + self.field.codec.bits + 7) // 8


@dataclass(frozen=True)
class _Run:
    """Consecutive bytes whose fields share no byte with other runs."""

    number: int
    fields: list[PlacedField]
    order: ByteOrder

    @property
    def first_byte(self) -> int:
        return self.fields[0].first_byte

    @property
    def length(self) -> int:
        return self.fields[-1].end_byte - self.first_byte

    @property
    def is_own_number(self) -> bool:
        """Whether the run is one field that `struct` reads directly."""
        return (
            len(self.fields) == 1 and self.fields[0].field.codec.bits == 8 * self.length == 8 * self.parts[0]
        )

    @property
    def is_signed(self) -> bool:
        """Whether the run is one signed number."""
        codec = self.fields[0].field.codec
        return len(self.fields) == 1 and codec.signed and codec.bits == 8 * self.length

    @property
    def parts(self) -> list[int]:
        """Lengths of the `struct` items that make up the run."""
        parts, left = [], self.length
        while left:
            parts.append(next(length for length in _LETTERS if length <= left))
            left -= parts[-1]
        return parts

    @property
    def names(self) -> list[str]:
        """Variables of the parts."""
        return [f"c{self.number}_{k}" for k in range(len(self.parts))]

    @property
    def shifts(self) -> list[int]:
        """Shift of each part, from the lowest bit of the run."""
        before = [8 * sum(self.parts[:k]) for k in range(len(self.parts))]
        if self.order == "little":
            return before
        return [8 * (self.length - length) - bits for length, bits in zip(self.parts, before, strict=True)]

    @property
    def format(self) -> str:
        codec = self.fields[0].field.codec
        if isinstance(codec, Real):
            return codec.code
        letters = [_LETTERS[length] for length in self.parts]
        if self.is_signed:  # the part with the sign
            top = self.shifts.index(max(self.shifts))
            letters[top] = letters[top].lower()
        return "".join(letters)

    def shift(self, placed: PlacedField) -> int:
        """Shift of the field, from the lowest bit of the run."""
        before = placed.first_bit - 8 * self.first_byte
        return before if self.order == "little" else 8 * self.length - before - placed.field.codec.bits


def compiled(
    length: int, placed: Sequence[PlacedField], order: ByteOrder, own: frozenset[str], silent: frozenset[str]
) -> Functions:
    """Compile the functions of a block of `length` bytes.

    Args:
        placed: fields in ascending order of position.
        own: names of fields that the library fills in.
        silent: names of fields that are not decoded.
    """
    runs = _runs(placed, order)
    block = struct.Struct(_format(length, runs, order))
    names: dict[str, Any] = {
        "floor": floor,
        "struct_pack": block.pack,
        "struct_unpack": block.unpack_from,
        "iter_struct": block.iter_unpack,
    }
    parts = " ".join(f"{name}," for run in runs for name in run.names)
    read = [f"{run.names[0]} = {_joined(run)}" for run in runs if len(run.parts) > 1]
    read += _collected([entry for run in runs for entry in _unpacked(run, silent)])
    source = [
        "def pack(values, own):",
        " return struct_pack(",
        *(f"  {number}," for run in runs for number in _packed(run, own, names)),
        " )",
        "def unpack(block, offset):",
        f" {parts} = struct_unpack(block, offset)",
        *(f" {line}" for line in read),
        " return values",
        "def unpack_each(blocks):",
        " found = []",
        f" for {parts} in iter_struct(blocks):",
        *(f"  {line}" for line in read),
        "  found.append(values)",
        " return found",
    ]
    exec("\n".join(source), names)
    return Functions(names["pack"], names["unpack"], names["unpack_each"])


def _collected(entries: Sequence[tuple[str, str]]) -> list[str]:
    """Lines that build a dictionary. Python presizes a display of up to fifteen entries."""
    first = ", ".join(f"{key!r}: {value}" for key, value in entries[:15])
    return [f"values = {{{first}}}", *(f"values[{key!r}] = {value}" for key, value in entries[15:])]


def _runs(placed: Sequence[PlacedField], order: ByteOrder) -> list[_Run]:
    runs: list[_Run] = []
    for each in placed:
        if runs and each.first_byte < runs[-1].fields[-1].end_byte:
            runs[-1].fields.append(each)
        else:
            runs.append(_Run(len(runs), [each], order))
    return runs


def _format(length: int, runs: Sequence[_Run], order: ByteOrder) -> str:
    text, place = ">" if order == "big" else "<", 0
    for run in runs:
        text += "x" * (run.first_byte - place) + run.format
        place = run.first_byte + run.length
    return text + "x" * (length - place)


def _packed(run: _Run, own: frozenset[str], names: dict[str, Any]) -> list[str]:
    if run.is_own_number:
        return [_raw(run.fields[0], own, names)]
    if run.is_signed:
        number = f"({_raw(run.fields[0], own, names)})"
    else:
        number = " | ".join(_shifted(placed, run.shift(placed), own, names) for placed in run.fields)
    if len(run.parts) == 1:
        return [number]
    whole = [f"(n := {number})", *["n"] * (len(run.parts) - 1)]
    parts = []
    for each, shift, length in zip(whole, run.shifts, run.parts, strict=True):
        shifted = f"{each} >> {shift}" if shift else each
        # The top part is not masked, as only the sign is above it.
        parts.append(shifted if shift == max(run.shifts) else f"{shifted} & {(1 << 8 * length) - 1}")
    return parts


def _shifted(placed: PlacedField, shift: int, own: frozenset[str], names: dict[str, Any]) -> str:
    codec, raw = placed.field.codec, _raw(placed, own, names)
    if isinstance(codec, Flag):
        return f"({1 << shift} if {_source(placed, own)} else 0)"
    sure = f"(({raw}) & {(1 << codec.bits) - 1})" if codec.signed else f"({raw})"
    return f"{sure} << {shift}" if shift else sure


def _source(placed: PlacedField, own: frozenset[str]) -> str:
    return f"{'own' if placed.field.name in own else 'values'}[{placed.field.key!r}]"


def _raw(placed: PlacedField, own: frozenset[str], names: dict[str, Any]) -> str:
    field, source = placed.field, _source(placed, own)
    if isinstance(field.codec, Counter) and field.name in own:  # the library's own are whole numbers
        return f"{source} & {(1 << field.codec.bits) - 1}"

    def bind(function: Callable[[Value], int | float]) -> str:
        name = f"{function.__name__.strip('_')}_of_{field.key}"
        names[name] = _named(function, field.key)
        return name

    return field.codec.raw(source, bind)


def _named(function: Callable[[Value], int | float], name: str) -> Callable[[Value], int | float]:
    def named(value: Value) -> int | float:
        try:
            return function(value)
        except EncodeError as error:
            raise EncodeError(f"{name}: {error}") from None

    return named


def _joined(run: _Run) -> str:
    parts = zip(run.names, run.shifts, strict=True)
    return " | ".join(f"{name} << {shift}" if shift else name for name, shift in parts)


def _unpacked(run: _Run, silent: frozenset[str]) -> list[tuple[str, str]]:
    name = run.names[0]
    if run.is_own_number:
        field = run.fields[0].field
        return [] if field.name in silent else [(field.key, field.codec.value(name))]
    entries = []
    for placed in run.fields:
        if placed.field.name in silent:
            continue
        codec, shift = placed.field.codec, run.shift(placed)
        if isinstance(codec, Flag):
            raw = f"{name} & {1 << shift}"
        else:
            raw = f"{name} >> {shift}" if shift else name
            if shift + codec.bits < 8 * run.length:
                raw = f"{raw} & {(1 << codec.bits) - 1}"
        if codec.signed and not run.is_signed:
            sign = 1 << codec.bits - 1
            raw = f"({raw} ^ {sign}) - {sign}"
        entries.append((placed.field.key, codec.value(raw)))
    return entries


__all__ = ["FILLED_IN", "ByteOrder", "Layout", "PlacedField", "joined"]

FILLED_IN: Final = frozenset({"shot_counter", "details", "interface_version", "beam_count", "command"})
"""Fields that the library fills in; values of the caller are ignored."""

_SILENT: Final = frozenset({"shot_counter"})
"""Fields that are decoded before a message is unpacked."""

_NOTHING: Final[Mapping[str, Value]] = {}


@dataclass(frozen=True)
class Layout:
    """Layout of a block of `length` bytes. Unused bits are sent as zero and ignored on reception."""

    length: int
    placed: tuple[PlacedField, ...]
    byte_order: ByteOrder = "big"

    def pack(self, values: Mapping[str, Value], own: Mapping[str, Value] = _NOTHING) -> bytes:
        """Encode a block. Other keys of `values` are ignored; `own` holds fields of `FILLED_IN`.

        Raises:
            EncodeError: a value is missing or cannot be sent.
        """
        try:
            return self.packing(values, own)
        except KeyError as missing:
            raise EncodeError(f"{missing.args[0]} is missing") from None

    def unpack(self, data: bytes, offset: int = 0) -> dict[str, Value]:
        """Decode the block that starts at `offset`; values are in the order of the fields."""
        return self.unpacking(data, offset)

    def unpack_field(self, name: str, data: bytes) -> Value:
        """Decode one field of a block that may be cut short; None if the block ends before the field does."""
        (placed,) = (each for each in self.placed if each.field.name == name)
        if len(data) < placed.end_byte:
            return None
        return self.unpack(data.ljust(self.length, b"\0"))[placed.field.key]

    def bits(self, placed: PlacedField, data: bytes) -> int:
        """Bit pattern of a field of a block."""
        bits = placed.field.codec.bits
        last = 8 * self.length - placed.first_bit - bits
        shift = placed.first_bit if self.byte_order == "little" else last
        return int.from_bytes(data, self.byte_order) >> shift & (1 << bits) - 1

    @cached_property
    def packing(self) -> Pack:
        """Compiled `pack`, which raises KeyError for a missing value."""
        return self._functions.pack

    @cached_property
    def unpacking(self) -> Unpack:
        """Compiled `unpack`, without a default offset."""
        return self._functions.unpack

    @cached_property
    def unpacking_each(self) -> UnpackEach:
        """Compiled function that decodes consecutive blocks."""
        return self._functions.unpack_each

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of the fields."""
        return frozenset(placed.field.name for placed in self.placed)

    @cached_property
    def absent(self) -> bytes:
        """Block with the code for "absent" in each field."""
        word = 0
        for field, bit in self.placed:
            shift = bit if self.byte_order == "little" else 8 * self.length - bit - field.codec.bits
            word |= field.codec.absent_raw << shift
        return word.to_bytes(self.length, self.byte_order)

    @cached_property
    def _functions(self) -> Functions:
        return compiled(self.length, self.placed, self.byte_order, FILLED_IN, _SILENT)


def joined(layouts: Sequence[Layout]) -> Layout:
    """Join consecutive blocks to one. If a name occurs twice, the last value counts."""
    placed, length = [], 0
    for layout in layouts:
        placed += [each._replace(first_bit=8 * length + each.first_bit) for each in layout.placed]
        length += layout.length
    return Layout(length, tuple(placed), layouts[0].byte_order)
