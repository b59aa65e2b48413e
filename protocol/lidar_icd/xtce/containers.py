"""Containers of an XTCE database, with the parameters and the types that their entries need."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from lidar_icd.xtce.types import Element, add, add_parameter_type, add_whole_type, compare
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Field
from lidar_protocol.headers import Kind, SpacePacketHeader
from lidar_protocol.layout import Layout

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
                name = f"{prefix}{part.key}{suffix}"
                self._add_entry(entries, name, self._type_of(block, part), part.meaning)
            else:
                self.add_whole(entries, f"unused_{part}_bits", part)

    def add_crc(self, entries: Element) -> None:
        """Add the CRC of the packet, if the interface has one."""
        if self.interface.link.crc_length:
            self.add_whole(entries, "crc", 8 * self.interface.link.crc_length)

    def add_whole(self, entries: Element, parameter: str, bits: int) -> None:
        """Add a whole number that is no field of the definition, and that several containers may hold."""
        self._add_entry(entries, parameter, self.type_of_bits(bits))

    def _type_of(self, block: str, field: Field) -> str:
        """Name of the type of a field in a block, which is added once."""
        name = f"{block}-{field.key}"
        if name not in self._known:
            self._known.add(name)
            add_parameter_type(self.types, self.interface, field, name)
        return name

    def type_of_bits(self, bits: int) -> str:
        """Name of the type of whole numbers of a width without sign, which is added once."""
        name = f"unsigned-{bits}"
        if name not in self._known:
            self._known.add(name)
            add_whole_type(self.types, name, bits)
        return name

    def _add_entry(self, entries: Element, parameter: str, type_name: str, meaning: str = "") -> None:
        if parameter not in self._known:
            self._known.add(parameter)
            of_parameter = {"parameterTypeRef": type_name, "shortDescription": meaning or None}
            add(self._parameters, "Parameter", name=parameter, **of_parameter)
        add(entries, "ParameterRefEntry", parameterRef=parameter)


def _parts(layout: Layout) -> Iterator[Field | int]:
    """Fields of a block in order, and the numbers of unused bits between them."""
    bit = 0
    for placed in sorted(layout.placed, key=lambda each: each.first_bit):
        if placed.first_bit > bit:
            yield placed.first_bit - bit
        yield placed.field
        bit = placed.first_bit + placed.field.codec.bits
    if 8 * layout.length > bit:
        yield 8 * layout.length - bit
