"""Fields: codecs between physical values and bit patterns, as Python expressions.

A value outside its range never wraps: it is encoded as the field's code for "none", or as the nearest end of the range.
A missing value (None, NaN) is encoded as "none"; a received pattern outside the range is decoded as None.

A packet needs a hundred of these conversions, so none of them is a call: each codec returns the source of its
expression, and `compiled` joins the expressions of a block to one function.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import floor
from typing import ClassVar

from lidar_protocol.errors import EncodeError

Value = int | float | None
"""Value of a field: a bool, an int, a float in the field's unit, or None for no value."""

Bind = Callable[[Callable[[Value], int | float]], str]
"""Binds a function to a name that the expression can use, and returns the name."""

FRACTION_BITS = 24
"""Bits of a second's fraction in a time code."""
NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Flag:
    """One bit; None is encoded as 0."""

    bits: ClassVar[int] = 1
    signed: ClassVar[bool] = False
    absent_raw: ClassVar[int] = 0

    def raw(self, value: str, bind: Bind) -> str:  # noqa: ARG002
        return f"1 if {value} else 0"

    def value(self, raw: str) -> str:
        return f"({raw}) != 0"


@dataclass(frozen=True)
class Constant:
    """Constant bits, whatever value is given."""

    bits: int
    code: int
    signed: ClassVar[bool] = False

    @property
    def absent_raw(self) -> int:
        return self.code

    def raw(self, value: str, bind: Bind) -> str:  # noqa: ARG002
        return str(self.code)

    def value(self, raw: str) -> str:
        return raw


@dataclass(frozen=True)
class Counter:
    """A whole number that wraps: its least significant bits are sent."""

    bits: int
    signed: ClassVar[bool] = False
    absent_raw: ClassVar[int] = 0

    def raw(self, value: str, bind: Bind) -> str:
        return f"(v if (v := {value}).__class__ is int else {bind(_required)}(v)) & {(1 << self.bits) - 1}"

    def value(self, raw: str) -> str:
        return raw


@dataclass(frozen=True)
class Time:
    """Nanoseconds from the epoch, encoded as a CCSDS unsegmented time code (301.0-B, level 2: an agency-defined epoch),
    4 + 3 bytes, without a P-field.

    Four bytes count seconds from the epoch, three bytes the fraction: one tick is 2**-24 s, about 60 ns.
    """

    bits: ClassVar[int] = 56
    signed: ClassVar[bool] = False
    absent_raw: ClassVar[int] = 0

    def raw(self, value: str, bind: Bind) -> str:
        ticks = f"((v << {FRACTION_BITS}) + {NS_PER_S // 2}) // {NS_PER_S}"
        in_range = f"(v := {value}).__class__ is int and 0 <= (s := {ticks}) < {1 << self.bits}"
        return f"s if {in_range} else {bind(_ticks)}(v)"

    def value(self, raw: str) -> str:
        return f"({raw}) * {NS_PER_S} + {1 << FRACTION_BITS - 1} >> {FRACTION_BITS}"


@dataclass(frozen=True)
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
        """Minimum and maximum value."""
        if self.whole:
            return self.lowest + self.offset, self.highest + self.offset
        return self.lowest / self.steps_per_unit, self.highest / self.steps_per_unit

    @property
    def absent_raw(self) -> int:
        code = self.absent if self.absent is not None else self.none
        return (code or 0) % (1 << self.bits)

    def raw(self, value: str, bind: Bind) -> str:
        if self.whole:
            low, high = self.limits
            less = f" - {self.offset}" if self.offset else ""
            return f"v{less} if (v := {value}).__class__ is int and {low} <= v <= {high} else {bind(self.rounded)}(v)"
        steps = "v + 0.5" if self.steps_per_unit == 1.0 else f"v * {self.steps_per_unit!r} + 0.5"
        least, end = _as_float(self.lowest), _as_float(self.highest + 1)
        in_range = f"floor(s) if {least} <= (s := {steps}) < {end} else {bind(self.outside)}(v)"
        missing = bind(self.outside) + "(v)" if self.none is None else str(self.none)
        return f"{missing} if (v := {value}) is None else {in_range}"

    def rounded(self, value: Value) -> int:
        """Raw number of a value that is not an int, or not in range."""
        if value is not None and self.lowest <= (steps := value + (0.5 - self.offset)) < self.highest + 1:
            return floor(steps)
        return self.outside(value)

    def outside(self, value: Value) -> int:
        """Raw number of a value that is not in range."""
        if self.nearest and value is not None and value == value:
            return self.lowest if (value - self.offset) * self.steps_per_unit < self.lowest else self.highest
        if self.none is None:
            raise EncodeError(f"{value!r} cannot be sent, and the field has no code for none")
        return self.none

    def value(self, raw: str) -> str:
        if self.is_full:
            return self._scaled(f"({raw})")
        # Codes are usually at one end of the range, so that one comparison is enough.
        least, most = self._pattern_limits
        below = "" if self.lowest == least else f"{self.lowest} <= "
        above = "" if self.highest == most else f" <= {self.highest}"
        return f"{self._scaled('r')} if {below}(r := {raw}){above} else None"

    @property
    def _pattern_limits(self) -> tuple[int, int]:
        return (-(1 << self.bits - 1), (1 << self.bits - 1) - 1) if self.signed else (0, (1 << self.bits) - 1)

    @property
    def is_full(self) -> bool:
        """Whether every bit pattern is a value."""
        return (self.lowest, self.highest) == self._pattern_limits

    def _scaled(self, raw: str) -> str:
        if not self.whole:
            return f"{raw} / {self.steps_per_unit!r}"
        return f"{raw} + {self.offset}" if self.offset else raw


@dataclass(frozen=True)
class Real:
    """A floating-point number (IEEE 754) in the field's unit; "none" is NaN."""

    bits: int
    lowest: float
    highest: float
    nearest: bool = False
    signed: ClassVar[bool] = False

    @property
    def code(self) -> str:
        """Format character of `struct`."""
        return "f" if self.bits == 32 else "d"

    @property
    def absent_raw(self) -> int:
        return int.from_bytes(struct.pack(f">{self.code}", float("nan")), "big")

    @property
    def limits(self) -> tuple[float, float]:
        """Minimum and maximum value, rounded to the type."""
        return self._sendable

    @cached_property
    def _sendable(self) -> tuple[float, float]:
        low, high = struct.unpack(f">2{self.code}", struct.pack(f">2{self.code}", self.lowest, self.highest))
        return float(low), float(high)

    def raw(self, value: str, bind: Bind) -> str:
        low, high = self.lowest, self.highest
        return f"v if (v := {value}) is not None and {low!r} <= v <= {high!r} else {bind(self.outside)}(v)"

    def outside(self, value: Value) -> float:
        """Encoded value of a value that is not in range."""
        if self.nearest and value is not None and value == value:
            return self.lowest if value < self.lowest else self.highest
        return float("nan")

    def value(self, raw: str) -> str:
        low, high = self._sendable
        return f"r if {low!r} <= (r := {raw}) <= {high!r} else None"


Codec = Flag | Constant | Counter | Time | Number | Real
"""Conversion between values and `bits` bits.

`signed`: whether the raw number may be negative; `absent_raw`: bit pattern of "absent", without sign; `raw`: expression
of the raw number for the expression `value`, which may use the variables v and s; `value`: expression of the value for
the expression `raw`, which it evaluates at most once, and which may use the variable r."""


@dataclass(frozen=True)
class Field:
    """A named value in a message."""

    name: str
    codec: Codec
    unit: str = ""
    meaning: str = ""
    enumeration: str | None = None
    """Name of the enumeration of the values."""
    beam: int | None = None
    """Number of the beam, for a field of the packet header that belongs to one beam."""

    @property
    def key(self) -> str:
        """Unique key of the field in its block."""
        return self.name if self.beam is None else f"{self.name}_{self.beam}"


def _as_float(number: int) -> str:
    """Limit as a float where exact, because floats are compared fastest; comparisons with NaN are false."""
    return repr(float(number)) if float(number) == number else str(number)


def _required(value: Value) -> int:
    if value is None:
        raise EncodeError("there is no code for none")
    return int(value)


def _ticks(value: Value) -> int:
    return ticks_from_ns(_required(value))


def ticks_from_ns(time_ns: int) -> int:
    """Convert nanoseconds from the epoch to the nearest tick of a time code.

    Raises:
        EncodeError: the time is before the epoch, or 2**32 s or more after it.
    """
    ticks = ((time_ns << FRACTION_BITS) + NS_PER_S // 2) // NS_PER_S
    if 0 <= ticks < 1 << Time.bits:
        return ticks
    raise EncodeError(f"time {time_ns} ns is outside the range of the time code, 2**32 s from the epoch")
