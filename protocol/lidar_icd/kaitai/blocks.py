"""Blocks of fields in Kaitai Struct: what is read, and values that are computed from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from dataclasses import field as data_field

from lidar_icd.kaitai.identifiers import Identifiers
from lidar_icd.kaitai.yaml_text import Type, plain_text
from lidar_protocol import cuc
from lidar_protocol.compiled import PlacedField
from lidar_protocol.fields import Field, Flag, Number, Real, Time
from lidar_protocol.layout import Layout

_MOST_SPARE = 64
_WHOLE_BYTES = (8, 16, 32, 64)
_SECONDS_BITS = cuc.BITS - cuc.FRACTION_BITS


@dataclass
class BlockType:
    """A type of Kaitai Struct with the fields of a layout.

    A field that may have no value becomes three names: `range_m_raw` is read, `has_range_m` says whether it is a
    value, and `range_m` is the value in its unit; where there is none, `range_m` is null.
    """

    layout: Layout
    enums: Mapping[str, str]
    """Identifiers of enumerations, by their names."""
    taken: Iterable[str] = ()
    """Identifiers that fields may not have."""
    seq: list[Type] = data_field(default_factory=list)
    instances: dict[str, Type] = data_field(default_factory=dict)
    values: dict[str, str] = data_field(default_factory=dict)
    """Identifiers of the values, by the keys of the fields."""
    _conditions: dict[str, str] = data_field(default_factory=dict)
    """Identifiers of the conditions that a value exists, by the identifiers of the values."""
    _with_words: set[str] = data_field(default_factory=set)
    """Identifiers of values of an enumeration."""

    def __post_init__(self) -> None:
        self._identifiers = Identifiers(self.taken)
        self.values = {
            placed.field.key: self._identifiers.add(placed.field.key) for placed in self.layout.placed
        }
        bit = 0
        for placed in sorted(self.layout.placed, key=lambda each: each.first_bit):
            self._add_spare(placed.first_bit - bit)
            self._add(placed)
            bit = placed.first_bit + placed.field.codec.bits
        self._add_spare(8 * self.layout.length - bit)

    def type_of(self, *more: Type, **instances: Type) -> Type:
        """The type, with more that is read behind the fields, and with more instances."""
        made: Type = {"seq": [*self.seq, *more]}
        if self.instances or instances:
            made["instances"] = {**self.instances, **instances}
        return made

    def number(self, key: str, missing: int = -1) -> str:
        """Expression of a value as a number, and of another one where there is no value."""
        name = self.values[key]
        number = f"{name}.to_i" if name in self._with_words else name
        condition = self._conditions.get(name)
        return f"({condition} ? {number} : {missing})" if condition else number

    def _add_spare(self, bits: int) -> None:
        while bits > 0:
            self.seq.append({"type": f"b{min(bits, _MOST_SPARE)}"})
            bits -= _MOST_SPARE

    def _add(self, placed: PlacedField) -> None:
        field, name = placed.field, self.values[placed.field.key]
        match field.codec:
            case Flag():
                self.seq.append({"id": name, "type": "b1", **_about(field)})
            case Time():
                self._add_time(placed, name)
            case Real():
                self._add_real(field, field.codec, name)
            case _:
                self._add_number(placed, name)

    def _add_time(self, placed: PlacedField, name: str) -> None:
        """Add seconds and fraction, the lower one first if the lowest bits are, and nanoseconds."""
        seconds = self._identifiers.add(f"{name}_seconds")
        fraction = self._identifiers.add(f"{name}_fraction")
        parts = [(seconds, _SECONDS_BITS), (fraction, cuc.FRACTION_BITS)]
        bit = placed.first_bit
        for part, bits in parts if self.layout.byte_order == "big" else reversed(parts):
            self.seq.append({"id": part, "type": _type(bit, bits)})
            bit += bits
        rest = f"({fraction}.as<s8> * {cuc.NS_PER_S} + {cuc.HALF_TICK}) / {1 << cuc.FRACTION_BITS}"
        value = f"({seconds}.as<s8> * {cuc.NS_PER_S} + {rest}).as<s8>"
        self.instances[name] = {"value": value, **_about(placed.field)}

    def _add_real(self, field: Field, codec: Real, name: str) -> None:
        raw = self._identifiers.add(f"{name}_raw")
        self.seq.append({"id": raw, "type": f"f{codec.bits // 8}"})
        low, high = map(_real_text, codec.limits)
        self._add_value(field, name, raw, f"{raw} >= {low} and {raw} <= {high}", {})

    def _add_number(self, placed: PlacedField, name: str) -> None:
        field, codec = placed.field, placed.field.codec
        words = self._words(field, name)
        kind = _type(placed.first_bit, codec.bits, codec.signed)
        is_ready = bool(words) or not (kind == "b1" or (codec.signed and kind.startswith("b")))
        if is_ready and (not isinstance(codec, Number) or _is_as_read(codec)):
            self.seq.append({"id": name, "type": kind, **words, **_about(field)})
            return
        raw = self._add_raw(name, kind, codec.bits, codec.signed)
        value, has_value = raw, ""
        if isinstance(codec, Number):
            value, has_value = _scaled(codec, raw), _in_range(codec, raw)
        self._add_value(field, name, value, has_value, words)

    def _words(self, field: Field, name: str) -> Type:
        """The enumeration of a field whose raw numbers are codes of the enumeration."""
        codec, enum = field.codec, self.enums.get(field.enumeration or "")
        if enum is None or (isinstance(codec, Number) and (codec.offset or not codec.whole)):
            return {}
        self._with_words.add(name)
        return {"enum": enum}

    def _add_raw(self, name: str, kind: str, bits: int, signed: bool) -> str:
        """Add a raw number; returns its identifier. Bits alone are read without sign, and one bit is a truth value."""
        raw = self._identifiers.add(f"{name}_raw")
        if kind != "b1" and not (signed and kind.startswith("b")):
            self.seq.append({"id": raw, "type": kind})
            return raw
        read = self._identifiers.add(f"{name}_bits")
        self.seq.append({"id": read, "type": kind})
        number = f"{read}.to_i" if kind == "b1" else read
        half = 1 << bits - 1
        signed_value = f"({number} < {half} ? {number} : {number} - {half} - {half}).as<s8>"
        self.instances[raw] = {"value": signed_value if signed else number}
        return raw

    def _add_value(self, field: Field, name: str, value: str, has_value: str, words: Type) -> None:
        """Add a value, and if it may be missing the condition that there is one."""
        made: Type = {"value": value, **words}
        if has_value:
            made["if"] = self._conditions[name] = has = self._identifiers.add(f"has_{name}")
            self.instances[has] = {"value": has_value, "doc": f"Whether there is a value of {name}"}
        self.instances[name] = {**made, **_about(field)}


def _type(first_bit: int, bits: int, signed: bool = False) -> str:
    """Type of a raw number: of whole bytes if it has a type for them, otherwise bits without sign."""
    if first_bit % 8 == 0 and bits in _WHOLE_BYTES:
        return f"{'s' if signed else 'u'}{bits // 8}"
    return f"b{bits}"


def _is_as_read(codec: Number) -> bool:
    """Whether the raw number is the value, and there always is one."""
    return codec.is_full and codec.whole and not codec.offset


def _scaled(codec: Number, raw: str) -> str:
    if not codec.whole:
        return f"{raw} / {_real_text(codec.steps_per_unit)}"
    return f"({raw}.as<s8> + {codec.offset}).as<s8>" if codec.offset else raw


def _in_range(codec: Number, raw: str) -> str:
    """Condition on the raw number; empty if every number is a value."""
    least = -(1 << codec.bits - 1) if codec.signed else 0
    most = least + (1 << codec.bits) - 1
    conditions = []
    if codec.lowest > least:
        conditions.append(f"{raw} >= {_whole_text(codec.lowest, codec.signed)}")
    if codec.highest < most:
        conditions.append(f"{raw} <= {_whole_text(codec.highest, codec.signed)}")
    return " and ".join(conditions)


def _whole_text(number: int, signed: bool) -> str:
    """A limit; the compiler would write one of 32 bits as unsigned, and C++ compare without sign."""
    return f"({number}).as<s8>" if signed and number >= 1 << 31 else str(number)


def _real_text(number: float) -> str:
    """A number with a decimal point, also where Python writes none."""
    text = repr(number)
    return text if "." in text else text.replace("e", ".0e")


def _about(field: Field) -> Type:
    """Meaning and unit."""
    about: Type = {}
    if field.meaning:
        about["doc"] = plain_text(field.meaning)
    if field.unit:
        about["-unit"] = plain_text(field.unit)
    return about
