"""Write the interface as an XTCE database (OMG XML Telemetric and Command Exchange 1.2)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator

from lidar_icd.names import identifier
from lidar_icd.xtce import beam_array, beam_containers
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


def add_telemetry(
    interface: Interface, metadata: Element, add_measurement: Callable[[Containers], None]
) -> None:
    """Add types, parameters and containers of all packets that the device sends."""
    containers = Containers(interface, metadata)
    primary_header = containers.add(ROOT, abstract=True)
    for name, bits in PRIMARY_HEADER.items():
        containers.add_whole(primary_header, name, bits)
    add_measurement(containers)
    for kind, layout in _blocks(interface):
        criteria = [*containers.of_kind(kind), containers.of_length("==", layout.length)]
        entries = containers.add(kind, ROOT, criteria)
        containers.add_fields(entries, kind, layout, prefix=f"{kind}_")
        containers.add_crc(entries)


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
    return _document(interface, beam_containers.add_measurement)


def has_xtce_arrays(interface: Interface) -> bool:
    """Whether `xtce_arrays` can write the interface: as for `has_xtce`, and packets state the number of their beams."""
    return has_xtce(interface) and beam_array.has_beam_array(interface)


def xtce_arrays(interface: Interface) -> str:
    """Write the database: one container with an array of beams, for readers that know aggregates and arrays.

    `has_xtce_arrays` says for which interfaces.
    """
    return _document(interface, beam_array.add_measurement)


def _document(interface: Interface, add_measurement: Callable[[Containers], None]) -> str:
    root = ElementTree.Element("SpaceSystem", {"xmlns": NAMESPACE, "name": identifier(interface)})
    add_text(root, "LongDescription", _description(interface))
    add(root, "Header", validationStatus="Working", version=interface.version)
    add_telemetry(interface, add(root, "TelemetryMetaData"), add_measurement)
    if interface.commands is not None:
        add_commands(interface, add(root, "CommandMetaData"))
    return written(root)


def _description(interface: Interface) -> str:
    return (
        f"{interface.name}, version {interface.version}. Space packets, after the framing is removed. "
        "A code for no value is NaN. "
        f"Times are nanoseconds since {interface.epoch}."
    )
