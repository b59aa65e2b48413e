"""Headers of packets in Kaitai Struct, and the kinds of packets that they state."""

from __future__ import annotations

from collections.abc import Mapping

from lidar_icd.kaitai.blocks import BlockType
from lidar_icd.kaitai.yaml_text import Type
from lidar_protocol.definitions import Interface
from lidar_protocol.fields import Constant
from lidar_protocol.headers import Kind, PlainHeader, SpacePacketHeader

KINDS = "packet_kind"
"""Enumeration of the kinds of packets; 0 is unknown."""


def kinds(interface: Interface) -> list[Kind]:
    """Kinds of packets of the interface."""
    header = interface.link.header
    return list(header.apids if isinstance(header, SpacePacketHeader) else header.messages)


def header(interface: Interface) -> Type:
    """The header of all packets, and the kind of the packet."""
    own = interface.link.header
    return _space_packet_header(own) if isinstance(own, SpacePacketHeader) else _plain_header(own)


def _space_packet_header(header: SpacePacketHeader) -> Type:
    conditions = {
        kind: " and ".join(
            [
                f"{'' if kind == 'command' else 'not '}is_telecommand",
                f"{'' if kind in header.timed else 'not '}has_secondary_header",
                f"apid >= {first} and apid <= {first + header.units - 1}",
            ]
        )
        for kind, first in header.apids.items()
    }
    firsts: dict[str, str] = {kind: str(first) for kind, first in header.apids.items()}
    subtracted = "".join(f"kind == {KINDS}::{kind} ? {first} : " for kind, first in firsts.items())
    return {
        "seq": [
            {"id": "version", "type": "b3be"},
            {"id": "is_telecommand", "type": "b1be"},
            {"id": "has_secondary_header", "type": "b1be"},
            {"id": "apid", "type": "b11be"},
            {"id": "sequence_flags", "type": "b2be"},
            {"id": "sequence", "type": "b14be"},
            {"id": "data_length", "type": "u2be", "doc": "Bytes behind this header, less one"},
        ],
        "instances": {
            "is_whole": {"value": "version == 0 and sequence_flags == 3 and data_length + 7 == _io.size"},
            "kind": _kind(conditions, "is_whole"),
            "unit": {"value": f"apid - ({subtracted}0)"},
        },
    }


def _plain_header(header: PlainHeader) -> Type:
    block = BlockType(header.layout, {}, {"kind"})
    names = block.values
    whole = [
        f"{names[placed.field.key]} == {placed.field.codec.code}"
        for placed in header.layout.placed
        if isinstance(placed.field.codec, Constant)
    ]
    if "unit" in names:
        whole.append(f"{block.number('unit', 0)} < {header.units}")
    if "length" in names:
        whole.append(f"{block.number('length')} == _io.size")
    conditions = {
        kind: f"{block.number('message')} == {code}" if "message" in names else "true"
        for kind, code in header.messages.items()
    }
    return block.type_of(kind=_kind(conditions, " and ".join(whole) or "true"))


def _kind(conditions: Mapping[Kind, str], is_whole: str) -> Type:
    """The kind, if a condition on all packets and one of the kinds hold."""
    unknown = f"{KINDS}::unknown"
    choices = "".join(f"({condition}) ? {KINDS}::{kind} : " for kind, condition in conditions.items())
    value = f"not ({is_whole}) ? {unknown} : {choices}{unknown}"
    return {"value": value, "doc": "Unknown if it is no packet of this interface"}
