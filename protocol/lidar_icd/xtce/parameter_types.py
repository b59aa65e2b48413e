"""Parameter types of XTCE: how a field of telemetry is decoded."""

from __future__ import annotations

from collections.abc import Mapping

from lidar_icd.xtce.data_types import (
    NS_PER_TICK,
    add_encoding,
    add_float_encoding,
    add_polynomial,
    add_scale,
    add_typed,
)
from lidar_icd.xtce.elements import Element, add, compare
from lidar_protocol import cuc
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Field, Flag, Number, Real, Time

_MOST_CODES = 256
"""Codes of an enumeration that is written whole: readers may refuse a code without a word."""


def add_parameter_type(types: Element, interface: Interface, field: Field, name: str, parameter: str) -> None:
    """Add a type for a field, which `parameter` is going to have."""
    codec = field.codec
    words = interface.enumerations.get(field.enumeration or "")
    match codec:
        case Flag():
            add_encoding(add_typed(types, "BooleanParameterType", name, field), 1)
        case Real():
            _add_real(types, name, field, codec)
        case Time():
            _add_time(types, name, field)
        case _ if words and 1 << codec.bits <= _MOST_CODES:
            _add_words(types, name, field, words)
        case Number():
            _add_number(types, name, field, codec, parameter)
        case _:
            add_whole_type(types, name, codec.bits, field.meaning)


def names_its_parameter(field: Field) -> bool:
    """Whether the type of a field can belong to one parameter only, because its calibrator compares that."""
    return isinstance(field.codec, Number) and bool(_codes(field.codec))


def add_whole_type(types: Element, name: str, bits: int, meaning: str = "") -> None:
    """Add a type of whole numbers without sign."""
    attributes = {"signed": False, "sizeInBits": bits, "shortDescription": meaning or None}
    whole = add(types, "IntegerParameterType", name=name, **attributes)
    add(whole, "UnitSet")
    add_encoding(whole, bits)


def _add_real(types: Element, name: str, field: Field, codec: Real) -> None:
    real = add_typed(types, "FloatParameterType", name, field, sizeInBits=codec.bits)
    add_float_encoding(real, codec.bits)
    _add_range(real, codec.limits)


def _add_time(types: Element, name: str, field: Field) -> None:
    """Nanoseconds, from the ticks of the time code; the raw value is exact."""
    time = add_typed(types, "FloatParameterType", name, field, sizeInBits=64)
    add_scale(add_encoding(time, cuc.BITS), 0, NS_PER_TICK)


def _add_words(types: Element, name: str, field: Field, words: Mapping[str, int]) -> None:
    of_codes = {code: word for word, code in words.items()}
    enumerated = add_typed(types, "EnumeratedParameterType", name, field)
    add_encoding(enumerated, field.codec.bits)
    entries = add(enumerated, "EnumerationList")
    for code in range(1 << field.codec.bits):
        add(entries, "Enumeration", value=code, label=of_codes.get(code, f"code_{code}"))


def _add_number(types: Element, name: str, field: Field, codec: Number, parameter: str) -> None:
    codes = _codes(codec)
    if codec.whole and not codes:
        number = add_typed(types, "IntegerParameterType", name, field, sizeInBits=64, signed=codec.signed)
    else:
        number = add_typed(types, "FloatParameterType", name, field, sizeInBits=64)
    encoding = add_encoding(number, codec.bits, codec.signed)
    if not codec.whole or codec.offset:
        add_scale(encoding, codec.offset, 1 / codec.steps_per_unit)
    if codes:
        contexts = add(encoding, "ContextCalibratorList")
        for code in codes:
            _add_no_value(contexts, parameter, code)
    if not codec.is_full:
        _add_range(number, codec.limits)


def _codes(codec: Number) -> list[int]:
    """Raw values that stand for no value."""
    return [code for code in (codec.none, codec.absent) if code is not None]


def _add_no_value(contexts: Element, parameter: str, code: int) -> None:
    """Make a code NaN: readers ignore the range of valid values.

    The comparison is for equality. Yamcs reads unsigned 32-bit numbers as signed ones here, so that for a code of
    0xFFFFFFFF "greater than the greatest value" would hold for all of them.
    """
    context = add(contexts, "ContextCalibrator")
    compare(add(context, "ContextMatch"), parameter, "==", code)
    add_polynomial(add(context, "Calibrator"), float("nan"))


def _add_range(parameter_type: Element, limits: tuple[float, float]) -> None:
    low, high = limits
    add(parameter_type, "ValidRange", minInclusive=low, maxInclusive=high)
