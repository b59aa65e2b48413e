"""Parts of parameter and argument types: units, encodings and calibrators."""

from __future__ import annotations

from lidar_icd.xtce.elements import Element, add, add_text
from lidar_protocol import cuc
from lidar_protocol.fields import Field

NS_PER_TICK = cuc.NS_PER_S / (1 << cuc.FRACTION_BITS)
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


def add_float_encoding(parent: Element, bits: int) -> None:
    """Add the encoding of a floating-point number."""
    add(parent, "FloatDataEncoding", sizeInBits=bits, encoding="IEEE754_1985")


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
