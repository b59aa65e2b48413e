"""Generate structs of blocks of fields in C, and functions that fill them."""

from __future__ import annotations

from importlib.resources import files

from lidar_protocol.fields import Constant, Counter, Field, Flag, Number, Real, Time
from lidar_protocol.layout import Layout, PlacedField


def shipped_text(name: str) -> str:
    """Text of a C file of this package."""
    return (files("lidar_icd.c") / name).read_text(encoding="utf-8").rstrip()


def comment_text(text: str) -> str:
    """Escape a text for a comment."""
    return text.replace("*/", "* /")


def block_text(name: str, layout: Layout) -> str:
    """Struct of the values of a block, and the function that fills it."""
    members = "\n".join(f"    {line}" for placed in layout.placed for line in _members(placed.field))
    sets = "\n".join(f"    {line}" for placed in layout.placed for line in _assignments(placed))
    return f"""#define LIDAR_{name.upper()}_BYTES {layout.length}u

typedef struct {{
{members}
}} lidar_{name};

static inline void lidar_unpack_{name}(const uint8_t *block, lidar_{name} *to) {{
{sets}
}}"""


def _members(field: Field) -> list[str]:
    comment = f" /* {comment_text(field.unit)} */" if field.unit else ""
    lines = [f"{c_type(field)} {field.key};{comment}"]
    if _may_be_missing(field):
        lines.append(f"bool has_{field.key};")
    return lines


def c_type(field: Field) -> str:
    """C type of a field's value."""
    match field.codec:
        case Flag():
            return "bool"
        case Time():
            return "int64_t"
        case Number(whole=False) | Real(bits=32):
            return "lidar_real"
        case Real():
            return "double"
        case Number(whole=True):
            return "int64_t" if field.codec.signed or field.codec.offset else "uint64_t"
    return "uint64_t"


def _may_be_missing(field: Field) -> bool:
    codec = field.codec
    return isinstance(codec, Real) or (isinstance(codec, Number) and not codec.is_full)


def _assignments(placed: PlacedField) -> list[str]:
    field, bit = placed
    codec, to = field.codec, f"to->{field.key}"
    bits = f"lidar_bits(block, {bit}u, {codec.bits}u)"
    match codec:
        case Flag():
            return [f"{to} = {bits} != 0u;"]
        case Time():
            return [f"{to} = lidar_nanoseconds({bits});"]
        case Counter() | Constant():
            return [f"{to} = {bits};"]
        case Real():
            return _real(field, codec, bits)
        case Number():
            return _number(field, codec, bits)
    raise AssertionError(codec)


def _real(field: Field, codec: Real, bits: str) -> list[str]:
    to, low, high = f"to->{field.key}", *codec.limits
    call = f"lidar_float((uint32_t){bits})" if codec.bits == 32 else f"lidar_double({bits})"
    value = f"(double){to}" if codec.bits == 32 else to
    return [f"{to} = {call};", f"to->has_{field.key} = {value} >= {low!r} && {value} <= {high!r};"]


def _number(field: Field, codec: Number, bits: str) -> list[str]:
    to = f"to->{field.key}"
    kind, suffix = ("int64_t", "") if codec.signed else ("uint64_t", "u")
    raw = f"lidar_signed({bits}, {codec.bits}u)" if codec.signed else bits
    if codec.whole:
        value = f"(int64_t)raw + {codec.offset}" if codec.offset else "raw"
    else:
        value = f"(lidar_real)raw / (lidar_real){codec.steps_per_unit!r}"
    lines = [f"{{ const {kind} raw = {raw};"]
    if _may_be_missing(field):
        low = f"raw >= {_literal(codec.lowest, suffix)}"
        high = f"raw <= {_literal(codec.highest, suffix)}"
        in_range = high if not codec.signed and codec.lowest == 0 else f"{low} && {high}"
        lines.append(f"  to->has_{field.key} = {in_range};")
    return [*lines, f"  {to} = {value}; }}"]


def _literal(value: int, suffix: str) -> str:
    if value == -(2**63):
        return "INT64_MIN"
    return f"{value}{suffix.upper()}LL"
