"""Sections and tables of the interface document."""

from __future__ import annotations

from lidar_icd.can_database import decimal_text
from lidar_protocol.definitions import ByteLink, Interface
from lidar_protocol.fields import Codec, Constant, Flag, Number, Real, Time, Value
from lidar_protocol.headers import PlainHeader, SpacePacketHeader
from lidar_protocol.layout import Layout, PlacedField

_HEX_BYTES_PER_LINE = 28


def field_table(layout: Layout, first_byte: int = 0) -> str:
    """Table of the fields of a block, whose bytes are counted from `first_byte`."""
    heading = [
        "| byte | bits | type | name | step | range | none | meaning |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(heading + [_row(placed, layout, first_byte) for placed in layout.placed])


def _row(placed: PlacedField, layout: Layout, first_byte: int) -> str:
    field, codec = placed.field, placed.field.codec
    first, last = placed.first_bit, placed.first_bit + codec.bits - 1
    down = 7 if layout.byte_order == "big" else 0
    meaning = field.meaning if field.beam is None else f"Beam {field.beam}: {field.meaning}"
    cells = (
        f"{first_byte + first // 8}" + (f"-{first_byte + last // 8}" if last // 8 > first // 8 else ""),
        f"{abs(down - first % 8)}" + (f"-{abs(down - last % 8)}" if last > first else ""),
        type_name(codec),
        f"`{field.key}`",
        *_number_cells(codec, field.unit),
        f"{meaning} (section 3, {field.enumeration})" if field.enumeration else meaning,
    )
    return f"| {' | '.join(cells)} |"


def type_name(codec: Codec) -> str:
    """Type of a field, as in the definition."""
    if isinstance(codec, Flag):
        return "bool"
    if isinstance(codec, Time):
        return "cuc"
    if isinstance(codec, Real):
        return f"f{codec.bits}"
    return f"{'i' if codec.signed else 'u'}{codec.bits}"


def _number_cells(codec: Codec, unit: str) -> tuple[str, str, str]:
    if isinstance(codec, Constant):
        return "", f"always 0x{codec.code:X}", ""
    if isinstance(codec, Real):
        limits = f"{codec.lowest:g} to {codec.highest:g}" if abs(codec.highest) < 1e38 else ""
        return unit, f"{limits}, held" if codec.nearest else limits, "NaN"
    if not isinstance(codec, Number):
        return "", "", ""
    step = "1" if codec.whole else f"{decimal_text(1 / codec.steps_per_unit)} {unit}"
    low, high = (decimal_text(limit) for limit in codec.limits)
    codes = [] if codec.none is None else [_hex_code(codec, codec.none)]
    if codec.absent is not None:
        codes.append(f"absent {_hex_code(codec, codec.absent)}")
    return (
        f"{step}, offset {codec.offset}" if codec.offset else step,
        f"{low} to {high}, held" if codec.nearest else f"{low} to {high}",
        ", ".join(codes),
    )


def _hex_code(codec: Number, code: int) -> str:
    return f"`0x{code % (1 << codec.bits):0{(codec.bits + 3) // 4}X}`"


def shown(value: Value) -> str:
    """Format a value of the example."""
    if value is None:
        return "none"
    return str(int(value)) if isinstance(value, bool) else str(value)


def hex_block(data: bytes) -> str:
    """Code block of bytes in hexadecimal."""
    step = _HEX_BYTES_PER_LINE
    return code_block([data[start : start + step].hex(" ") for start in range(0, len(data), step)])


def code_block(lines: list[str]) -> str:
    """Code block of lines."""
    return "\n".join(["```text", *lines, "```"])


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
    digits = crc.bits // 4
    reflected = "reflected in and out" if crc.reflected else "not reflected"
    final = f"final exclusive-or 0x{crc.final_xor:0{digits}X}" if crc.final_xor else "no final exclusive-or"
    text = (
        f"{length}: {name} over {_COVERED[link.covered]}.\n"
        f"Polynomial 0x{crc.polynomial:0{digits}X}, start value 0x{crc.start:0{digits}X}, {reflected}, {final}.\n"
        f"Check value: 0x{crc.check:0{digits}X} for the ASCII text `123456789`."
    )
    if crc.name in _PYTHON:
        text += f" In Python: {_PYTHON[crc.name]}."
    return text
