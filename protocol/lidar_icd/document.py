"""The interface control document: all that is needed to write a decoder and an encoder of commands."""

from __future__ import annotations

from collections.abc import Sequence
from string import Template
from typing import NamedTuple

from lidar_icd import example
from lidar_icd.can_database import decimal_text
from lidar_icd.device_text import DocumentedDevice, device_text
from lidar_icd.framings import framing_text
from lidar_icd.markdown import table
from lidar_protocol import packet
from lidar_protocol.definitions import ByteLink, CanDefinition, CanMessage, Interface
from lidar_protocol.device import Device
from lidar_protocol.fields import Codec, Constant, Flag, Number, Real, Time, Value
from lidar_protocol.headers import PlainHeader, SpacePacketHeader
from lidar_protocol.host import Host
from lidar_protocol.layout import Layout, PlacedField


class BeamAxis(NamedTuple):
    """Published direction of a beam."""

    angle_deg: float
    """Off the boresight."""
    azimuth_deg: float
    """From the sensor's x axis towards y."""
    body: tuple[float, float, float]
    """Unit vector in the body frame."""


class ScannerBeams(NamedTuple):
    """Beams of each pattern of a scanner."""

    scenario: str
    """Name of the scenario."""
    patterns: Sequence[Sequence[BeamAxis]]
    changes: Sequence[str]
    """When the scanner changes to each pattern by itself: `from the start`, ..."""
    lever_arm_m: tuple[float, float, float]
    """Position of the sensor in the body frame."""
    scans: bool
    """Whether a scan deflects the beams from shot to shot."""


def interface_markdown(
    interface: Interface, scanner: ScannerBeams | None = None, device: DocumentedDevice | None = None
) -> str:
    """Generate the interface document, sufficient to write a host without this package.

    Args:
        scanner: beams of the scenario that the document is for.
        device: behaviour of its device.
    """
    framing, header = interface.link.framing, interface.link.header
    header_text = _space_packet(header) if isinstance(header, SpacePacketHeader) else _plain(header)
    longest = framing.longest_frame(interface.maximum_packet_bytes)
    sections = [
        f"# Interface `{interface.name}`, version {interface.version}",
        "Generated from the interface definition; do not edit. Section 7 is an example to check a decoder against.",
        f"## 1. Conventions\n\n{_conventions(interface)}",
        f"## 2. Packets\n\n{header_text}\n\n{_measurement(interface)}",
        f"### CRC\n\n{_crc_text(interface.link)}",
        f"## 3. Enumerations\n\n{_enumerations(interface)}",
        f"## 4. Byte links\n\n{_line(interface.serial_format)}\n\n{framing_text(framing).markdown(longest)}",
        f"## 5. CAN\n\n{_can(interface, interface.can) if interface.can else 'There are no messages on CAN.'}",
        f"## 6. Commands, acknowledgements and housekeeping\n\n{_control(interface)}{_host_messages(interface)}",
        f"## 7. Example\n\n{_example(interface)}",
        *([f"## 8. Beams\n\n{_beams(scanner)}"] if scanner else []),
        *([f"## 9. The device\n\n{device_text(interface, device)}"] if device and interface.commands else []),
    ]
    return "\n\n".join(sections) + "\n"


def _line(serial_format: str) -> str:
    parity = {"N": "no", "E": "even", "O": "odd"}[serial_format[1]]
    stop = {"1": "1 stop bit", "2": "2 stop bits"}[serial_format[2]]
    return f"""UART: 8 data bits, least significant first, {parity} parity, {stop}, no flow control; the bit rate is
agreed for the run, 115200 bit/s unless it is stated. UDP: a datagram holds one framed packet; the device sends to one
address and port, agreed for the run (no number is assigned), and takes commands from there alone. TCP and Unix sockets
carry the bytes of the UART."""


def _conventions(interface: Interface) -> str:
    order = (
        """* Most significant byte first. In the tables `byte` counts from 0. `bits` counts from 7, the most significant
  bit of a byte, to 0: from the given bit of the first byte to the given bit of the last."""
        if interface.byte_order == "big"
        else """* Least significant byte first. In the tables `byte` counts from 0. `bits` counts from 0, the least
  significant bit of a byte, to 7: from the given bit of the first byte (the lowest of the number) to the given bit
  of the last."""
    )
    return f"""{order} `uN` and `iN` are N-bit numbers without and with
  sign (two's complement), `f32` and `f64` IEEE 754. Bits that are in no table are sent as 0; ignore them.
* Value = raw * step + offset; the offset is 0 if none is stated. Values are rounded to the nearest step.
* **No value.** The raw code under `none` stands for no value. A value outside its range never wraps: it is sent as
  that code or, if the range is marked `held`, as the nearest end of the range. Treat a raw value outside the range as
  no value.
* **Time** (`cuc`): CCSDS 301.0-B unsegmented time code with agency-defined epoch, 4 + 3 bytes, no P-field: as one
  56-bit number t, nanoseconds = t * 10^9 / 2^24, to the nearest nanosecond (halves up). A step is 59.6 ns.
* **Epoch**: {interface.epoch}.
* The contents of a measurement do not depend on the actual time of transmission. A shot that is late or dropped leaves
  a gap in the counters; what the device does not fire (its mode, a lower rate) has no number."""


def _beams(scanner: ScannerBeams) -> str:
    rows = []
    for number, pattern in enumerate(scanner.patterns):
        for beam, axis in enumerate(pattern):
            body = " ".join(f"{x:.6f}" for x in axis.body)
            rows.append((number, beam, f"{axis.angle_deg:g}", f"{axis.azimuth_deg:g}", body))
    lever_arm = ", ".join(f"{x:g}" for x in scanner.lever_arm_m)
    changes = "; ".join(f"{number} {change}" for number, change in enumerate(scanner.changes))
    scan = "without the scan's deflection" if scanner.scans else "which no scan deflects"
    text = f"""Published directions of the patterns of `{scanner.scenario}`, {scan}; true directions may be
misaligned. Azimuths count from the sensor's x axis towards y; the body frame is x forward, y right, z down. Ranges
begin at the sensor, at ({lever_arm}) m in the body frame, and closing speeds are of that point. The scanner's own
changes of pattern: {changes}. For another scenario, `lidar-emu icd my.yaml` writes this document anew."""
    columns = ("pattern", "beam", "off boresight (deg)", "azimuth (deg)", "axis in the body frame: x y z")
    return f"{text}\n\n{table(columns, rows)}"


def _measurement(interface: Interface) -> str:
    definition, link = interface.packet, interface.link
    start = link.header.length
    first = start + definition.header.length
    text = [
        "### Measurement",
        f"Bytes are counted from the start of the packet.\n\n{_field_table(definition.header, start)}",
    ]
    if definition.beam is None:
        return "\n\n".join([*text, f"A packet has {first + link.crc_length} bytes."])
    step, empty = definition.beam.length, first + link.crc_length
    return "\n\n".join(
        [
            *text,
            "### Beam block",
            f"Block k (from 0) starts at byte {first} + {step} * k. Bytes are counted from the start of the block.",
            _field_table(definition.beam),
            _length_text(empty, step, definition.maximum_beams),
        ]
    )


def _length_text(empty: int, step: int, most: int) -> str:
    if most == 1:
        return f"A packet has one beam, and {empty + step} bytes."
    beams = min(4, most)
    return (
        f"A packet has {empty} bytes + {step} per beam, that is {empty + beams * step} for {beams} beams. At least one "
        f"beam, at most {most}."
    )


def _enumerations(interface: Interface) -> str:
    rows = [
        (name, ", ".join(f"{value} {word}" for word, value in words.items()))
        for name, words in interface.enumerations.items()
        if words
    ]
    return table(("name", "values"), rows)


def _can(interface: Interface, can: CanDefinition) -> str:
    text = Template(_CAN).substitute(
        stride=f"{can.unit_stride:#x}",
        last_unit=interface.units - 1,
        slots=can.beam_slots,
        sets=", ".join(f"`{name}`" for name in can.sets),
        headers=", ".join(f"`{each.name}`" for each in can.messages if each.opens_set),
        bits=can.counter_bits,
        cycle=1 << can.counter_bits,
        rows="\n".join(_can_row(can, message) for message in can.messages),
    )
    tables = [f"### `{each.name}`\n\n{_note(can, each)}{_field_table(each.layout)}" for each in can.messages]
    return "\n\n".join([text, *tables])


_CAN = """Standard (11-bit) identifiers. The identifiers of unit n are n * $stride higher than for unit 0
(n = 0 to $last_unit). Beam k uses slot k of $slots. A shot is sent as one set ($sets): in classic frames, or
with `fd` in CAN FD frames with bit rate switch. Frames are sent in the order of the table, slot by slot, the first of
a set when it is due: `due_ns`, where it is sent, is of that frame. The DBC file describes unit 0. Bit rates are agreed
for the run: 500 kbit/s, and 2 Mbit/s for the
data of FD frames, unless they are stated.

Every message of a shot starts with the shot counter, the least significant $bits bits of the shot number: frames with
the same counter belong together. A set starts with its header message, one of $headers,
and is complete when all of its other messages have been received for each of the `beam_count` slots in use. Drop an
incomplete set as soon as the unit sends a frame of a shot that the set does not expect: another header, another
counter, or a message already received. Drop a frame that no set expects: its own header was lost, and an older set may
have the same counter.

The counter wraps after $cycle shots. If all frames from a frame of a set to the same frame of the set $cycle shots
later are lost, only times of arrival show the gap: drop a set that is incomplete when the next one is due.

| message | identifiers, unit 0 | bytes | sets |
|---|---|---|---|
$rows"""


def _can_row(can: CanDefinition, message: CanMessage) -> str:
    first = can.can_id(0, message)
    last = first + can.beam_slots - 1
    ids = f"{first:#05x} to {last:#05x}" if message.each_beam else f"{first:#05x}"
    return f"| `{message.name}` | {ids} | {message.layout.length} | {', '.join(sorted(message.sets))} |"


def _note(can: CanDefinition, message: CanMessage) -> str:
    if message.absent_unless is None:
        return ""
    flag, block = message.absent_unless, message.layout.absent.hex(" ")
    return (
        f"A beam whose `{flag}` is false is sent as absent: `{block}` with the counter in the first\n"
        f"{can.counter_bits} bits. Any other content means that `{flag}` is true.\n\n"
    )


def _control(interface: Interface) -> str:
    text = []
    if interface.commands is not None:
        base = interface.can.id_base if interface.can else 0
        rows = []
        for each in interface.commands.commands:
            can_id = "" if each.can_id is None else f"{base + each.can_id:#05x}"
            rows.append((each.code, f"`{each.name}`", each.meaning, can_id))
        commands = table(("code", "command", "meaning", "CAN, unit 0"), rows)
        text += [_COMMANDS, _checks(interface), commands]
        text += [
            f"### `{command.name}`\n\n{_field_table(command.packet)}"
            + (f"\n\nOn CAN:\n\n{_field_table(command.can)}" if command.can else "")
            for command in interface.commands.commands
        ]
    for kind, layout in interface.replies.items():
        title = "Acknowledgement" if kind == "acknowledge" else "Housekeeping"
        text.append(f"### {title}\n\n{_field_table(layout)}")
    if (can := interface.can) is not None:
        for block in can.blocks:
            heading = f"### `{block.name}` on CAN, {can.can_id(0, block):#05x} of unit 0"
            text.append(f"{heading}\n\n{_field_table(block.layout)}")
    return "\n\n".join(text) or "None."


def _host_messages(interface: Interface) -> str:
    commands, can = interface.commands, interface.can
    if commands is None or not commands.messages:
        return ""
    text = [_HOST_MESSAGES]
    for message in commands.messages:
        text += [
            f"#### `{message.name}`, code {message.code}",
            f"{message.meaning}.",
            _field_table(message.packet),
        ]
        for part in message.can_parts:
            can_id = can.can_id(0, part) if can else 0
            text += [f"`{part.name}` on CAN, {can_id:#05x} of unit 0:", _field_table(part.layout)]
    return "\n\n" + "\n\n".join(text)


_HOST_MESSAGES = """### Messages of the host

What the host sends unasked: packets like those of commands, with codes that no command has. The device checks, counts
and records them, and answers none. Each kind has its own sequence number. A
message is refused if its length is wrong, a value is outside its range or no word of its enumeration, or a field
without a code for `none` has no value. On CAN a message is sent as all of its frames, in the order of their tables and
with the same number; a frame out of this order, or with another number, ends the message, which is then incomplete."""

_COMMANDS = """Bytes are counted from the start of the body, after the packet header. The device answers each command
with one acknowledgement, with the command's sequence number and a verdict. On CAN the identifier replaces the code.
It takes 4096 bytes at once and 16000 bytes a second, on CAN of data; what exceeds that is ignored, without an answer.

A number is in turn if it is the last number plus one; the first after a restart may be any, and a `no_op` of the right
length may have any but the last: a host that does not know the number starts with it. The number in the body counts;
the packet header's own count is not looked at. The last number stays while the link is down. The device checks in this
order, on every link, and answers with the first verdict that applies. Where the last column says so, the command's
number becomes the last number."""


def _checks(interface: Interface) -> str:
    known = interface.enumerations.get("verdict", {})

    def verdict(word: str) -> str:
        return f"{known[word]} {word}" if word in known else word

    other = "an identifier of no command, an extended or an FD frame" if interface.can else ""
    kinds = f"damaged, empty, a packet of more than {interface.maximum_command_bytes} bytes, of another kind or unit"
    rows = [
        (f"{kinds}{'; on CAN, ' if other else ''}{other}", "no answer", ""),
        ("it ends before its sequence number (answered with number 0)", verdict("malformed"), ""),
        ("the number is not in turn", verdict("bad_sequence"), ""),
        ("the code is no command's", verdict("unknown"), "yes"),
        ("it is too short or too long", verdict("malformed"), "yes"),
        ("an argument is outside its range, or no word of its enumeration", verdict("out_of_range"), "yes"),
        ("not allowed in this mode", verdict("out_of_state"), "yes"),
        ("an argument is none that this device can follow", verdict("out_of_range"), "yes"),
    ]
    if interface.commands and "set_mode" in interface.commands.by_name:
        rows.append(("a mode that this mode does not change to", verdict("out_of_state"), "yes"))
    rows.append(("otherwise", verdict("accepted"), "yes"))
    heading = "order", "the command", "verdict", "number counts"
    return table(heading, [(order, *row) for order, row in enumerate(rows, 1)])


def _example(interface: Interface) -> str:
    header, beams = example.shot(interface)
    device = Device(interface, example.UNIT)
    plain = packet.encode(interface, example.UNIT, header, beams)
    shot = packet.decode(interface, plain)
    names = dict.fromkeys(name for beam in shot.beams for name in beam)
    text = [
        f"A shot of unit {example.UNIT} with {len(beams)} beams: a measurement; one of a receding surface with a "
        "second return; an echo below the threshold; a beam that did not fire.",
        table(("header", "value"), [(f"`{name}`", _shown(each)) for name, each in shot.header.items()]),
        table(
            ("beam", *range(len(shot.beams))),
            [
                (f"`{name}`", *(_shown(beam[name]) if name in beam else "" for beam in shot.beams))
                for name in names
            ],
        ),
        f"The packet, {len(plain)} bytes:",
        _hex_block(plain),
        "The same on a byte link:",
        _hex_block(device.serial_bytes(header, beams)),
    ]
    for can_set in interface.can.sets if interface.can else ():
        frames = device.can_frames(can_set, header, beams)  # type: ignore[arg-type]
        lines = [f"{frame.can_id:#05x}  {frame.data.hex(' ')}" for frame in frames]
        text += [f"The same as the set `{can_set}` on CAN:", _code_block(lines)]
    return "\n\n".join([*text, *_control_example(interface, device)])


def _control_example(interface: Interface, device: Device) -> list[str]:
    if interface.commands is None:
        return []
    name, values = example.command(interface)
    given = ", ".join(f"{key} {value}" for key, value in values.items())
    text = [
        f"The command `{name}` with {given}, framed:",
        _hex_block(Host(interface, example.UNIT).encode_command(name, **values)),
    ]
    if interface.acknowledge is not None:
        answer = device.acknowledge(0, name, **example.acknowledgement(interface))
        text += ["Its acknowledgement, framed:", _hex_block(answer)]
    return text


_HEX_BYTES_PER_LINE = 28


def _field_table(layout: Layout, first_byte: int = 0) -> str:
    """Table of the fields of a block, whose bytes are counted from `first_byte`."""
    heading = "byte", "bits", "type", "name", "step", "range", "none", "meaning"
    return table(heading, [_row(placed, layout, first_byte) for placed in layout.placed])


def _row(placed: PlacedField, layout: Layout, first_byte: int) -> tuple[str, ...]:
    field, codec = placed.field, placed.field.codec
    first, last = placed.first_bit, placed.first_bit + codec.bits - 1
    down = 7 if layout.byte_order == "big" else 0
    meaning = field.meaning if field.beam is None else f"Beam {field.beam}: {field.meaning}"
    return (
        f"{first_byte + first // 8}" + (f"-{first_byte + last // 8}" if last // 8 > first // 8 else ""),
        f"{abs(down - first % 8)}" + (f"-{abs(down - last % 8)}" if last > first else ""),
        _type_name(codec),
        f"`{field.key}`",
        *_number_cells(codec, field.unit),
        f"{meaning} (section 3, {field.enumeration})" if field.enumeration else meaning,
    )


def _type_name(codec: Codec) -> str:
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
    step = f"{'1' if codec.whole else decimal_text(1 / codec.steps_per_unit)} {unit}".rstrip()
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


def _shown(value: Value) -> str:
    if value is None:
        return "none"
    return str(int(value)) if isinstance(value, bool) else str(value)


def _hex_block(data: bytes) -> str:
    step = _HEX_BYTES_PER_LINE
    return _code_block([data[start : start + step].hex(" ") for start in range(0, len(data), step)])


def _code_block(lines: list[str]) -> str:
    return "\n".join(["```text", *lines, "```"])


_PYTHON = {
    "crc16_ccitt_false": "`binascii.crc_hqx(data, 0xFFFF)`",
    "crc16_xmodem": "`binascii.crc_hqx(data, 0)`",
    "crc32": "`zlib.crc32(data)`",
}
_COVERED = {
    "packet": "all bytes of the packet before it",
    "body": "the body alone: the bytes between header and CRC",
    "frame": "all bytes of the frame before it, sync word and length included",
}


def _space_packet(header: SpacePacketHeader) -> str:
    last = header.units - 1
    rows = "\n".join(
        f"| {kind} | `{header.identification(kind, 0):#06x}` + unit | {apid:#05x} to {apid + last:#05x} |"
        for kind, apid in header.apids.items()
    )
    return f"""A packet is a CCSDS space packet (133.0-B), unsegmented. Its primary header is big-endian:

| byte | content |
|---|---|
| 0-1 | version 0, packet type, secondary header flag, APID: see below |
| 2-3 | `0xC000` + sequence count, 14 bits |
| 4-5 | packet length - 7 |

| kind | bytes 0-1 | APID of units 0 to {last} |
|---|---|---|
{rows}

If the body starts with a time code, those 7 bytes are the secondary header. The sequence count of a measurement is the
least significant 14 bits of the shot number. Acknowledgements and housekeeping packets are counted separately; for a
command it is the sequence number."""


def _plain(header: PlainHeader) -> str:
    codes = ", ".join(f"{code} {kind}" for kind, code in header.messages.items())
    notes = []
    if "message" in header.layout.names:
        notes.append(f"`message` is the kind of packet: {codes}.")
    if "unit" in header.layout.names:
        notes.append(f"`unit` is 0 to {header.units - 1}.")
    if "sequence" in header.layout.names:
        notes.append(
            "`sequence` holds the least significant bits of the shot number, of the count of packets of the "
            "kind, or of the sequence number of a command."
        )
    if "length" in header.layout.names:
        notes.append("`length` is the length of the packet in bytes, including header and CRC.")
    return f"A packet starts with this header:\n\n{_field_table(header.layout)}\n\n" + "\n".join(notes)


def _crc_text(link: ByteLink) -> str:
    if link.crc is None:
        return "There is no CRC: a damaged packet of the correct length cannot be detected."
    crc = link.crc
    name = crc.name.upper().replace("_", "-").replace("CRC16-", "CRC-16/").replace("CCITT-", "CCITT-")
    length = "The last byte" if crc.length == 1 else f"The last {crc.length} bytes, {link.byte_order}-endian"
    digits = crc.bits // 4
    reflected = "reflected in and out" if crc.reflected else "not reflected"
    final = f"final exclusive-or 0x{crc.final_xor:0{digits}X}" if crc.final_xor else "no final exclusive-or"
    text = (
        f"{length}: {name} over {_COVERED[link.covered]}.\n"
        f"Polynomial 0x{crc.polynomial:0{digits}X}, start value 0x{crc.start:0{digits}X}, {reflected}, {final}.\n"
        f"Check value: 0x{crc.check:0{digits}X} for the ASCII text `123456789`."
    )
    if crc.name in _PYTHON:
        text += f" In Python: {_PYTHON[crc.name]}."
    return text
