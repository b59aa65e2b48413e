"""Write the interface as an XTCE database (OMG XML Telemetric and Command Exchange 1.2)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator

from lidar_icd.wireshark import identifier
from lidar_icd.xtce.types import (
    NAMESPACE,
    NS_PER_TICK,
    Element,
    add,
    add_encoding,
    add_flag_or_real,
    add_parameter_type,
    add_range,
    add_scale,
    add_text,
    add_typed,
    add_whole_type,
    compare,
    written,
)
from lidar_protocol.definitions import CommandDefinition, Interface
from lidar_protocol.fields import Codec, Constant, Field, Flag, Number, Real, Time
from lidar_protocol.headers import Kind, SpacePacketHeader
from lidar_protocol.layout import Layout, PlacedField

PRIMARY_HEADER = {
    "VERSION": 3, "TYPE": 1, "SEC_HDR_FLG": 1, "PKT_APID": 11, "SEQ_FLGS": 2, "SRC_SEQ_CTR": 14, "PKT_LEN": 16,
}  # fmt: skip
"""Parameters of the primary header and their bits, by the names that readers of space packets use."""

ROOT = "CCSDSPacket"
"""Container of the primary header, from which readers start by default."""

_UNSEGMENTED = 3

Criterion = tuple[str, str, int]
"""Parameter, operator and value."""


class Containers:
    """The sets of types, parameters and containers, which grow together."""

    def __init__(self, interface: Interface, metadata: Element) -> None:
        assert isinstance(interface.link.header, SpacePacketHeader)
        self.interface, self._header = interface, interface.link.header
        self.types = add(metadata, "ParameterTypeSet")
        self._parameters = add(metadata, "ParameterSet")
        self._containers = add(metadata, "ContainerSet")
        self._known: set[str] = set()
        """Names of parameters and types; only names of types have a hyphen."""

    def add(
        self, name: str, base: str | None = None, criteria: Iterable[Criterion] = (), abstract: bool = False
    ) -> Element:
        """Add a container, and return its list of entries."""
        container = add(self._containers, "SequenceContainer", name=name, abstract=abstract or None)
        entries = add(container, "EntryList")
        if base is not None:
            extended = add(container, "BaseContainer", containerRef=base)
            comparisons = add(add(extended, "RestrictionCriteria"), "ComparisonList")
            for criterion in criteria:
                compare(comparisons, *criterion)
        return entries

    def of_kind(self, kind: Kind) -> list[Criterion]:
        """Criteria of a kind of packet, of any unit."""
        flags, first = self._header.identification(kind, 0) >> 11, self._header.apids[kind]
        return [
            ("VERSION", "==", 0),
            ("TYPE", "==", flags >> 1),
            ("SEC_HDR_FLG", "==", flags & 1),
            ("PKT_APID", ">=", first),
            ("PKT_APID", "<=", first + self.interface.units - 1),
            ("SEQ_FLGS", "==", _UNSEGMENTED),
        ]

    def of_length(self, operator: str, body_length: int) -> Criterion:
        """Criterion that compares the length of the body in bytes, by the length that the packet states."""
        return "PKT_LEN", operator, body_length + self.interface.link.crc_length - 1

    def add_fields(
        self, entries: Element, block: str, layout: Layout, prefix: str = "", suffix: str = ""
    ) -> None:
        """Add the fields of a block in order, and its unused bits between them."""
        for part in _parts(layout):
            if isinstance(part, Field):
                name = f"{block}-{part.key}"
                if name not in self._known:
                    self._known.add(name)
                    add_parameter_type(self.types, self.interface, part, name)
                self._add_entry(entries, f"{prefix}{part.key}{suffix}", name, part.meaning)
            else:
                self.add_whole(entries, f"unused_{part}_bits", part)

    def add_crc(self, entries: Element) -> None:
        """Add the CRC of the packet, if the interface has one."""
        if self.interface.link.crc_length:
            self.add_whole(entries, "crc", 8 * self.interface.link.crc_length)

    def add_whole(self, entries: Element, parameter: str, bits: int) -> None:
        """Add a whole number that is no field of the definition, and that several containers may hold."""
        name = f"unsigned-{bits}"
        if name not in self._known:
            self._known.add(name)
            add_whole_type(self.types, name, bits)
        self._add_entry(entries, parameter, name)

    def _add_entry(self, entries: Element, parameter: str, type_name: str, meaning: str = "") -> None:
        if parameter not in self._known:
            self._known.add(parameter)
            of_parameter = {"parameterTypeRef": type_name, "shortDescription": meaning or None}
            add(self._parameters, "Parameter", name=parameter, **of_parameter)
        add(entries, "ParameterRefEntry", parameterRef=parameter)


def _parts(layout: Layout) -> Iterator[Field | int]:
    bit = 0
    for placed in sorted(layout.placed, key=lambda each: each.first_bit):
        if placed.first_bit > bit:
            yield placed.first_bit - bit
        yield placed.field
        bit = placed.first_bit + placed.field.codec.bits
    if 8 * layout.length > bit:
        yield 8 * layout.length - bit


def add_telemetry(interface: Interface, metadata: Element) -> None:
    """Add types, parameters and containers of all packets that the device sends."""
    containers = Containers(interface, metadata)
    primary_header = containers.add(ROOT, abstract=True)
    for name, bits in PRIMARY_HEADER.items():
        containers.add_whole(primary_header, name, bits)
    _add_measurement(containers)
    # Packets of fixed content, whose parameters start with their kind.
    for kind, layout in interface.replies.items():
        criteria = [*containers.of_kind(kind), containers.of_length("==", layout.length)]
        entries = containers.add(kind, ROOT, criteria)
        containers.add_fields(entries, kind, layout, prefix=f"{kind}_")
        containers.add_crc(entries)


def _add_measurement(containers: Containers) -> None:
    """Add measurements: the container for n beams extends the container for n - 1."""
    packet, name = containers.interface.packet, "measurement"
    length = packet.header.length
    criteria = containers.of_kind("measurement")
    if packet.beam is None:
        criteria.append(containers.of_length("==", length))
    entries = containers.add(name, ROOT, criteria, abstract=packet.beam is not None)
    containers.add_fields(entries, "header", packet.header)
    if packet.beam is None:
        containers.add_crc(entries)
        return
    for beam in range(packet.maximum_beams):
        length += packet.beam.length
        base, name = name, f"with_beam_{beam}"
        entries = containers.add(name, base, [containers.of_length(">=", length)], abstract=True)
        containers.add_fields(entries, "beam", packet.beam, suffix=f"_{beam}")
        exactly = [containers.of_length("==", length)]
        containers.add_crc(containers.add(f"measurement_{beam + 1}", name, exactly))


def add_commands(interface: Interface, metadata: Element) -> None:
    """Add all commands of an interface, and the other messages of the host. What sends them appends the CRC."""
    assert interface.commands is not None
    assert isinstance(interface.link.header, SpacePacketHeader)
    types, commands = add(metadata, "ArgumentTypeSet"), add(metadata, "MetaCommandSet")
    unit = add(types, "IntegerArgumentType", name="unit_type", signed=False)
    add(unit, "UnitSet")
    add_scale(add_encoding(unit, 11), interface.link.header.apids["command"], 1.0)
    add_range(unit, (0, interface.units - 1))
    for command in interface.commands.packets:
        _add_command(types, commands, interface, command)


def _add_command(types: Element, commands: Element, interface: Interface, command: CommandDefinition) -> None:
    meta = add(commands, "MetaCommand", name=command.name, shortDescription=command.meaning or None)
    arguments = add(meta, "ArgumentList")
    entries = add(add(meta, "CommandContainer", name=command.name), "EntryList")
    link, bit, layout = interface.link, 0, command.packet
    assert isinstance(link.header, SpacePacketHeader)
    _add_argument(arguments, "unit", "unit_type", 0, "Number of the device")
    _add_fixed(entries, link.header.identification("command", 0) >> 11, 5)
    add(entries, "ArgumentRefEntry", argumentRef="unit")
    # Sequence flags, a count of 0, which devices do not use, and the length.
    _add_fixed(entries, _UNSEGMENTED << 30 | layout.length + link.crc_length - 1, 32)
    for placed in sorted(layout.placed, key=lambda each: each.first_bit):
        _add_fixed(entries, 0, placed.first_bit - bit)
        _add_field(types, arguments, entries, interface, command, placed)
        bit = placed.first_bit + placed.field.codec.bits
    _add_fixed(entries, 0, 8 * layout.length - bit)


def _add_field(
    types: Element,
    arguments: Element,
    entries: Element,
    interface: Interface,
    command: CommandDefinition,
    placed: PlacedField,
) -> None:
    field, codec = placed.field, placed.field.codec
    own = {"command": command.code, "interface_version": interface.version}
    if isinstance(codec, Constant):
        _add_fixed(entries, codec.code, codec.bits)
    elif field.name in own:
        _add_fixed(entries, own[field.name], codec.bits)
    else:
        name = f"{command.name}_{field.key}_type"
        _add_argument_type(types, interface, field, name)
        initial = 0 if field.name == "sequence" else None
        _add_argument(arguments, field.key, name, initial, field.meaning)
        add(entries, "ArgumentRefEntry", argumentRef=field.key)


def _add_argument(arguments: Element, name: str, type_name: str, initial: int | None, meaning: str) -> None:
    of_argument = {"initialValue": initial, "shortDescription": meaning or None}
    add(arguments, "Argument", name=name, argumentTypeRef=type_name, **of_argument)


def _add_argument_type(types: Element, interface: Interface, field: Field, name: str) -> None:
    codec = field.codec
    words = interface.enumerations.get(field.enumeration or "")
    if words and not isinstance(codec, Flag):
        enumerated = add_typed(types, "EnumeratedArgumentType", name, field)
        add_encoding(enumerated, codec.bits, codec.signed)
        entries = add(enumerated, "EnumerationList")
        for word, code in words.items():
            add(entries, "Enumeration", value=code, label=word)
    elif isinstance(codec, Flag | Real):
        add_flag_or_real(types, "Argument", name, field)
    else:
        _add_number(types, name, field, codec)


def _add_number(types: Element, name: str, field: Field, codec: Codec) -> None:
    """Add a number. The calibrator of an argument converts the value to the raw one, a parameter's the raw value."""
    is_float = isinstance(codec, Time) or (isinstance(codec, Number) and not codec.whole)
    tag = "FloatArgumentType" if is_float else "IntegerArgumentType"
    signed = {} if is_float else {"signed": codec.signed}
    number = add_typed(types, tag, name, field, sizeInBits=64, **signed)
    encoding = add_encoding(number, codec.bits, codec.signed)
    if isinstance(codec, Time):
        add_scale(encoding, 0, 1 / NS_PER_TICK)
        add_range(number, (0, (1 << codec.bits) * NS_PER_TICK))
    elif isinstance(codec, Number):
        if not codec.whole or codec.offset:
            add_scale(encoding, -codec.offset, codec.steps_per_unit)
        add_range(number, codec.limits)


def _add_fixed(entries: Element, value: int, bits: int) -> None:
    if bits:
        digits = f"{value:0{2 * -(-bits // 8)}X}"
        add(entries, "FixedValueEntry", binaryValue=digits, sizeInBits=bits)


def has_xtce(interface: Interface) -> bool:
    """Whether XTCE readers can read the interface: space packets, with the most significant byte first."""
    return isinstance(interface.link.header, SpacePacketHeader) and interface.byte_order == "big"


def xtce(interface: Interface) -> str:
    """Write the database: a container for each number of beams, and only plain parameters, which every reader knows.

    `has_xtce` says for which interfaces.
    """
    root = ElementTree.Element("SpaceSystem", {"xmlns": NAMESPACE, "name": identifier(interface)})
    description = (
        f"{interface.name}, version {interface.version}. Space packets, after the framing is removed. "
        f"A code for no value is NaN. Times are nanoseconds since {interface.epoch}."
    )
    add_text(root, "LongDescription", description)
    add(root, "Header", validationStatus="Working", version=interface.version)
    add_telemetry(interface, add(root, "TelemetryMetaData"))
    if interface.commands is not None:
        add_commands(interface, add(root, "CommandMetaData"))
    return written(root)
