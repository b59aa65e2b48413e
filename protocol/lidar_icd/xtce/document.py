"""Write the interface as an XTCE database (OMG XML Telemetric and Command Exchange 1.2)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable

from lidar_icd.names import identifier
from lidar_icd.xtce import beam_array, beam_containers
from lidar_icd.xtce.commands import add_commands
from lidar_icd.xtce.containers import Containers
from lidar_icd.xtce.elements import NAMESPACE, add, add_text, written
from lidar_icd.xtce.telemetry import add_telemetry
from lidar_protocol.definitions import Interface
from lidar_protocol.headers import SpacePacketHeader


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
