"""The CAN messages as a DBC file."""

from __future__ import annotations

from decimal import Decimal

from lidar_protocol import cuc
from lidar_protocol.definitions import CanMessage, Interface
from lidar_protocol.fields import Field, Number, Time
from lidar_protocol.layout import Placed

_SENDER, _RECEIVER = "LIDAR", "HOST"
_FRAME_FORMATS = ["StandardCAN", "ExtendedCAN", *["reserved"] * 12, "StandardCAN_FD", "ExtendedCAN_FD"]
_CLASSIC, _FD = _FRAME_FORMATS.index("StandardCAN"), _FRAME_FORMATS.index("StandardCAN_FD")
_SECONDS_BITS = cuc.BITS - cuc.FRACTION_BITS


def dbc(interface: Interface) -> str:
    """The messages of unit 0 as a DBC file; the identifiers of unit n are n times the stride higher."""
    messages = _numbered_messages(interface)
    fields = [(can_id, field) for can_id, _, message in messages for field, _ in message.layout.placed]
    formats = ",".join(f'"{name}"' for name in _FRAME_FORMATS)
    lines = [
        f'VERSION "{interface.version}"\n\nNS_ :\n\nBS_:\n\nBU_: {_SENDER} {_RECEIVER}\n',
        *(_message(can_id, name, message) for can_id, name, message in messages),
        f"CM_ {_quoted(_comment(interface))};",
        *(comment for can_id, field in fields for comment in _signal_comments(can_id, field)),
        f'\nBA_DEF_ BO_ "VFrameFormat" ENUM {formats};',
        'BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";',
        'BA_DEF_ "BusType" STRING ;',
        'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";',
        'BA_DEF_DEF_ "CANFD_BRS" "0";',
        'BA_DEF_DEF_ "BusType" "CAN";',
        'BA_ "BusType" "CAN FD";',
        *(
            f'BA_ "VFrameFormat" BO_ {can_id} {_FD if message.is_fd else _CLASSIC};'
            for can_id, _, message in messages
        ),
        *(f'BA_ "CANFD_BRS" BO_ {can_id} 1;' for can_id, _, message in messages if message.is_fd),
        "",
        *(table for can_id, field in fields for table in _value_tables(interface, can_id, field)),
    ]
    return "\n".join(lines) + "\n"


def decimal_text(value: float) -> str:
    """The text of a number to twelve digits, without an exponent or trailing zeros."""
    return f"{Decimal(f'{value:.12g}'):f}"


def _numbered_messages(interface: Interface) -> list[tuple[int, str, CanMessage]]:
    """Identifier and name of every message of unit 0, one for each slot."""
    can = interface.can
    return [
        (
            can.can_id(0, message, slot),
            _camel_case(message.name) + (str(slot) if message.each_beam else ""),
            message,
        )
        for message in can.messages
        for slot in range(can.beam_slots if message.each_beam else 1)
    ]


def _camel_case(name: str) -> str:
    return name.title().replace("_", "")


def _comment(interface: Interface) -> str:
    return (
        f"Interface {interface.name}, version {interface.version}. Identifiers of unit 0; those of unit n "
        f"are n * {interface.can.unit_stride:#x} higher, n up to {interface.units - 1}. "
        f"Epoch: {interface.epoch}."
    )


def _message(can_id: int, name: str, message: CanMessage) -> str:
    lines = [f"BO_ {can_id} {name}: {message.layout.length} {_SENDER}"]
    lines += [signal for placed in message.layout.placed for signal in _signals(placed)]
    return "\n".join(lines) + "\n"


def _signal_names(field: Field) -> list[str]:
    """One signal for each field, but two for a time code: its 56 bits are more than a double holds."""
    if not isinstance(field.codec, Time):
        return [field.name]
    stem = field.name.removesuffix("_ns")
    return [f"{stem}_seconds", f"{stem}_fraction"]


def _signals(placed: Placed) -> list[str]:
    (field, bit), names = placed, _signal_names(placed.field)
    codec = field.codec
    if isinstance(codec, Time):
        step = 2.0**-cuc.FRACTION_BITS
        whole = _signal(names[0], bit, _SECONDS_BITS, "+ (1,0)", f"[0|{2**_SECONDS_BITS - 1}]", "s")
        bit += _SECONDS_BITS
        return [whole, _signal(names[1], bit, cuc.FRACTION_BITS, f"+ ({step!r},0)", f"[0|{1 - step!r}]", "s")]
    if isinstance(codec, Number):
        low, high = (decimal_text(limit) for limit in codec.limits)
        scaling = f"{'-' if codec.signed else '+'} ({decimal_text(1 / codec.steps_per_unit)},{codec.offset})"
        return [_signal(names[0], bit, codec.bits, scaling, f"[{low}|{high}]", field.unit)]
    return [_signal(names[0], bit, codec.bits, "+ (1,0)", f"[0|{2**codec.bits - 1}]", "")]


def _signal(name: str, bit: int, bits: int, scaling: str, limits: str, unit: str) -> str:
    """A big-endian signal; DBC numbers the bits of a byte from its least significant one."""
    start = bit // 8 * 8 + 7 - bit % 8
    return f' SG_ {name} : {start}|{bits}@0{scaling} {limits} "{unit}" {_RECEIVER}'


def _signal_comments(can_id: int, field: Field) -> list[str]:
    return [f"CM_ SG_ {can_id} {name} {_quoted(field.meaning)};" for name in _signal_names(field)]


def _value_tables(interface: Interface, can_id: int, field: Field) -> list[str]:
    """The names of a field's values and codes, where it has any."""
    words = interface.enumerations[field.enumeration] if field.enumeration else {}
    names: dict[int | None, str] = {value: word for word, value in words.items()}
    if isinstance(field.codec, Number):
        names |= {field.codec.none: "none", field.codec.absent: "absent"}
    pairs = " ".join(f'{value} "{name}"' for value, name in names.items() if value is not None)
    return [f"VAL_ {can_id} {field.name} {pairs} ;"] if pairs else []


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "'") + '"'
