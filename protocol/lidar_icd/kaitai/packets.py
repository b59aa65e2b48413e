"""Frames and packets in Kaitai Struct."""

from __future__ import annotations

from lidar_icd.kaitai.bodies import BODIES
from lidar_icd.kaitai.headers import KINDS, kinds
from lidar_icd.kaitai.yaml_text import Type
from lidar_protocol.crc import Crc
from lidar_protocol.definitions import ByteLink, Covered, Interface
from lidar_protocol.framing import Framing, Synced
from lidar_protocol.layout import ByteOrder

_COVERED = {
    "packet": "all bytes of the packet before it",
    "body": "the bytes between the header and it",
    "frame": "all bytes of the frame before it, with sync word and length",
}


def frames(framing: Framing) -> Type:
    """All frames of a stream. With a sync word the last one may be cut off, at its end or before its content."""
    repeated = {"id": "frames", "type": "frame"}
    if isinstance(framing, Synced):
        until = f"_io.size - _io.pos < {framing.head_length}"
        return {**repeated, "repeat": "until", "repeat-until": until}
    return {**repeated, "repeat": "eos"}


def frame(framing: Framing) -> Type:
    """A frame of the byte stream."""
    content = {"id": "content", "type": "content"}
    if isinstance(framing, Synced):
        length = {"id": "length", "type": _unsigned(framing.length_bytes, framing.byte_order)}
        left = "_io.size - _io.pos"
        head = framing.uncounted
        stated, negative = (f"length - {head}", f"length < {head} ? 0 : ") if head else ("length", "")
        content["size"] = f"{negative}({stated} <= {left} ? {stated} : {left})"
        return {"seq": [{"id": "sync", "contents": list(framing.sync)}, length, content]}
    stuffed = {
        "terminator": framing.delimiter[0],
        "eos-error": False,
        "process": f"lidar_{framing.kind}",
        "doc": "Empty between the delimiters of two frames, and where the stuffing is invalid",
    }
    return {"seq": [{**content, **stuffed}]}


def content(link: ByteLink) -> Type:
    """What a frame holds. The packet is read when it is asked for, so that its CRC can be checked before."""
    return {
        "instances": {
            "bytes": {"pos": 0, "size-eos": True, "doc": "All bytes of the packet, with its CRC"},
            "packet": {
                "pos": 0,
                "type": "packet",
                "if": f"_io.size > {link.overhead}",
                "doc": "Null if there are fewer bytes than a packet has",
            },
        }
    }


def packet(interface: Interface) -> Type:
    """A packet without framing; the stream that it is read from holds nothing else.

    Only the header is read at once: a damaged body may end too early, and is an error when it is asked for.
    """
    link = interface.link
    instances: dict[str, Type] = {
        "body": {
            "pos": link.header.length,
            "size": f"_io.size - {link.overhead}",
            "type": {
                "switch-on": "header.kind",
                "cases": {f"{KINDS}::{kind}": BODIES[kind] for kind in kinds(interface)},
            },
        }
    }
    if link.crc is not None:
        instances["crc"] = {
            "pos": f"_io.size - {link.crc.length}",
            "type": _unsigned(link.crc.length, link.byte_order),
            "doc": _crc_text(link.crc, link.covered),
        }
    return {"seq": [{"id": "header", "type": "header"}], "instances": instances}


def _unsigned(length: int, byte_order: ByteOrder) -> str:
    """Type of a whole number of bytes."""
    order = "be" if byte_order == "big" else "le"
    return "u1" if length == 1 else f"u{length}{order}"


def _crc_text(crc: Crc, covered: Covered) -> str:
    way = "reflected" if crc.reflected else "not reflected"
    numbers = f"polynomial 0x{crc.polynomial:X}, start 0x{crc.start:X}, {way}, final XOR 0x{crc.final_xor:X}"
    return f"{crc.name} of {_COVERED[covered]}: {numbers}. It is not checked here"


def space_packets() -> dict[str, Type]:
    """Packets one after another without framing, as in a file of space packets."""
    return {
        "space_packets": {"seq": [{"id": "packets", "type": "space_packet", "repeat": "eos"}]},
        "space_packet": {
            "seq": [{"id": "content", "type": "content", "size": "data_length + 7"}],
            "instances": {"data_length": {"pos": "_io.pos + 4", "type": "u2be"}},
        },
    }
