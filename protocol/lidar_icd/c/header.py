"""Generate a host in C: one header that decodes packets of a device and encodes commands (C99, freestanding)."""

from __future__ import annotations

from string import Template

from lidar_icd.c.decoder import block_text, comment_text, decoder_text, shipped_text
from lidar_icd.c.encoder import commands_text
from lidar_icd.framings import framing_text
from lidar_protocol.crc import Crc, table_of
from lidar_protocol.definitions import CanBlock, CanMessage, Interface


def _beams(interface: Interface) -> str:
    packet = interface.packet
    if packet.beam is None:
        return f"#define LIDAR_MAXIMUM_BEAMS {max(1, packet.beams_in_header)}u"
    most = f"{packet.maximum_beams}u"
    return f"""#ifndef LIDAR_MAXIMUM_BEAMS
#define LIDAR_MAXIMUM_BEAMS {most}
#endif
#if LIDAR_MAXIMUM_BEAMS < 1 || LIDAR_MAXIMUM_BEAMS > {most}
#error "LIDAR_MAXIMUM_BEAMS must be 1 to {packet.maximum_beams}"
#endif"""


def _longest_packet(interface: Interface) -> list[str]:
    if interface.packet.beam is None:
        return [f"#define LIDAR_LONGEST_PACKET {interface.maximum_packet_bytes}u"]
    other = f"{max((layout.length for layout in interface.replies.values()), default=0)}u"
    body = "(LIDAR_SHOT_BYTES + LIDAR_MAXIMUM_BEAMS * LIDAR_BEAM_BYTES)"
    return [
        f"#define LIDAR_LONGEST_BODY ({body} > {other} ? {body} : {other})",
        "#define LIDAR_LONGEST_PACKET (LIDAR_HEADER_BYTES + LIDAR_LONGEST_BODY + LIDAR_CRC_BYTES)",
    ]


def c_header(interface: Interface) -> str:
    """Generate the header. All names start with `lidar`."""
    framing = framing_text(interface.link.framing)
    words = "\n".join(
        f"#define LIDAR_{name.upper()}_{word.upper()} {value}u"
        for name, words in interface.enumerations.items()
        for word, value in words.items()
        if word.isidentifier()
    )
    parts = [_constants(interface), words, *_blocks(interface)]
    options = [" * LIDAR_USE_FLOAT: lidar_real is float instead of double."]
    if interface.packet.beam is not None:
        limits = f"1 to {interface.packet.maximum_beams}. Measurement and receiver shrink with it"
        options.insert(0, f" * LIDAR_MAXIMUM_BEAMS: {limits}; packets of more beams are refused.")
    return Template(shipped_text("header_template.h")).substitute(
        name=comment_text(interface.name),
        version=interface.version,
        epoch=comment_text(interface.epoch),
        command=_usage_of_commands(interface),
        options="\n".join(options),
        definitions="\n\n".join(parts),
        bits=shipped_text(f"bits_{interface.byte_order}.h"),
        crc="\n\n".join(filter(None, (framing.c_head, _crc(interface.link.crc)))),
        reading=decoder_text(interface),
        framing="\n\n".join(filter(None, (*map(shipped_text, framing.c_files), commands_text(interface)))),
    )


def _usage_of_commands(interface: Interface) -> str:
    if interface.commands is None:
        return ""
    messages = """
 * lidar_encode_...(frame, unit, &message) does so with another message, in a buffer of LIDAR_LONGEST_MESSAGE bytes.
 * On CAN lidar_pack_can_...(data, &message) fills one of its frames, all of which are sent, in the order of their
 * functions.
 *"""
    return f"""
 *
 * lidar_encode_...(frame, unit, sequence, ...) writes a framed command to `frame`, a buffer of
 * LIDAR_LONGEST_COMMAND bytes, and returns the number of bytes: 0 if an argument is out of range.
 *{messages if interface.commands.messages else ""}"""


def _constants(interface: Interface) -> str:
    link = interface.link
    return "\n".join(
        [
            f"#define LIDAR_INTERFACE_VERSION {interface.version}u",
            f"#define LIDAR_UNITS {interface.units}u",
            _beams(interface),
            f"#define LIDAR_HEADER_BYTES {link.header.length}u",
            f"#define LIDAR_CRC_BYTES {link.crc_length}u",
            *_longest_packet(interface),
            f"#define LIDAR_LONGEST_FRAME {framing_text(link.framing).c_longest_frame}",
            *_can_constants(interface),
        ]
    )


def _can_constants(interface: Interface) -> list[str]:
    can = interface.can
    if can is None:
        return []
    lines = [
        f"#define LIDAR_CAN_UNIT_STRIDE 0x{can.unit_stride:X}u",
        f"#define LIDAR_CAN_BEAM_SLOTS {can.beam_slots}u",
    ]
    blocks: list[CanMessage | CanBlock] = [*can.messages, *can.blocks]
    return lines + [f"#define LIDAR_CAN_ID_{each.name.upper()} 0x{can.can_id(0, each):X}u" for each in blocks]


def _blocks(interface: Interface) -> list[str]:
    packet, can = interface.packet, interface.can
    blocks = [("shot", packet.header), ("beam", packet.beam)]
    blocks += [("acknowledge", interface.acknowledge), ("housekeeping", interface.housekeeping)]
    if can is not None:
        blocks += [(f"can_{message.name}", message.layout) for message in can.messages]
        if can.acknowledge:
            blocks.append(("can_acknowledge", can.acknowledge.layout))
        blocks += [(f"can_{block.name}", block.layout) for block in can.housekeeping]
    return [block_text(name, layout) for name, layout in blocks if layout is not None]


def _crc(crc: Crc | None) -> str:
    if crc is None:
        return ""
    kind = f"uint{crc.bits}_t"
    digits = crc.bits // 4
    entries = [f"0x{entry:0{digits}X}u" for entry in table_of(crc)]
    table = ",\n".join("        " + ", ".join(entries[k : k + 8]) for k in range(0, 256, 8))
    if crc.bits == 8:
        step = "table[crc ^ data[k]]"
    elif crc.reflected:
        step = f"({kind})(crc >> 8) ^ table[(crc ^ data[k]) & 0xFFu]"
    else:
        step = f"({kind})(crc << 8) ^ table[(crc >> {crc.bits - 8} ^ data[k]) & 0xFFu]"
    return f"""/* {crc.name}; 0x{crc.check:0{digits}X} for "123456789". Start with LIDAR_CRC_START. */
#define LIDAR_CRC_START 0x{crc.start ^ crc.final_xor:X}u
static inline {kind} lidar_crc({kind} crc, const uint8_t *data, size_t length) {{
    static const {kind} table[256] = {{
{table}
    }};
    crc ^= 0x{crc.final_xor:X}u;
    for (size_t k = 0u; k < length; k++)
        crc = ({kind})({step});
    return crc ^ 0x{crc.final_xor:X}u;
}}"""
