"""XML elements, data types and parameter types of an XTCE database."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from typing import Literal

from lidar_protocol.definitions import Interface
from lidar_protocol.fields import FRACTION_BITS, NS_PER_S, Field, Flag, Number, Real, Time

Element = ElementTree.Element

NAMESPACE = "http://www.omg.org/spec/XTCE/20180204"

_UNFIT = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that no XML document may hold, not even escaped."""


def add(parent: Element, tag: str, **attributes: object) -> Element:
    """Add an element; attributes of None are left out."""
    given = {name: _text(value) for name, value in attributes.items() if value is not None}
    return ElementTree.SubElement(parent, tag, given)


def add_text(parent: Element, tag: str, text: str) -> None:
    """Add an element that holds a text."""
    add(parent, tag).text = _text(text)


def compare(parent: Element, parameter: str, operator: str, value: float) -> Element:
    """Add a comparison of a parameter's raw value with a number."""
    comparison = {"parameterRef": parameter, "comparisonOperator": operator, "value": value}
    return add(parent, "Comparison", **comparison, useCalibratedValue=False)


def written(root: Element) -> str:
    """Write a document, indented."""
    ElementTree.indent(root)
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ElementTree.tostring(root, encoding='unicode')}\n"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return _UNFIT.sub("\ufffd", str(value))


NS_PER_TICK = NS_PER_S / (1 << FRACTION_BITS)
"""Exact, as a binary fraction."""

_MOST_LONG = (1 << 63) - 1


def add_typed(types: Element, tag: str, name: str, field: Field, **attributes: object) -> Element:
    """Add a type with the unit of a field."""
    element = add(types, tag, name=name, **attributes)
    units = add(element, "UnitSet")
    if field.unit:
        add_text(units, "Unit", field.unit)
    return element


def add_encoding(parent: Element, bits: int, signed: bool = False) -> Element:
    """Add the encoding of a whole number, the most significant bit first."""
    encoding = "twosComplement" if signed else "unsigned"
    return add(parent, "IntegerDataEncoding", sizeInBits=bits, encoding=encoding)


def add_scale(encoding: Element, offset: float, factor: float) -> None:
    """Add the calibrator offset + factor * number."""
    polynomial = add(add(encoding, "DefaultCalibrator"), "PolynomialCalibrator")
    for exponent, coefficient in enumerate((offset, factor)):
        add(polynomial, "Term", coefficient=number_text(coefficient), exponent=exponent)


def add_range(element: Element, limits: tuple[float, float]) -> None:
    """Add the range of valid values to a type, unless the schema cannot state it: limits of integers are xs:long."""
    low, high = limits
    if element.tag.startswith("Integer") and high > _MOST_LONG:
        return
    if element.tag.endswith("ArgumentType"):
        element = add(element, "ValidRangeSet")
    add(element, "ValidRange", minInclusive=low, maxInclusive=high)


def number_text(value: float) -> str:
    """A number as XML Schema writes it."""
    return "NaN" if value != value else repr(value)


_EXACT_BITS = 51
"""Bits of raw values between which a double still holds halves and quarters."""

_MOST_CODES = 256
"""Codes of an enumeration that is written whole: readers may refuse a code without a word."""


def add_parameter_type(types: Element, interface: Interface, field: Field, name: str) -> None:
    """Add a type for a field."""
    codec = field.codec
    words = interface.enumerations.get(field.enumeration or "")
    match codec:
        case Flag() | Real():
            add_flag_or_real(types, "Parameter", name, field)
        case Time():  # from the ticks of the time code; the raw value is exact
            time = add_typed(types, "FloatParameterType", name, field, sizeInBits=64)
            add_scale(add_encoding(time, codec.bits), 0, NS_PER_TICK)
        case _ if words and 1 << codec.bits <= _MOST_CODES:
            _add_words(types, name, field, words)
        case Number():
            _add_number(types, name, field, codec)
        case _:
            add_whole_type(types, name, codec.bits)


def add_whole_type(types: Element, name: str, bits: int) -> None:
    """Add a type of whole numbers without sign."""
    whole = add(types, "IntegerParameterType", name=name, signed=False, sizeInBits=bits)
    add(whole, "UnitSet")
    add_encoding(whole, bits)


def add_flag_or_real(types: Element, of: Literal["Parameter", "Argument"], name: str, field: Field) -> None:
    """Add the type of a flag or of a floating-point number."""
    codec = field.codec
    if isinstance(codec, Real):
        real = add_typed(types, f"Float{of}Type", name, field, sizeInBits=codec.bits)
        add(real, "FloatDataEncoding", sizeInBits=codec.bits, encoding="IEEE754_1985")
        add_range(real, codec.limits)
    else:
        add_encoding(add_typed(types, f"Boolean{of}Type", name, field), 1)


def _add_words(types: Element, name: str, field: Field, words: Mapping[str, int]) -> None:
    of_codes = {code: word for word, code in words.items()}
    enumerated = add_typed(types, "EnumeratedParameterType", name, field)
    add_encoding(enumerated, field.codec.bits)
    entries = add(enumerated, "EnumerationList")
    for code in range(1 << field.codec.bits):
        add(entries, "Enumeration", value=code, label=of_codes.get(code, f"code_{code}"))


def _add_number(types: Element, name: str, field: Field, codec: Number) -> None:
    has_code = codec.none is not None or codec.absent is not None
    if codec.whole and not has_code:
        number = add_typed(types, "IntegerParameterType", name, field, sizeInBits=64, signed=codec.signed)
    else:
        number = add_typed(types, "FloatParameterType", name, field, sizeInBits=64)
    encoding = add_encoding(number, codec.bits, codec.signed)
    if has_code and codec.bits <= _EXACT_BITS:
        _add_scale_in_range(encoding, codec)
    elif not codec.whole or codec.offset:
        add_scale(encoding, codec.offset, 1 / codec.steps_per_unit)
    if not codec.is_full:
        add_range(number, codec.limits)


def _add_scale_in_range(encoding: Element, codec: Number) -> None:
    """Add a calibrator that makes raw values out of range, such as the code for no value, NaN.

    Readers ignore the range of valid values. A calibrator with a condition on the raw value is no way: some compare
    the value in the packet before. So this one interpolates between points, and they are NaN out of range. Those at 0
    and at powers of two keep the values between them exact to the rounding of the largest. The last one lies beyond
    all raw values, because a reader fails at the last point itself.
    """
    spline = add(add(encoding, "DefaultCalibrator"), "SplineCalibrator", order=1)
    for raw, calibrated in _points(codec):
        add(spline, "SplinePoint", raw=repr(raw), calibrated=number_text(calibrated))


def _points(codec: Number) -> Iterator[tuple[float, float]]:
    """Raw values and values in the unit, between which readers interpolate."""
    half = 1 << codec.bits - (2 if codec.signed else 1)
    least = -2 * half if codec.signed else 0
    most = least + (1 << codec.bits) - 1
    low = codec.lowest - (0.25 if codec.lowest > least else 0.0)
    high = codec.highest + (0.25 if codec.highest < most else 1.0)
    if codec.lowest > least:
        yield from ((float(least), math.nan), (codec.lowest - 0.5, math.nan))
    for raw in (low, *(float(each) for each in (-half, 0, half) if low < each < high), high):
        yield raw, raw / codec.steps_per_unit + codec.offset
    if codec.highest < most:
        yield from ((codec.highest + 0.5, math.nan), (most + 1.0, math.nan))
