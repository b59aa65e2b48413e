"""Fields: physical values to bit patterns and back.

A value outside its range never wraps: it is sent as the field's code for "none", or as the nearest value that
can be sent. A missing value (None, NaN) is the code for "none"; what is not in range on reception is None.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import floor
from typing import ClassVar, Protocol

from lidar_protocol import cuc
from lidar_protocol.errors import EncodeError

Value = int | float | None
"""What a field holds: a bool, an int, a float in the field's unit, or None where there is no value."""

Encoder = Callable[[Value], int]
Decoder = Callable[[int], Value]


class Codec(Protocol):
    """How values become `bits` bits, as unsigned numbers.

    A packet takes sixty of these conversions. So a codec hands out functions that hold what they need, where
    methods would spend their time on looking it up.
    """

    @property
    def bits(self) -> int: ...
    @property
    def absent_raw(self) -> int: ...
    def encoder(self) -> Encoder: ...
    def decoder(self) -> Decoder: ...


@dataclass(frozen=True, slots=True)
class Flag:
    """One bit; None is sent as 0."""

    bits: ClassVar[int] = 1
    absent_raw: ClassVar[int] = 0

    def encoder(self) -> Encoder:
        return lambda value: 1 if value else 0

    def decoder(self) -> Decoder:
        return bool


@dataclass(frozen=True, slots=True)
class Counter:
    """A whole number that wraps: its lowest bits."""

    bits: int
    absent_raw: ClassVar[int] = 0

    def encoder(self) -> Encoder:
        mask = (1 << self.bits) - 1
        return lambda value: _required(value) & mask

    def decoder(self) -> Decoder:
        return int


@dataclass(frozen=True, slots=True)
class Time:
    """Nanoseconds from the epoch as a CUC time code."""

    bits: ClassVar[int] = cuc.BITS
    absent_raw: ClassVar[int] = 0

    def encoder(self) -> Encoder:
        return lambda value: cuc.ticks_from_ns(_required(value))

    def decoder(self) -> Decoder:
        return cuc.ns_from_ticks


@dataclass(frozen=True, slots=True)
class Number:
    """A number in steps of a unit: value = raw / steps_per_unit + offset.

    Limits and codes are raw, with their sign. Dividing by a whole number of steps rounds correctly, where
    multiplying by 0.001 would not.
    """

    bits: int
    signed: bool
    lowest: int
    highest: int
    steps_per_unit: float = 1.0
    offset: int = 0
    whole: bool = True
    """Decoded as an int (steps_per_unit is 1); otherwise as a float (offset is 0)."""
    none: int | None = None
    absent: int | None = None
    nearest: bool = False

    @property
    def limits(self) -> tuple[float, float]:
        """The least and the greatest value."""
        low, high = (raw / self.steps_per_unit + self.offset for raw in (self.lowest, self.highest))
        return low, high

    @property
    def absent_raw(self) -> int:
        code = self.absent if self.absent is not None else self.none
        return (code or 0) % (1 << self.bits)

    def encoder(self) -> Encoder:
        lowest, end = self.lowest, self.highest + 1
        steps_per_unit, half_up = self.steps_per_unit, 0.5 - self.offset * self.steps_per_unit
        mask = (1 << self.bits) - 1

        def to_raw(value: Value) -> int:
            if value is not None:
                steps = value * steps_per_unit + half_up
                if lowest <= steps < end:  # false for NaN
                    return floor(steps) & mask
            return self._outside(value) & mask

        return to_raw

    def _outside(self, value: Value) -> int:
        if self.nearest and value is not None and value == value:
            return self.lowest if (value - self.offset) * self.steps_per_unit < self.lowest else self.highest
        if self.none is None:
            raise EncodeError(f"{value!r} cannot be sent, and there is no code for none")
        return self.none

    def decoder(self) -> Decoder:
        lowest, highest, steps_per_unit, offset = self.lowest, self.highest, self.steps_per_unit, self.offset
        modulus = 1 << self.bits
        largest = modulus // 2 - 1 if self.signed else modulus - 1

        def whole(raw: int) -> Value:
            if raw > largest:
                raw -= modulus
            return raw + offset if lowest <= raw <= highest else None

        def scaled(raw: int) -> Value:
            if raw > largest:
                raw -= modulus
            return raw / steps_per_unit if lowest <= raw <= highest else None

        return whole if self.whole else scaled


@dataclass(frozen=True)
class Field:
    """A named value in a message."""

    name: str
    codec: Codec
    unit: str = ""
    meaning: str = ""
    enumeration: str | None = None
    """Name of the interface's enumeration that the value comes from."""


def _required(value: Value) -> int:
    if value is None:
        raise EncodeError("there is no code for none")
    return int(value)
