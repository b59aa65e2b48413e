"""Telemetry of an XTCE database: the packets that the device sends."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from lidar_icd.xtce.containers import ROOT, Containers
from lidar_icd.xtce.elements import Element
from lidar_protocol.definitions import Interface
from lidar_protocol.headers import Kind
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
