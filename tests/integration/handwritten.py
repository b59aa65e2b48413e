"""The byte link by hand: offsets typed from INTERFACE.md, nothing imported but the standard library.

What a flight-software team would write on its first day. It shares no line with the project, so that a mistake
on one side shows.
"""

from __future__ import annotations

import binascii
import struct
from typing import Any

HEAD = struct.Struct(">HHH7s7sBBBBIB")
BEAM = struct.Struct(">BBhIiIHHhHIHB")
SHOT_APID = 0x2A0


def unstuffed(stream: bytes | bytearray) -> list[bytes]:
    """Space packets of a byte stream that ends with a delimiter; what is damaged stops the test."""
    *frames, rest = bytes(stream).split(b"\0")
    assert rest == b"", "the stream ends inside a packet"
    packets = [_unstuff(frame) for frame in frames if frame]
    for packet in packets:
        assert len(packet) == struct.unpack_from(">H", packet, 4)[0] + 7
        assert binascii.crc_hqx(packet, 0xFFFF) == 0
    return packets


def shots(stream: bytes | bytearray) -> list[bytes]:
    """The space packets of shots, of any unit: housekeeping and acknowledgements have other APIDs."""
    return [
        packet for packet in unstuffed(stream) if struct.unpack_from(">H", packet)[0] & 0x7F0 == SHOT_APID
    ]


def _unstuff(frame: bytes) -> bytes:
    packet, place = bytearray(), 0
    while place < len(frame):
        code = frame[place]
        assert len(frame) >= place + code, "the frame ends inside a run"
        packet += frame[place + 1 : place + code]
        place += code
        if code < 255 and place < len(frame):
            packet.append(0)
    return bytes(packet)


def decoded(packet: bytes) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Header and beams of a space packet; None where there is no value."""
    words = HEAD.unpack_from(packet)
    header = {
        "apid": words[0] & 0x7FF,
        "sequence_count": words[1] & 0x3FFF,
        "time_ns": _nanoseconds(words[3]),
        "due_ns": _nanoseconds(words[4]),
        "interface_version": words[5],
        "mode": words[6],
        "laser_on": bool(words[7] & 2),
        "clock_locked": bool(words[7] & 1),
        "shot": words[9],
        "pattern": words[10],
    }
    beams = [_beam(words[9], k, *BEAM.unpack_from(packet, 29 + 31 * k)) for k in range(words[8])]
    return header, beams


def rows(stream: bytes | bytearray) -> list[dict[str, Any]]:
    """All beams of a byte stream."""
    return [beam for packet in shots(stream) for beam in decoded(packet)[1]]


def _beam(
    shot: int, beam: int, flags: int, why: int, snr: int, distance: int, speed: int, second: int,
    sigma_distance: int, sigma_speed: int, residual: int, angle: int, offset: int,
    sigma_second: int, why_second: int,
) -> dict[str, Any]:  # fmt: skip
    return {
        "shot": shot,
        "beam": beam,
        "fired": bool(flags & 0x80),
        "range_valid": bool(flags & 0x40),
        "speed_valid": bool(flags & 0x20),
        "sign_resolved": bool(flags & 0x10),
        "segments": flags & 7,
        "reason": why >> 4,
        "returns": why & 15,
        "snr_db": None if snr == -0x8000 else snr / 100,
        "range_m": None if distance == 0xFFFFFFFF else distance / 1000,
        "closing_speed_mps": None if speed == -0x80000000 else speed / 10_000,
        "second_range_m": None if second == 0xFFFFFFFF else second / 1000,
        "sigma_range_m": None if sigma_distance == 0xFFFF else sigma_distance / 10_000,
        "sigma_speed_mps": None if sigma_speed == 0xFFFF else sigma_speed / 100_000,
        "residual_mps": None if residual == -0x8000 else residual / 10_000,
        "beam_angle_deg": None if angle == 0xFFFF else angle / 100,
        "time_offset_s": None if offset == 0xFFFFFFFF else offset / 1e6,
        "second_sigma_range_m": None if sigma_second == 0xFFFF else sigma_second / 10_000,
        "second_reason": why_second & 15,
    }


def _nanoseconds(code: bytes) -> int:
    return round(int.from_bytes(code, "big") * 10**9 / 2**24)
