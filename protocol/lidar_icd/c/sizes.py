"""Generate the sizes of packets and frames in C; the longest follow from how many beams a host has memory for."""

from __future__ import annotations

from lidar_icd.framings import framing_text
from lidar_protocol.definitions import Interface


def sizes_text(interface: Interface) -> str:
    """Constants: beams, lengths of headers, and the longest packet and frame from the device."""
    link = interface.link
    return "\n".join(
        [
            _beams(interface),
            f"#define LIDAR_HEADER_BYTES {link.header.length}u",
            f"#define LIDAR_CRC_BYTES {link.crc_length}u",
            *_longest_packet(interface),
            f"#define LIDAR_LONGEST_FRAME {framing_text(interface.link.framing).c_longest_frame}",
        ]
    )


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
    layouts = (interface.acknowledge, interface.housekeeping)
    other = f"{max((layout.length for layout in layouts if layout is not None), default=0)}u"
    body = "(LIDAR_SHOT_BYTES + LIDAR_MAXIMUM_BEAMS * LIDAR_BEAM_BYTES)"
    return [
        f"#define LIDAR_LONGEST_BODY ({body} > {other} ? {body} : {other})",
        "#define LIDAR_LONGEST_PACKET (LIDAR_HEADER_BYTES + LIDAR_LONGEST_BODY + LIDAR_CRC_BYTES)",
    ]
