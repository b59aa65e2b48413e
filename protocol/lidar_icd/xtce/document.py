"""Write the interface as an XTCE database (OMG XML Telemetric and Command Exchange 1.2)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

from lidar_icd.names import identifier
from lidar_icd.xtce.commands import add_commands
from lidar_icd.xtce.containers import ROOT, Containers
from lidar_icd.xtce.types import NAMESPACE, Element, add, add_text, written
from lidar_protocol.definitions import Interface
from lidar_protocol.headers import Kind, SpacePacketHeader
from lidar_protocol.layout import Layout

PRIMARY_HEADER = {
    "VERSION": 3, "TYPE": 1, "SEC_HDR_FLG": 1, "PKT_APID": 11, "SEQ_FLGS": 2, "SRC_SEQ_CTR": 14, "PKT_LEN": 16,
}  # fmt: skip
"""Parameters of the primary header and their bits, by the names that readers of space packets use."""


def add_telemetry(interface: Interface, metadata: Element) -> None:
    """Add types, parameters and containers of all packets that the device sends."""
    containers = Containers(interface, metadata)
    primary_header = containers.add(ROOT, abstract=True)
    for name, bits in PRIMARY_HEADER.items():
        containers.add_whole(primary_header, name, bits)
    _add_measurement(containers)
    for kind, layout in _blocks(interface):
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


def _blocks(interface: Interface) -> Iterator[tuple[Kind, Layout]]:
    """Packets of fixed content, whose parameters start with their kind."""
    if interface.acknowledge is not None:
        yield "acknowledge", interface.acknowledge
    if interface.housekeeping is not None:
        yield "housekeeping", interface.housekeeping


def has_xtce(interface: Interface) -> bool:
    """Whether XTCE readers can read the interface: space packets, with the most significant byte first."""
    return isinstance(interface.link.header, SpacePacketHeader) and interface.byte_order == "big"


def xtce(interface: Interface) -> str:
    """Write the database: a container for each number of beams, and only plain parameters, which every reader knows.

    `has_xtce` says for which interfaces.
    """
    root = ElementTree.Element("SpaceSystem", {"xmlns": NAMESPACE, "name": identifier(interface)})
    add_text(root, "LongDescription", _description(interface))
    add(root, "Header", validationStatus="Working", version=interface.version)
    add_telemetry(interface, add(root, "TelemetryMetaData"))
    if interface.commands is not None:
        add_commands(interface, add(root, "CommandMetaData"))
    return written(root)


def _description(interface: Interface) -> str:
    return (
        f"{interface.name}, version {interface.version}. Space packets, after the framing is removed. "
        "A code for no value is NaN. "
        f"Times are nanoseconds since {interface.epoch}."
    )
