"""Fields one after another in a run of bytes, most significant bit first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from lidar_protocol.errors import EncodeError
from lidar_protocol.fields import Field, Value


class Placed(NamedTuple):
    """A field and its place: `first_bit` counts from the most significant bit of byte 0."""

    field: Field
    first_bit: int


@dataclass(frozen=True)
class Layout:
    """A block of `length` bytes. Bits that no field takes are sent as zero and ignored on reception."""

    length: int
    placed: tuple[Placed, ...]

    def pack(self, values: Mapping[str, Value]) -> bytes:
        """The block; keys of `values` that are not in it are passed over.

        Raises:
            EncodeError: a value is missing or cannot be sent.
        """
        word = 0
        name = ""
        try:
            for name, shift, to_raw in self._packing:
                word |= to_raw(values[name]) << shift
        except KeyError:
            raise EncodeError(f"{name} is missing") from None
        except EncodeError as error:
            raise EncodeError(f"{name}: {error}") from None
        return word.to_bytes(self.length, "big")

    def unpack(self, block: bytes) -> dict[str, Value]:
        """The values of a block of `length` bytes, in the order of the fields."""
        word = int.from_bytes(block, "big")
        return {name: from_raw(word >> shift & mask) for name, shift, mask, from_raw in self._unpacking}

    @cached_property
    def absent(self) -> bytes:
        """The block with each field's code for "absent"."""
        word = 0
        for field, first_bit in self.placed:
            word |= field.codec.absent_raw << self._shift(field, first_bit)
        return word.to_bytes(self.length, "big")

    @cached_property
    def _packing(self) -> list[tuple[str, int, Callable[[Value], int]]]:
        return [
            (field.name, self._shift(field, first), field.codec.encoder()) for field, first in self.placed
        ]

    @cached_property
    def _unpacking(self) -> list[tuple[str, int, int, Callable[[int], Value]]]:
        return [
            (field.name, self._shift(field, first), (1 << field.codec.bits) - 1, field.codec.decoder())
            for field, first in self.placed
        ]

    def _shift(self, field: Field, first_bit: int) -> int:
        return 8 * self.length - first_bit - field.codec.bits
