"""Generate the DBC file of the CAN messages."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from typing import NamedTuple

from lidar_protocol.can_frames import definition
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import FRACTION_BITS, Field, Number, Real, Time
from lidar_protocol.layout import Layout, PlacedField

_DEVICE, _HOST = "LIDAR", "HOST"
_FRAME_FORMATS = ["StandardCAN", "ExtendedCAN", *["reserved"] * 12, "StandardCAN_FD", "ExtendedCAN_FD"]
_CLASSIC, _FD = _FRAME_FORMATS.index("StandardCAN"), _FRAME_FORMATS.index("StandardCAN_FD")
_SECONDS_BITS = Time.bits - FRACTION_BITS


class _Entry(NamedTuple):
    can_id: int
    name: str
    layout: Layout
    is_fd: bool = False
    sender: str = _DEVICE


def dbc(interface: Interface) -> str:
    """Generate the DBC file of unit 0; the identifiers of unit n are n times the stride higher.

    Raises:
        EncodeError: the interface has no messages on CAN.
    """
    entries = list(_entries(interface))
    fields = [(entry, placed.field) for entry in entries for placed in entry.layout.placed]
    formats = ",".join(f'"{name}"' for name in _FRAME_FORMATS)
    any_fd = any(entry.is_fd for entry in entries)
    comment = (
        f"Interface {interface.name}, version {interface.version}. Identifiers of unit 0; identifiers of unit n "
        f"are n * {definition(interface).unit_stride:#x} higher, n up to {interface.units - 1}. "
        f"Epoch: {interface.epoch}."
    )
    lines = [
        f'VERSION "{interface.version}"\n\nNS_ :\n\nBS_:\n\nBU_: {_DEVICE} {_HOST}\n',
        *(_message(entry, interface) for entry in entries),
        f"CM_ {_quoted(comment)};",
        *(
            f"CM_ SG_ {entry.can_id} {name} {_quoted(field.meaning)};"
            for entry, field in fields
            for name in _signal_names(field)
        ),
        f'\nBA_DEF_ BO_ "VFrameFormat" ENUM {formats};',
        'BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";',
        'BA_DEF_ "BusType" STRING ;',
        'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";',
        'BA_DEF_DEF_ "CANFD_BRS" "0";',
        'BA_DEF_DEF_ "BusType" "CAN";',
        f'BA_ "BusType" "{"CAN FD" if any_fd else "CAN"}";',
        *(f'BA_ "VFrameFormat" BO_ {each.can_id} {_FD if each.is_fd else _CLASSIC};' for each in entries),
        *(f'BA_ "CANFD_BRS" BO_ {each.can_id} 1;' for each in entries if each.is_fd),
        "",
        *(table for entry, field in fields for table in _value_tables(interface, entry, field)),
        *(
            f"SIG_VALTYPE_ {entry.can_id} {field.key} : {1 if field.codec.bits == 32 else 2};"
            for entry, field in fields
            if isinstance(field.codec, Real)
        ),
    ]
    return "\n".join(lines) + "\n"


def decimal_text(value: float) -> str:
    """Format a number with twelve digits, without an exponent or trailing zeros."""
    if isinstance(value, int):
        return str(value)
    return f"{Decimal(f'{value:.12g}'):f}"


def _entries(interface: Interface) -> Iterator[_Entry]:
    can = definition(interface)
    for message in can.messages:
        for slot in range(can.beam_slots if message.each_beam else 1):
            name = _camel_case(message.name) + (str(slot) if message.each_beam else "")
            yield _Entry(can.can_id(0, message, slot), name, message.layout, message.is_fd)
    for command in interface.commands.commands if interface.commands else ():
        if command.can is not None and command.can_id is not None:
            name = f"Command{_camel_case(command.name)}"
            yield _Entry(can.id_base + command.can_id, name, command.can, sender=_HOST)
    for host_message in interface.commands.messages if interface.commands else ():
        for part in host_message.can_parts:
            yield _Entry(can.can_id(0, part), _camel_case(part.name), part.layout, sender=_HOST)
    for block in can.blocks:
        yield _Entry(can.can_id(0, block), _camel_case(block.name), block.layout)


def _camel_case(name: str) -> str:
    return name.title().replace("_", "")


def _message(entry: _Entry, interface: Interface) -> str:
    receiver = _HOST if entry.sender == _DEVICE else _DEVICE
    order = "1" if interface.byte_order == "little" else "0"
    lines = [f"BO_ {entry.can_id} {entry.name}: {entry.layout.length} {entry.sender}"]
    for placed in entry.layout.placed:
        for name, bit, bits, scaling, limits, unit in _signals(placed, order == "1"):
            # DBC counts the bits of a byte from the least significant one.
            start = bit if order == "1" else bit // 8 * 8 + 7 - bit % 8
            sign, numbers = scaling[0], scaling[1:]
            lines.append(f' SG_ {name} : {start}|{bits}@{order}{sign} {numbers} {limits} "{unit}" {receiver}')
    return "\n".join(lines) + "\n"


def _signal_names(field: Field) -> list[str]:
    """Names of the signals of a field: two for a time code, whose 56 bits exceed the precision of a double."""
    if not isinstance(field.codec, Time):
        return [field.key]
    stem = field.name.removesuffix("_ns")
    return [f"{stem}_seconds", f"{stem}_fraction"]


_Signal = tuple[str, int, int, str, str, str]
"""Name, first bit, bits, sign and scaling, limits, unit."""


def _signals(placed: PlacedField, little: bool) -> list[_Signal]:
    (field, bit), names, codec = placed, _signal_names(placed.field), placed.field.codec
    if isinstance(codec, Time):
        step, parts = 2.0**-FRACTION_BITS, (_SECONDS_BITS, FRACTION_BITS)
        whole_at, fraction_at = (bit + parts[1], bit) if little else (bit, bit + parts[0])
        return [
            (names[0], whole_at, parts[0], "+(1,0)", f"[0|{2 ** parts[0] - 1}]", "s"),
            (names[1], fraction_at, parts[1], f"+({step!r},0)", f"[0|{1 - step!r}]", "s"),
        ]
    if isinstance(codec, Number):
        low, high = (decimal_text(limit) for limit in codec.limits)
        scaling = f"{'-' if codec.signed else '+'}({decimal_text(1 / codec.steps_per_unit)},{codec.offset})"
        return [(names[0], bit, codec.bits, scaling, f"[{low}|{high}]", field.unit)]
    if isinstance(codec, Real):
        return [(names[0], bit, codec.bits, "-(1,0)", f"[{codec.lowest!r}|{codec.highest!r}]", field.unit)]
    return [(names[0], bit, codec.bits, "+(1,0)", f"[0|{2**codec.bits - 1}]", "")]


def _value_tables(interface: Interface, entry: _Entry, field: Field) -> list[str]:
    words = interface.enumerations[field.enumeration] if field.enumeration else {}
    names: dict[int | None, str] = {value: word for word, value in words.items()}
    if isinstance(field.codec, Number):
        names |= {field.codec.none: "none", field.codec.absent: "absent"}
    pairs = " ".join(f"{value} {_quoted(name)}" for value, name in names.items() if value is not None)
    return [f"VAL_ {entry.can_id} {field.key} {pairs} ;"] if pairs else []


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "'") + '"'
