"""What the interface document says of byte links: headers, CRC and framing of any kind."""

from __future__ import annotations

from lidar_icd.markdown.field_tables import field_table
from lidar_protocol.crc import CRCS, Crc
from lidar_protocol.definitions import ByteLink, Interface
from lidar_protocol.framing import Stuffed, Synced
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
    """The header of a packet."""
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
| 0-1 | version 0, type, flag of a secondary header, APID: see below |
| 2-3 | `0xC000` + sequence count, 14 bits |
| 4-5 | length of the packet - 7 |

| kind | bytes 0-1 | APID of units 0 to {last} |
|---|---|---|
{rows}

Where the body starts with a time code, those 7 bytes are the secondary header. The sequence count of a measurement is
the lowest 14 bits of the shot's number; the other kinds count their packets, commands by their sequence number."""


def _plain(header: PlainHeader) -> str:
    codes = ", ".join(f"{code} {kind}" for kind, code in header.messages.items())
    told = []
    if "message" in header.layout.names:
        told.append(f"`message` tells the kinds of packets apart: {codes}.")
    if "unit" in header.layout.names:
        told.append(f"`unit` is 0 to {header.units - 1}.")
    if "sequence" in header.layout.names:
        told.append(
            "`sequence` is the lowest bits of the number of the shot, of packets of the kind, or of the command."
        )
    if "length" in header.layout.names:
        told.append("`length` is that of the packet in bytes, header and CRC included.")
    return f"A packet starts with this header:\n\n{field_table(header.layout)}\n\n" + "\n".join(told)


def crc_text(link: ByteLink) -> str:
    """The check at the end of a packet."""
    if link.crc is None:
        return "There is none: nothing tells a damaged packet of the right length from a good one."
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


def framing_text(interface: Interface) -> str:
    """How packets lie in a stream of bytes."""
    framing = interface.link.framing
    longest = framing.longest_frame(interface.maximum_packet_bytes)
    if isinstance(framing, Synced):
        return _synced(framing, longest)
    return (_COBS if framing.kind == "cobs" else _SLIP) + _delimited(framing, longest)


def _synced(framing: Synced, longest: int) -> str:
    size = {1: "u8", 2: "u16", 4: "u32"}[framing.length_bytes]
    if framing.counts == "packet":
        counted = "the number of bytes that follow it"
    else:
        counted = "the number of bytes of the frame, sync word and length included"
    order = "" if framing.length_bytes == 1 else f" ({framing.byte_order}-endian)"
    return f"""Each packet follows the sync word `{framing.sync.hex(" ")}` and a {size}{order}:
{counted}.

To decode, look for the sync word, read the length and that many bytes. If the length is impossible or the packet is
not good, the sync word was chance or the frame is damaged: look on right behind that sync word, not behind the frame.
No frame from the device is longer than {longest} bytes."""


_COBS = """Each packet is stuffed by COBS (consistent overhead byte stuffing), which takes all zeros out of it, and
followed by one zero byte, the delimiter. Stuffing adds one byte, and one more for each further 254 bytes.

To decode, collect bytes up to a zero. Then read a code byte c and copy the c - 1 bytes after it; if c is less than
255 and the frame is not used up, append a zero; repeat until it is used up. Drop a frame that ends inside a run,
or whose packet is not good; the next one starts after the next zero.
"""
_SLIP = """Each packet is stuffed as in SLIP (RFC 1055): within it `c0` becomes `db dc` and `db` becomes `db dd`. It is
followed by `c0`, the delimiter.

To decode, collect bytes up to a `c0`, and put the two back. Drop a frame with another byte after a `db`, or whose
packet is not good; the next one starts after the next `c0`.
"""


def _delimited(framing: Stuffed, longest: int) -> str:
    delimiter = framing.delimiter.hex()
    return f"""An empty frame means nothing: commands, acknowledgements and housekeeping have a delimiter
(`{delimiter}`) before them too, so that what came before cannot spoil them. No frame from the device is longer than
{longest} bytes without its delimiter."""
