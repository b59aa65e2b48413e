"""Write the interface as a specification of Kaitai Struct."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

from lidar_icd.kaitai.bodies import bodies
from lidar_icd.kaitai.enumerations import enum_names, enums
from lidar_icd.kaitai.headers import header
from lidar_icd.kaitai.packets import content, frame, frames, packet, space_packets
from lidar_icd.kaitai.yaml_text import Type, plain_text, yaml_text
from lidar_protocol.definitions import Interface
from lidar_protocol.framing import Stuffed
from lidar_protocol.headers import SpacePacketHeader


def kaitai(interface: Interface) -> str:
    """Write the specification of the byte stream of a link: its frames, and the packets in them."""
    order = "be" if interface.byte_order == "big" else "le"
    title = plain_text(f"{interface.name}, version {interface.version}")
    names = enum_names(interface, _types(interface, {}))
    return "# Generated; do not edit.\n" + yaml_text(
        {
            "meta": {"id": "lidar_stream", "title": title, "endian": order, "bit-endian": order},
            "doc": _description(interface),
            "seq": [frames(interface.link.framing)],
            "types": _types(interface, names),
            "enums": enums(interface, names),
        }
    )


def kaitai_processes(interface: Interface) -> dict[str, str]:
    """Files that compiled code needs to remove the stuffing, with their contents: a module in Python, and a header in
    C++. An interface with a sync word needs none."""
    framing = interface.link.framing
    if not isinstance(framing, Stuffed):
        return {}
    names = [f"lidar_{framing.kind}.{ending}" for ending in ("py", "h")]
    return {name: (files("lidar_icd.kaitai") / name).read_text(encoding="utf-8") for name in names}


def _types(interface: Interface, enum_names: Mapping[str, str]) -> dict[str, Type]:
    link = interface.link
    types = {
        "frame": frame(link.framing),
        "content": content(link),
        "packet": packet(interface),
        "header": header(interface),
        **bodies(interface, enum_names),
    }
    return types | space_packets() if isinstance(link.header, SpacePacketHeader) else types


def _description(interface: Interface) -> str:
    return plain_text(
        f"The byte stream of {interface.name}, version {interface.version}, or one of its datagrams. Where there is no "
        f"value, has_NAME is false and NAME is null. Times are nanoseconds since {interface.epoch}."
    )
