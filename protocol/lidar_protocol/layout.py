"""Layout of fields in a block of bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from lidar_protocol.compiled import ByteOrder, Functions, Pack, PlacedField, Unpack, UnpackEach, compiled
from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Value

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
        for placed in self.placed:
            word |= placed.field.codec.absent_raw << self._shift(placed)
        return word.to_bytes(self.length, self.byte_order)

    @cached_property
    def _functions(self) -> Functions:
        return compiled(self.length, self.placed, self.byte_order, FILLED_IN, _SILENT)

    def _shift(self, placed: PlacedField) -> int:
        if self.byte_order == "little":
            return placed.first_bit
        return 8 * self.length - placed.first_bit - placed.field.codec.bits


def joined(layouts: Sequence[Layout]) -> Layout:
    """Join consecutive blocks to one. If a name occurs twice, the last value counts."""
    placed, length = [], 0
    for layout in layouts:
        placed += [each._replace(first_bit=8 * length + each.first_bit) for each in layout.placed]
        length += layout.length
    return Layout(length, tuple(placed), layouts[0].byte_order)
