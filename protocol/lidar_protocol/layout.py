"""Fields one after another in a run of bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from lidar_protocol.compiled import ByteOrder, Functions, Pack, Placed, Unpack, UnpackEach, compiled
from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Value

__all__ = ["FILLED_IN", "ByteOrder", "Layout", "Placed", "joined"]

FILLED_IN: Final = frozenset({"shot_counter", "details", "interface_version", "beam_count", "command"})
"""Fields that the library fills in; the caller's values need not hold them, and do not count."""

_SILENT: Final = frozenset({"shot_counter"})
"""It is read before a message is unpacked."""

_NOTHING: Final[Mapping[str, Value]] = {}


@dataclass(frozen=True)
class Layout:
    """A block of `length` bytes. Bits that no field takes are sent as zero and ignored on reception."""

    length: int
    placed: tuple[Placed, ...]
    byte_order: ByteOrder = "big"

    def pack(self, values: Mapping[str, Value], own: Mapping[str, Value] = _NOTHING) -> bytes:
        """The block; keys of `values` that are not in it are passed over. `own` holds fields of `FILLED_IN`.

        Raises:
            EncodeError: a value is missing or cannot be sent.
        """
        try:
            return self.packing(values, own)
        except KeyError as missing:
            raise EncodeError(f"{missing.args[0]} is missing") from None

    def unpack(self, data: bytes, offset: int = 0) -> dict[str, Value]:
        """The values of the block that starts at `offset`, in the order of the fields."""
        return self.unpacking(data, offset)

    @cached_property
    def packing(self) -> Pack:
        """`pack` for those who answer a KeyError themselves."""
        return self._functions.pack

    @cached_property
    def unpacking(self) -> Unpack:
        """`unpack`, without a default."""
        return self._functions.unpack

    @cached_property
    def unpacking_each(self) -> UnpackEach:
        """The values of blocks that follow one another and are all of the bytes."""
        return self._functions.unpack_each

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of the fields."""
        return frozenset(placed.field.name for placed in self.placed)

    @cached_property
    def absent(self) -> bytes:
        """The block with each field's code for "absent"."""
        word = 0
        for placed in self.placed:
            word |= placed.field.codec.absent_raw << self._shift(placed)
        return word.to_bytes(self.length, self.byte_order)

    @cached_property
    def _functions(self) -> Functions:
        return compiled(self.length, self.placed, self.byte_order, FILLED_IN, _SILENT)

    def _shift(self, placed: Placed) -> int:
        if self.byte_order == "little":
            return placed.first_bit
        return 8 * self.length - placed.first_bit - placed.field.codec.bits


def joined(layouts: Sequence[Layout]) -> Layout:
    """Blocks that follow one another as one. Of a name that comes twice, the last value counts."""
    placed, length = [], 0
    for layout in layouts:
        placed += [each._replace(first_bit=8 * length + each.first_bit) for each in layout.placed]
        length += layout.length
    return Layout(length, tuple(placed), layouts[0].byte_order)
