"""The interface as documents for the other side, as text: INTERFACE.md, and the DBC file (from `dbc`)."""

from __future__ import annotations

from importlib.resources import files
from string import Template

from lidar_protocol import ccsds, cobs, example, packet
from lidar_protocol.dbc import dbc, decimal_text
from lidar_protocol.definitions import CanMessage, CanSet, Interface
from lidar_protocol.device import Device
from lidar_protocol.fields import Codec, Flag, Number, Time, Value
from lidar_protocol.layout import Layout, Placed

__all__ = ["dbc", "interface_markdown"]

_HEX_BYTES_PER_LINE = 28


def interface_markdown(interface: Interface) -> str:
    """All that is needed to write a decoder for the interface without this package."""
    template = files("lidar_protocol") / "interface_template.md"
    values = _general(interface) | _packet(interface) | _can(interface) | _example(interface)
    return Template(template.read_text(encoding="utf-8")).substitute(values)


def _general(interface: Interface) -> dict[str, object]:
    return {
        "name": interface.name,
        "version": interface.version,
        "epoch": interface.epoch,
        "last_unit": interface.units - 1,
        "enumerations": "\n".join(
            f"| {name} | " + ", ".join(f"{value} {word}" for word, value in words.items()) + " |"
            for name, words in interface.enumerations.items()
        ),
    }


def _packet(interface: Interface) -> dict[str, object]:
    definition = interface.packet
    first = ccsds.PRIMARY_HEADER_BYTES + definition.header.length
    step = definition.beam.length
    return {
        "empty_bytes": first + ccsds.CRC_BYTES,
        "beam_bytes": step,
        "four_beam_bytes": first + 4 * step + ccsds.CRC_BYTES,
        "first_beam_byte": first,
        "maximum_beams": definition.maximum_beams,
        "apid": f"{definition.apid:#05x}",
        "last_apid": f"{definition.apid + interface.units - 1:#05x}",
        "header_table": _table(definition.header, ccsds.PRIMARY_HEADER_BYTES),
        "beam_table": _table(definition.beam, 0),
        "longest_frame": cobs.stuffed_length(interface.maximum_packet_bytes),
    }


def _can(interface: Interface) -> dict[str, object]:
    can = interface.can
    tables = [f"### `{each.name}`\n\n{_note(each)}{_table(each.layout, 0)}" for each in can.messages]
    return {
        "unit_stride": f"{can.unit_stride:#x}",
        "beam_slots": can.beam_slots,
        "can_messages": "\n".join(_can_row(interface, message) for message in can.messages),
        "can_tables": "\n\n".join(tables),
    }


def _can_row(interface: Interface, message: CanMessage) -> str:
    first = interface.can.can_id(0, message)
    last = first + interface.can.beam_slots - 1
    ids = f"{first:#05x} to {last:#05x}" if message.each_beam else f"{first:#05x}"
    return f"| `{message.name}` | {ids} | {message.layout.length} | {', '.join(sorted(message.sets))} |"


def _note(message: CanMessage) -> str:
    if message.absent_unless is None:
        return ""
    flag, block = message.absent_unless, message.layout.absent.hex(" ")
    return (
        f"A beam whose `{flag}` is false is sent as absent: `{block}` with the counter in the first\n"
        f"four bits. Any other content means that `{flag}` is true.\n\n"
    )


def _table(layout: Layout, first_byte: int) -> str:
    heading = [
        "| byte | bits | type | name | step | range | none | meaning |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(heading + [_row(placed, first_byte) for placed in layout.placed])


def _row(placed: Placed, first_byte: int) -> str:
    field, codec = placed.field, placed.field.codec
    first, last = placed.first_bit, placed.first_bit + codec.bits - 1
    cells = (
        f"{first_byte + first // 8}" + (f"-{first_byte + last // 8}" if last // 8 > first // 8 else ""),
        f"{7 - first % 8}" + (f"-{7 - last % 8}" if last > first else ""),
        _type_name(codec),
        f"`{field.name}`",
        *(_number_cells(codec, field.unit) if isinstance(codec, Number) else ("", "", "")),
        f"{field.meaning} (section 3, {field.enumeration})" if field.enumeration else field.meaning,
    )
    return f"| {' | '.join(cells)} |"


def _type_name(codec: Codec) -> str:
    if isinstance(codec, Flag):
        return "bool"
    if isinstance(codec, Time):
        return "cuc"
    return f"{'i' if isinstance(codec, Number) and codec.signed else 'u'}{codec.bits}"


def _number_cells(codec: Number, unit: str) -> tuple[str, str, str]:
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


def _example(interface: Interface) -> dict[str, object]:
    device = Device(interface, example.UNIT)
    plain = packet.encode(interface, example.UNIT, example.HEADER, example.BEAMS)
    shot = packet.decode(interface, plain)
    beam_rows = ([f"`{name}`", *(_shown(beam[name]) for beam in shot.beams)] for name in shot.beams[0])
    return {
        "example_unit": example.UNIT,
        "example_header": "\n".join(f"| `{name}` | {_shown(value)} |" for name, value in shot.header.items()),
        "example_beams": "\n".join(f"| {' | '.join(cells)} |" for cells in beam_rows),
        "example_packet": _hex_block(plain),
        "example_frame": _hex_block(device.serial_bytes(example.HEADER, example.BEAMS)),
        "example_core": _can_block(device, "core"),
        "example_full": _can_block(device, "full"),
        "example_fd": _can_block(device, "fd"),
    }


def _can_block(device: Device, can_set: CanSet) -> str:
    frames = device.can_frames(can_set, example.HEADER, example.BEAMS)
    return _code_block([f"{frame.can_id:#05x}  {frame.data.hex(' ')}" for frame in frames])


def _shown(value: Value) -> str:
    if value is None:
        return "none"
    return str(int(value)) if isinstance(value, bool) else str(value)


def _hex_block(data: bytes) -> str:
    step = _HEX_BYTES_PER_LINE
    return _code_block([data[start : start + step].hex(" ") for start in range(0, len(data), step)])


def _code_block(lines: list[str]) -> str:
    return "\n".join(["```text", *lines, "```"])
