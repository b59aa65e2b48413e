"""Bodies of packets in Kaitai Struct."""

from __future__ import annotations

from collections.abc import Mapping

from lidar_icd.kaitai.blocks import BlockType
from lidar_icd.kaitai.identifiers import Identifiers
from lidar_icd.kaitai.yaml_text import Type
from lidar_protocol.definitions import Interface
from lidar_protocol.headers import Kind

BODIES: Mapping[Kind, str] = {
    "measurement": "measurement",
    "command": "telecommand",
    "acknowledge": "acknowledge",
    "housekeeping": "housekeeping",
}
"""Types of the bodies."""


def bodies(interface: Interface, enums: Mapping[str, str]) -> dict[str, Type]:
    """Types of all bodies, and of their parts."""
    types = {**_measurement(interface, enums), **_telecommands(interface, enums)}
    for kind, layout in (("acknowledge", interface.acknowledge), ("housekeeping", interface.housekeeping)):
        if layout is not None:
            types[kind] = BlockType(layout, enums).type_of()
    return types


def _measurement(interface: Interface, enums: Mapping[str, str]) -> dict[str, Type]:
    """A shot, and its beams."""
    packet = interface.packet
    block = BlockType(packet.header, enums, {"beams"})
    if packet.beam is None:
        return {"measurement": block.type_of()}
    beams = {"id": "beams", "type": "beam", "repeat": "eos"}
    if "beam_count" in block.values:
        beams |= {"repeat": "expr", "repeat-expr": block.number("beam_count", 0)}
    return {"measurement": block.type_of(beams), "beam": BlockType(packet.beam, enums).type_of()}


def _telecommands(interface: Interface, enums: Mapping[str, str]) -> dict[str, Type]:
    """Commands: their header says which block of fields they are, and that starts with the header again."""
    if interface.commands is None:
        return {}
    header = BlockType(interface.commands.header, enums, {"code"})
    scope = Identifiers({"telecommand_header"})
    names = {
        command.code: scope.add(f"telecommand_{command.name}") for command in interface.commands.commands
    }
    types = {
        names[command.code]: BlockType(command.packet, enums).type_of()
        for command in interface.commands.commands
    }
    telecommand = {
        "instances": {
            "header": {"pos": 0, "type": "telecommand_header"},
            "command": {
                "pos": 0,
                "type": {"switch-on": "header.code", "cases": names},
                "doc": "All fields of the command; null if its code is unknown",
            },
        }
    }
    return {
        "telecommand": telecommand,
        "telecommand_header": header.type_of(code={"value": header.number("command")}),
        **types,
    }
