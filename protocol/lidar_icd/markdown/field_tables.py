"""Tables of fields, values and bytes for the interface document."""

from __future__ import annotations

from lidar_icd.can_database import decimal_text
from lidar_protocol.fields import Codec, Constant, Flag, Number, Real, Time, Value
from lidar_protocol.layout import Layout, PlacedField

_HEX_BYTES_PER_LINE = 28


def field_table(layout: Layout, first_byte: int = 0) -> str:
    """Table of the fields of a block, whose bytes are counted from `first_byte`."""
    heading = [
        "| byte | bits | type | name | step | range | none | meaning |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(heading + [_row(placed, layout, first_byte) for placed in layout.placed])


def _row(placed: PlacedField, layout: Layout, first_byte: int) -> str:
    field, codec = placed.field, placed.field.codec
    first, last = placed.first_bit, placed.first_bit + codec.bits - 1
    down = 7 if layout.byte_order == "big" else 0
    meaning = field.meaning if field.beam is None else f"Beam {field.beam}: {field.meaning}"
    cells = (
        f"{first_byte + first // 8}" + (f"-{first_byte + last // 8}" if last // 8 > first // 8 else ""),
        f"{abs(down - first % 8)}" + (f"-{abs(down - last % 8)}" if last > first else ""),
        type_name(codec),
        f"`{field.key}`",
        *_number_cells(codec, field.unit),
        f"{meaning} (section 3, {field.enumeration})" if field.enumeration else meaning,
    )
    return f"| {' | '.join(cells)} |"


def type_name(codec: Codec) -> str:
    """Type of a field, as in the definition."""
    if isinstance(codec, Flag):
        return "bool"
    if isinstance(codec, Time):
        return "cuc"
    if isinstance(codec, Real):
        return f"f{codec.bits}"
    return f"{'i' if codec.signed else 'u'}{codec.bits}"


def _number_cells(codec: Codec, unit: str) -> tuple[str, str, str]:
    if isinstance(codec, Constant):
        return "", f"always 0x{codec.code:X}", ""
    if isinstance(codec, Real):
        limits = f"{codec.lowest:g} to {codec.highest:g}" if abs(codec.highest) < 1e38 else ""
        return unit, f"{limits}, held" if codec.nearest else limits, "NaN"
    if not isinstance(codec, Number):
        return "", "", ""
    step = "1" if codec.whole else f"{decimal_text(1 / codec.steps_per_unit)} {unit}"
    low, high = (decimal_text(limit) for limit in codec.limits)
    codes = [] if codec.none is None else [_hex_code(codec, codec.none)]
    if codec.absent is not None:
        codes.append(f"absent {_hex_code(codec, codec.absent)}")
    return (
        f"{step}, offset {codec.offset}" if codec.offset else step,
        f"{low} to {high}, held" if codec.nearest else f"{low} to {high}",
        ", ".join(codes),
    )


def _hex_code(codec: Number, code: int) -> str:
    return f"`0x{code % (1 << codec.bits):0{(codec.bits + 3) // 4}X}`"


def shown(value: Value) -> str:
    """Format a value of the example."""
    if value is None:
        return "none"
    return str(int(value)) if isinstance(value, bool) else str(value)


def hex_block(data: bytes) -> str:
    """Code block of bytes in hexadecimal."""
    step = _HEX_BYTES_PER_LINE
    return code_block([data[start : start + step].hex(" ") for start in range(0, len(data), step)])


def code_block(lines: list[str]) -> str:
    """Code block of lines."""
    return "\n".join(["```text", *lines, "```"])
