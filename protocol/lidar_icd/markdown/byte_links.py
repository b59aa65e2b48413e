"""Sections of the interface document on byte links: header, CRC and framing."""

from __future__ import annotations

from lidar_icd.markdown.field_tables import field_table
from lidar_protocol.crc import CRCS, Crc
from lidar_protocol.definitions import ByteLink, Interface
from lidar_protocol.headers import PlainHeader, SpacePacketHeader

_PYTHON = {
    "crc16_ccitt_false": "`binascii.crc_hqx(data, 0xFFFF)`",
    "crc16_xmodem": "`binascii.crc_hqx(data, 0)`",
    "crc32": "`zlib.crc32(data)`",
}
_COVERED = {
    "packet": "all bytes of the packet before it",
    "body": "the body alone: the bytes between header and CRC",
    "frame": "all bytes of the frame before it, sync word and length included",
}


def header_text(interface: Interface) -> str:
    """Section on the packet header."""
    header = interface.link.header
    return _space_packet(header) if isinstance(header, SpacePacketHeader) else _plain(header)


def _space_packet(header: SpacePacketHeader) -> str:
    last = header.units - 1
    rows = "\n".join(
        f"| {kind} | `{header.identification(kind, 0):#06x}` + unit | {apid:#05x} to {apid + last:#05x} |"
        for kind, apid in header.apids.items()
    )
    return f"""A packet is a CCSDS space packet (133.0-B), unsegmented. Its primary header is big-endian:

| byte | content |
|---|---|
| 0-1 | version 0, packet type, secondary header flag, APID: see below |
| 2-3 | `0xC000` + sequence count, 14 bits |
| 4-5 | packet length - 7 |

| kind | bytes 0-1 | APID of units 0 to {last} |
|---|---|---|
{rows}

If the body starts with a time code, those 7 bytes are the secondary header. The sequence count of a measurement is the
least significant 14 bits of the shot number. Acknowledgements and housekeeping packets are counted separately; for a
command it is the sequence number."""


def _plain(header: PlainHeader) -> str:
    codes = ", ".join(f"{code} {kind}" for kind, code in header.messages.items())
    notes = []
    if "message" in header.layout.names:
        notes.append(f"`message` is the kind of packet: {codes}.")
    if "unit" in header.layout.names:
        notes.append(f"`unit` is 0 to {header.units - 1}.")
    if "sequence" in header.layout.names:
        notes.append(
            "`sequence` holds the least significant bits of the shot number, of the count of packets of the "
            "kind, or of the sequence number of a command."
        )
    if "length" in header.layout.names:
        notes.append("`length` is the length of the packet in bytes, including header and CRC.")
    return f"A packet starts with this header:\n\n{field_table(header.layout)}\n\n" + "\n".join(notes)


def crc_text(link: ByteLink) -> str:
    """Section on the CRC at the end of a packet."""
    if link.crc is None:
        return "There is no CRC: a damaged packet of the correct length cannot be detected."
    crc = link.crc
    name = crc.name.upper().replace("_", "-").replace("CRC16-", "CRC-16/").replace("CCITT-", "CCITT-")
    length = "The last byte" if crc.length == 1 else f"The last {crc.length} bytes, {link.byte_order}-endian"
    return "\n".join((f"{length}: {name} over {_COVERED[link.covered]}.", _parameters(crc)))


def _parameters(crc: Crc) -> str:
    digits = crc.bits // 4
    reflected = "reflected in and out" if crc.reflected else "not reflected"
    final = f"final exclusive-or 0x{crc.final_xor:0{digits}X}" if crc.final_xor else "no final exclusive-or"
    text = (
        f"Polynomial 0x{crc.polynomial:0{digits}X}, start value 0x{crc.start:0{digits}X}, {reflected}, {final}.\n"
        f"Check value: 0x{crc.check:0{digits}X} for the ASCII text `123456789`."
    )
    if crc.name in _PYTHON:
        text += f" In Python: {_PYTHON[crc.name]}."
    assert crc.name in CRCS
    return text
