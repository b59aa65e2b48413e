"""Telemetry of an XTCE database: parameters, and containers for the packets that the device sends."""

from __future__ import annotations

from collections.abc import Iterable

from lidar_icd.xtce.elements import Element, add, compare
from lidar_icd.xtce.parameter_types import add_parameter_type, add_whole_type
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Field
from lidar_protocol.headers import Kind, SpacePacketHeader
from lidar_protocol.layout import Layout

ROOT = "CCSDSPacket"
"""Container of the primary header, from which readers start by default."""

PRIMARY_HEADER = {
    "VERSION": 3, "TYPE": 1, "SEC_HDR_FLG": 1, "PKT_APID": 11, "SEQ_FLGS": 2, "SRC_SEQ_CTR": 14, "PKT_LEN": 16,
}  # fmt: skip
"""Parameters of the primary header and their bits, by the names that readers of space packets use."""

_UNSEGMENTED = 3

Criterion = tuple[str, str, int]
"""Parameter, operator and value."""


def add_telemetry(interface: Interface, metadata: Element) -> None:
    """Add types, parameters and containers of all packets that the device sends."""
    telemetry = _Telemetry(interface, metadata)
    telemetry.add_primary_header()
    telemetry.add_measurement()
    for kind, layout in telemetry.blocks:
        telemetry.add_block(kind, layout)


class _Telemetry:
    """The sets of types, parameters and containers, which grow together."""

    def __init__(self, interface: Interface, metadata: Element) -> None:
        assert isinstance(interface.link.header, SpacePacketHeader)
        self._interface, self._header = interface, interface.link.header
        self._types = add(metadata, "ParameterTypeSet")
        self._parameters = add(metadata, "ParameterSet")
        self._containers = add(metadata, "ContainerSet")
        self._known: set[str] = set()
        """Names of parameters and types."""

    @property
    def blocks(self) -> Iterable[tuple[Kind, Layout]]:
        """Packets of fixed content."""
        acknowledge, housekeeping = self._interface.acknowledge, self._interface.housekeeping
        if acknowledge is not None:
            yield "acknowledge", acknowledge
        if housekeeping is not None:
            yield "housekeeping", housekeeping

    def add_primary_header(self) -> None:
        """Add the container that all packets extend."""
        entries = self._container(ROOT, abstract=True)
        for name, bits in PRIMARY_HEADER.items():
            self._whole(entries, name, bits)

    def add_measurement(self) -> None:
        """Add packets with beams: the container for n beams extends the container for n - 1."""
        packet, name = self._interface.packet, "measurement"
        length = packet.header.length
        criteria = self._of_kind("measurement")
        if packet.beam is None:
            criteria.append(("PKT_LEN", "==", self._stated(length)))
        entries = self._container(name, ROOT, criteria, abstract=packet.beam is not None)
        self._fields(entries, packet.header)
        if packet.beam is None:
            self._crc(entries)
            return
        for beam in range(packet.maximum_beams):
            length += packet.beam.length
            base, name = name, f"with_beam_{beam}"
            entries = self._container(name, base, [("PKT_LEN", ">=", self._stated(length))], abstract=True)
            self._fields(entries, packet.beam, suffix=f"_{beam}")
            exactly = [("PKT_LEN", "==", self._stated(length))]
            self._crc(self._container(f"measurement_{beam + 1}", name, exactly))

    def add_block(self, kind: Kind, layout: Layout) -> None:
        """Add a packet of fixed content, whose parameters start with its kind."""
        criteria = [*self._of_kind(kind), ("PKT_LEN", "==", self._stated(layout.length))]
        entries = self._container(kind, ROOT, criteria)
        self._fields(entries, layout, prefix=f"{kind}_")
        self._crc(entries)

    def _of_kind(self, kind: Kind) -> list[Criterion]:
        """Criteria of a kind of packet, of any unit."""
        flags, first = self._header.identification(kind, 0) >> 11, self._header.apids[kind]
        return [
            ("VERSION", "==", 0),
            ("TYPE", "==", flags >> 1),
            ("SEC_HDR_FLG", "==", flags & 1),
            ("PKT_APID", ">=", first),
            ("PKT_APID", "<=", first + self._interface.units - 1),
            ("SEQ_FLGS", "==", _UNSEGMENTED),
        ]

    def _stated(self, body_length: int) -> int:
        """Value of the length field of a packet."""
        return body_length + self._interface.link.crc_length - 1

    def _container(
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

    def _fields(self, entries: Element, layout: Layout, prefix: str = "", suffix: str = "") -> None:
        """Add the fields of a block in order, and its unused bits between them."""
        bit = 0
        for placed in sorted(layout.placed, key=lambda each: each.first_bit):
            self._unused(entries, placed.first_bit - bit)
            self._field(entries, placed.field, prefix + placed.field.key, suffix)
            bit = placed.first_bit + placed.field.codec.bits
        self._unused(entries, 8 * layout.length - bit)

    def _field(self, entries: Element, field: Field, name: str, suffix: str) -> None:
        type_name = f"{name}_type"
        if type_name not in self._known:
            self._known.add(type_name)
            add_parameter_type(self._types, self._interface, field, type_name)
        self._entry(entries, name + suffix, type_name)

    def _unused(self, entries: Element, bits: int) -> None:
        if bits:
            self._whole(entries, f"unused_{bits}_bits", bits)

    def _crc(self, entries: Element) -> None:
        if self._interface.link.crc_length:
            self._whole(entries, "crc", 8 * self._interface.link.crc_length)

    def _whole(self, entries: Element, parameter: str, bits: int) -> None:
        """Add a whole number that is no field of the definition, and that several containers may hold."""
        if parameter not in self._known:
            add_whole_type(self._types, f"{parameter}_type", bits)
        self._entry(entries, parameter, f"{parameter}_type")

    def _entry(self, entries: Element, parameter: str, type_name: str) -> None:
        if parameter not in self._known:
            self._known.add(parameter)
            add(self._parameters, "Parameter", name=parameter, parameterTypeRef=type_name)
        add(entries, "ParameterRefEntry", parameterRef=parameter)
