"""Write the interface as a plugin of OpenC3 COSMOS: telemetry, commands, and the protocol of its byte link."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib.resources import files
from string import Template

from lidar_icd.framings import framing_text
from lidar_protocol.definitions import CommandDefinition, Interface
from lidar_protocol.fields import (
    FRACTION_BITS,
    NS_PER_S,
    Codec,
    Constant,
    Counter,
    Field,
    Flag,
    Number,
    Real,
    Time,
)
from lidar_protocol.headers import Kind, PlainHeader, SpacePacketHeader
from lidar_protocol.layout import ByteOrder, Layout, PlacedField

_TARGET = "LIDAR"
_FOLDER = f"targets/{_TARGET}"
_CLIENT = "openc3/interfaces/tcpip_client_interface.py <%= lidar_host %> <%= lidar_port %> <%= lidar_port %> 10.0 None"
_PLUGIN = f"""VARIABLE lidar_target_name {_TARGET}
VARIABLE lidar_host host.docker.internal
VARIABLE lidar_port 5600

TARGET {_TARGET} <%= lidar_target_name %>
INTERFACE <%= lidar_target_name %>_INT {_CLIENT}
  MAP_TARGET <%= lidar_target_name %>
  PROTOCOL READ_WRITE lidar_frames.py
"""

_PRIMARY_HEADER = Layout(6, tuple(PlacedField(Field(name, Counter(bits)), bit) for name, bit, bits in (
    ("ccsdsver", 0, 3), ("ccsdstype", 3, 1), ("ccsdsshf", 4, 1), ("ccsdsapid", 5, 11),
    ("ccsdsseqflags", 16, 2), ("ccsdsseqcnt", 18, 14), ("ccsdslength", 32, 16),
)))  # fmt: skip
"""Header of space packets, with the names that targets of COSMOS use."""

_RESERVED = {
    "PACKET_TIME", "PACKET_TIMESECONDS", "PACKET_TIMEFORMATTED", "RECEIVED_TIMESECONDS", "RECEIVED_TIMEFORMATTED",
    "RECEIVED_COUNT", "COSMOS_DATA_TAG", "COSMOS_EXTRA",
}  # fmt: skip
"""Names of items that COSMOS adds to each packet, or gives a meaning."""


def cosmos(interface: Interface, unit: int = 0, beams: int | None = None) -> dict[str, str]:
    """Write the files of a plugin, by their paths in it.

    Args:
        unit: unit that sends the telemetry and takes the commands.
        beams: number of beams that measurements have at most; None: as many as a packet can hold.
    """
    title, cmd_tlm = f"# {_quoted(interface.name)}, version {interface.version}", f"{_FOLDER}/cmd_tlm"
    commands = [_command(interface, unit, each) for each in _commands(interface)]
    hidden = dict.fromkeys(f"IGNORE_PARAMETER {name}" for packet in commands for name in packet.fixed)
    texts = {
        f"{_FOLDER}/target.txt": ["LANGUAGE python", *hidden],
        f"{cmd_tlm}/tlm.txt": [
            title,
            *(line for each in _telemetry(interface, unit, beams) for line in each.lines),
        ],
        f"{cmd_tlm}/cmd.txt": [title, *(line for each in commands for line in each.lines)],
    }
    return {
        "plugin.txt": _PLUGIN,
        **{name: "\n".join([*lines, ""]) for name, lines in texts.items()},
        f"{_FOLDER}/lib/lidar_frames.py": _frames(interface),
    }


class _Packet:
    """The lines of a packet."""

    def __init__(self, interface: Interface, of: str, name: str, meaning: str) -> None:
        order = f"{interface.byte_order.upper()}_ENDIAN"
        self.lines = ["", f"{of} {_TARGET} {_name(name)} {order} {_quoted(meaning)}"]
        self.fixed: list[str] = []
        """Parameters with the same value in each command."""
        self._interface = interface
        self._taken = set(_RESERVED)
        self._length = 0

    def add_header(self, kind: Kind, unit: int, body_length: int) -> None:
        """Add the header, of which kind, unit and constants identify the packet."""
        link = self._interface.link
        is_space_packet = isinstance(link.header, SpacePacketHeader)
        layout = link.header.layout if isinstance(link.header, PlainHeader) else _PRIMARY_HEADER
        stated = layout.unpack(link.header.pack(kind, unit, 0, link.overhead + body_length))
        for placed in layout.placed:
            field, value = placed.field, int(stated[placed.field.key] or 0)
            name = field.name if is_space_packet else f"header_{field.name}"
            is_id = field.name in ("ccsdsapid", "message", "unit") or isinstance(field.codec, Constant)
            if kind == "command":
                self.add_fixed(name, layout, placed, value, is_id)
            elif is_id:
                self._add_item("ID_ITEM", name, layout, placed, f" {_unshifted(field.codec, value)}")
            else:
                self._add_item("ITEM", name, layout, placed)
        self._length = layout.length

    def add_block(self, layout: Layout, suffix: str = "") -> None:
        """Add the fields of a block of telemetry behind those before it."""
        for placed in layout.placed:
            self._add_item("ITEM", f"{placed.field.key}{suffix}", layout, placed)
            self._add_meaning(placed.field)
        if all(placed.end_byte < layout.length for placed in layout.placed):
            # COSMOS takes the length of a packet from its items.
            last = PlacedField(Field("unused", Counter(8)), 8 * (layout.length - 1))
            self._add_item("ITEM", "unused", layout, last)
        self._length += layout.length

    def add_fixed(self, name: str, layout: Layout, placed: PlacedField, value: int, is_id: bool) -> None:
        """Add a parameter that always has the same value."""
        raw = _unshifted(placed.field.codec, value)
        keyword = "ID_PARAMETER" if is_id else "PARAMETER"
        self.fixed.append(self._add_item(keyword, name, layout, placed, f" {raw} {raw} {raw}"))

    def add_argument(self, layout: Layout, placed: PlacedField) -> None:
        """Add an argument of a command, which has no default."""
        field, (_, written, (low, high)) = placed.field, _conversion(placed.field.codec)
        words = self._interface.enumerations.get(field.enumeration or "", {})
        shown = next(iter(words.values()), min(max(low, 0), high))
        self._add_item("PARAMETER", field.key, layout, placed, f" {low!r} {high!r} {shown!r}")
        self.lines.append("    REQUIRED")
        self._add_meaning(field)
        if written:
            self._add_conversion("WRITE", "", written)

    def _add_item(
        self, keyword: str, name: str, layout: Layout, placed: PlacedField, values: str = ""
    ) -> str:
        field, codec = placed.field, placed.field.codec
        unique = self._unique(name)
        kind = "FLOAT" if isinstance(codec, Real) else "INT" if codec.signed else "UINT"
        where = f"{8 * self._length + _bit_offset(placed, layout.byte_order)} {codec.bits}"
        order = f"{layout.byte_order.upper()}_ENDIAN"
        self.lines.append(f"  {keyword} {unique} {where} {kind}{values} {_quoted(field.meaning)} {order}")
        return unique

    def _unique(self, name: str) -> str:
        unique = base = _name(name)
        number = 2
        while unique in self._taken:
            unique, number = f"{base}_{number}", number + 1
        self._taken.add(unique)
        return unique

    def _add_meaning(self, field: Field) -> None:
        words: Mapping[str, int] = self._interface.enumerations.get(field.enumeration or "", {})
        if not words and isinstance(field.codec, Flag):
            words = {"FALSE": 0, "TRUE": 1}
        self.lines += [f"    STATE {_quoted(word)} {code}" for word, code in words.items()]
        if field.unit and not words:
            self.lines.append(f"    UNITS {_quoted(field.unit)} {_quoted(field.unit)}")
        converted, _, _ = _conversion(field.codec)
        if converted:
            self._add_conversion("READ", f" {converted}", field.codec.value("value"))

    def _add_conversion(self, of: str, kind: str, expression: str) -> None:
        start, end = f"    GENERIC_{of}_CONVERSION_START{kind}", f"    GENERIC_{of}_CONVERSION_END"
        self.lines += [start, f"      {expression}", end]


def _commands(interface: Interface) -> tuple[CommandDefinition, ...]:
    return interface.commands.commands if interface.commands else ()


def _telemetry(interface: Interface, unit: int, beams: int | None) -> Iterator[_Packet]:
    definition = interface.packet
    bodies: list[tuple[Kind, Layout | None, str]] = [
        ("measurement", definition.header, "A shot"),
        ("acknowledge", interface.acknowledge, "Answer to a command"),
        ("housekeeping", interface.housekeeping, "State of the device"),
    ]
    for kind, layout, meaning in bodies:
        if layout is None:
            continue
        packet = _Packet(interface, "TELEMETRY", kind, meaning)
        packet.add_header(kind, unit, layout.length)
        packet.add_block(layout)
        block = definition.beam if kind == "measurement" else None
        if block is not None:
            for beam in range(min(beams or definition.maximum_beams, definition.maximum_beams)):
                packet.add_block(block, f"_{beam}")
        # A packet may have fewer beams. Little-endian bit fields at the end seem to COSMOS to go beyond it.
        if block is not None or interface.byte_order == "little":
            packet.lines.append("  ALLOW_SHORT")
        yield packet


def _command(interface: Interface, unit: int, command: CommandDefinition) -> _Packet:
    layout = command.packet
    packet = _Packet(interface, "COMMAND", command.name, command.meaning)
    packet.add_header("command", unit, layout.length)
    # The protocol numbers commands.
    own = {"command": command.code, "interface_version": interface.version, "sequence": 0}
    for placed in layout.placed:
        name, codec = placed.field.name, placed.field.codec
        if isinstance(codec, Constant):
            packet.add_fixed(name, layout, placed, codec.code, is_id=False)
        elif name in own:
            packet.add_fixed(name, layout, placed, own[name], is_id=name == "command")
        else:
            packet.add_argument(layout, placed)
    return packet


def _frames(interface: Interface) -> str:
    """Write the protocol: it extends COSMOS's own for the framing, and drops damaged and empty frames."""
    link, text, folder = interface.link, framing_text(interface.link.framing), files("lidar_icd")
    head, crc, checksum, counters = len(link.framing.head(0)), "None", 'b""', {}
    skipped = {"frame": 0, "packet": head, "body": head + link.header.length}[link.covered]
    if (of := link.crc) is not None:
        crc = f"Crc{of.bits}({of.polynomial:#x}, {of.start:#x}, {bool(of.final_xor)}, {of.reflected})"
        checksum = f'CRC.calc(bytes(frame[{skipped}:])).to_bytes(CRC_LENGTH, "{link.byte_order}")'
    if interface.commands is not None:
        counters = {"SEQUENCE": interface.commands.sequence_steps}
        if link.header.sequence_cycle:
            is_space_packet = isinstance(link.header, SpacePacketHeader)
            counters["CCSDSSEQCNT" if is_space_packet else "HEADER_SEQUENCE"] = link.header.sequence_cycle
    module, base = text.cosmos_base
    template = (folder / "cosmos_template.txt").read_text(encoding="utf-8")
    return Template(template).substitute(
        name=" ".join(interface.name.split()),  # stays on its line of a comment
        version=interface.version,
        module=module,
        base=base,
        constants=text.cosmos(interface.maximum_packet_bytes),
        crc_length=link.crc_length,
        before_body=head + link.header.length,
        crc=crc,
        checksum=checksum,
        methods=(folder / text.cosmos_file).read_text(encoding="utf-8").rstrip(),
        counters=counters,
        lengths={_name(each.name): link.header.length + each.packet.length for each in _commands(interface)},
    )


def _name(key: str) -> str:
    """A name as COSMOS allows it: in capitals, without two underscores in a row or one at the end."""
    return re.sub(r"[\W_]+", "_", key).strip("_").upper()


def _quoted(text: str) -> str:
    """A text that stays between its quotes and on its line, and of which nothing is run as a template."""
    plain = " ".join(text.split()).replace('"', "'").replace("\\", "/").replace("<%", "< %")
    return f'"{plain}"'


def _bit_offset(placed: PlacedField, order: ByteOrder) -> int:
    """Offset of a field in its block, as COSMOS counts: of a little-endian bit field that of its highest bit."""
    field, first = placed
    if order == "big" or (first % 8 == 0 and field.codec.bits in (8, 16, 32, 64)):
        return first
    last = first + field.codec.bits - 1
    return last // 8 * 8 + 7 - last % 8


def _unshifted(codec: Codec, value: int) -> int:
    """Number in the packet of a whole value."""
    return value - codec.offset if isinstance(codec, Number) else value


def _conversion(codec: Codec) -> tuple[str | None, str | None, tuple[float, float]]:
    """Type of the value and expression of the number in the packet, where these are not one; limits of the value."""
    match codec:
        case Real():
            return f"FLOAT {codec.bits}", None, (codec.lowest, codec.highest)
        case Time():
            ticks = f"((int(value) << {FRACTION_BITS}) + {NS_PER_S // 2}) // {NS_PER_S}"
            return "INT 64", ticks, (0, ((1 << codec.bits) - 1) * NS_PER_S >> FRACTION_BITS)
        case Number() if not codec.whole:
            return "FLOAT 64", f"(value * {codec.steps_per_unit!r} + 0.5) // 1", codec.limits
        case Number() if codec.offset:
            return "INT 64", f"value - {codec.offset}", codec.limits
        case Number():
            return None if codec.is_full else "INT 64", None, codec.limits
    return None, None, (0, (1 << codec.bits) - 1)
