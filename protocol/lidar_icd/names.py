"""Names of an interface in the languages of other tools."""

from __future__ import annotations

import re

from lidar_protocol.definitions import Interface


def identifier(interface: Interface) -> str:
    """Name of the interface in small letters, digits and underscores.

    A name that does not start with "lidar" gets it as a prefix, so that no protocol of Wireshark has the same one.
    """
    name = re.sub(r"[^a-z0-9]+", "_", interface.name.lower()).strip("_")
    return name if name.startswith("lidar") else f"lidar_{name}".rstrip("_")
