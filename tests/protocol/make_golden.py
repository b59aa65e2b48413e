"""Writes golden.json: frames computed by hand from the interface document, without the library.

    python tests/protocol/make_golden.py

Every number below the shots is a byte offset, a scale or a code of INTERFACE.md.
"""

from __future__ import annotations

import binascii
import json
import struct
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path
from typing import Any

Shot = dict[str, Any]

INTERFACE_VERSION = 3

MEASURED = {
    "fired": True,
    "range_valid": True,
    "speed_valid": True,
    "sign_resolved": True,
    "segments": 7,
    "reason": 0,
    "returns": 1,
    "snr_db": 34.25,
    "range_m": 2164.784,
    "closing_speed_mps": 92.388,
    "second_range_m": None,
    "sigma_range_m": 0.1401,
    "sigma_speed_mps": 0.00102,
    "residual_mps": -0.0012,
    "beam_angle_deg": 22.5,
    "time_offset_s": 0.0,
    "second_sigma_range_m": None,
    "second_reason": 3,
}
NOTHING = {
    "range_valid": False,
    "speed_valid": False,
    "sign_resolved": False,
    "segments": 0,
    "returns": 0,
    "snr_db": None,
    "range_m": None,
    "closing_speed_mps": None,
    "sigma_range_m": None,
    "sigma_speed_mps": None,
    "residual_mps": None,
}
NOT_FIRED = MEASURED | NOTHING | {"fired": False, "reason": 1, "second_reason": 1}
NOT_FIRED |= {"beam_angle_deg": None, "time_offset_s": None}
HEADER = {
    "time_ns": 1_500_490_773,
    "due_ns": 1_502_900_000,
    "mode": 4,
    "laser_on": True,
    "clock_locked": True,
    "shot": 30,
    "pattern": 0,
}
SHOTS: list[Shot] = [
    {
        "name": "example of the interface document",
        "unit": 0,
        "header": HEADER,
        "beams": [
            MEASURED,
            MEASURED
            | {
                "closing_speed_mps": -46.194,
                "returns": 2,
                "second_range_m": 2171.5,
                "time_offset_s": 0.0009,
                "second_sigma_range_m": 0.205,
                "second_reason": 0,
            },
            MEASURED | NOTHING | {"segments": 5, "reason": 3, "snr_db": 11.5, "time_offset_s": 0.0018},
            NOT_FIRED,
        ],
    },
    {
        "name": "all zero: one beam, the first shot, the epoch itself",
        "unit": 0,
        "header": HEADER
        | {"time_ns": 0, "due_ns": 0, "mode": 0, "laser_on": False, "clock_locked": False, "shot": 0},
        "beams": [MEASURED | NOTHING | {"fired": True, "range_m": 0.0, "beam_angle_deg": 0.0}],
    },
    {
        "name": "last unit, highest values that all sets can carry",
        "unit": 15,
        "header": HEADER
        | {"time_ns": 4_294_967_295_999_999_940, "due_ns": 2_000_000_000, "shot": 2**32 - 1, "pattern": 255},
        "beams": [
            MEASURED
            | {
                "range_m": 16777.213,
                "closing_speed_mps": 838.8607,
                "second_range_m": 20971.5,
                "second_sigma_range_m": 1.27,
                "second_reason": 0,
                "snr_db": 62.0,
                "returns": 15,
                "sigma_range_m": 6.5534,
                "sigma_speed_mps": 0.65534,
                "residual_mps": 3.2767,
                "beam_angle_deg": 90.0,
                "time_offset_s": 0.13107,
            },
            MEASURED | {"closing_speed_mps": -838.8606, "residual_mps": -3.2767, "snr_db": 0.0},
        ],
    },
    {
        "name": "eight beams, sequence count wrapped",
        "unit": 3,
        "header": HEADER | {"shot": 70_000},
        "beams": [MEASURED | {"range_m": 1000.001 + k, "time_offset_s": k * 0.0009} for k in range(8)],
    },
]


def main() -> None:
    """Compute every shot and write the file."""
    shots = [shot | encoded(shot) for shot in SHOTS]
    target = Path(__file__).with_name("golden.json")
    target.write_text(json.dumps(shots, indent=1) + "\n", encoding="utf-8")


def encoded(shot: Shot) -> dict[str, Any]:
    """The shot on every link."""
    packet = packet_of(shot)
    sets = {
        name: [[can_id, data.hex()] for can_id, data in frames(shot)] for name, frames in CAN_SETS.items()
    }
    return {"packet": packet.hex(), "frame": (b"\0" + stuffed(packet) + b"\0").hex(), "can": sets}


def packet_of(shot: Shot) -> bytes:
    """Primary header, header fields, beam blocks and CRC."""
    body = packet_header(shot) + b"".join(beam_block(beam) for beam in shot["beams"])
    count = shot["header"]["shot"] & 0x3FFF
    packet = struct.pack(">HHH", 0x0800 | 0x2A0 + shot["unit"], 0xC000 | count, len(body) + 2 - 1) + body
    return packet + struct.pack(">H", binascii.crc_hqx(packet, 0xFFFF))


def packet_header(shot: Shot) -> bytes:
    """The 23 bytes after the primary header."""
    header = shot["header"]
    status = header["laser_on"] << 1 | header["clock_locked"]
    numbers = struct.pack(
        ">BBBBIB",
        INTERFACE_VERSION,
        header["mode"],
        status,
        len(shot["beams"]),
        header["shot"],
        header["pattern"],
    )
    return cuc(header["time_ns"]) + cuc(header["due_ns"]) + numbers


def cuc(time_ns: int) -> bytes:
    """Seconds and 2**-24 s."""
    seconds, rest = divmod(time_ns, 10**9)
    fraction = int((Decimal(rest) * 2**24 / 10**9).to_integral_value(ROUND_HALF_UP))
    return struct.pack(">I", seconds) + struct.pack(">I", fraction)[1:]


def beam_block(beam: dict[str, Any]) -> bytes:
    """The 31 bytes of a beam."""
    return struct.pack(
        ">BBhIiIHHhHIHB",
        beam["fired"] << 7 | flags(beam) << 4 | beam["segments"],
        beam["reason"] << 4 | beam["returns"],
        steps(beam["snr_db"], "0.01", -0x8000),
        steps(beam["range_m"], "0.001", 0xFFFFFFFF),
        steps(beam["closing_speed_mps"], "0.0001", -0x80000000),
        steps(beam["second_range_m"], "0.001", 0xFFFFFFFF),
        steps(beam["sigma_range_m"], "0.0001", 0xFFFF),
        steps(beam["sigma_speed_mps"], "0.00001", 0xFFFF),
        steps(beam["residual_mps"], "0.0001", -0x8000),
        steps(beam["beam_angle_deg"], "0.01", 0xFFFF),
        steps(beam["time_offset_s"], "0.000001", 0xFFFFFFFF),
        steps(beam["second_sigma_range_m"], "0.0001", 0xFFFF),
        beam["second_reason"],
    )


def flags(beam: dict[str, Any]) -> int:
    """Three flags, the range's first."""
    return beam["range_valid"] << 2 | beam["speed_valid"] << 1 | beam["sign_resolved"]


def steps(value: float | None, step: str, none: int) -> int:
    """A value in steps; the code where there is none."""
    if value is None:
        return none
    return int((Decimal(repr(value)) / Decimal(step)).to_integral_value(ROUND_HALF_UP))


def stuffed(data: bytes) -> bytes:
    """COBS, one byte after the other."""
    out, code_at, code = bytearray(1), 0, 1
    for position, byte in enumerate(data):
        if byte:
            out.append(byte)
            code += 1
        if not byte or (code == 255 and position < len(data) - 1):
            out[code_at] = code
            code_at, code = len(out), 1
            out.append(0)
    out[code_at] = code
    return bytes(out)


def base(shot: Shot) -> int:
    """First identifier of the unit."""
    return 0x100 + 0x40 * shot["unit"]


def core(shot: Shot, details: int = 0) -> list[tuple[int, bytes]]:
    """Header and one message for each beam."""
    counter, beams = shot["header"]["shot"] & 15, shot["beams"]
    first = counter << 4 | details << 3 | len(beams) - 1
    messages = [(base(shot), bytes((first,)) + cuc(shot["header"]["time_ns"]))]
    return messages + [(base(shot) + 8 + slot, core_beam(counter, beam)) for slot, beam in enumerate(beams)]


def core_beam(counter: int, beam: dict[str, Any]) -> bytes:
    """Counter, flags, segments, SNR, range and closing speed."""
    if not beam["fired"]:
        return bytes((counter << 4, 0x3F)) + bytes.fromhex("fffffe 800001")
    word = counter << 12 | flags(beam) << 9 | beam["segments"] << 6 | steps(beam["snr_db"], "1", 0x3F)
    range_mm = steps(beam["range_m"], "0.001", 0xFFFFFF)
    speed = steps(beam["closing_speed_mps"], "0.0001", -0x800000)
    return struct.pack(">H", word) + struct.pack(">I", range_mm)[1:] + struct.pack(">i", speed)[1:]


def full(shot: Shot) -> list[tuple[int, bytes]]:
    """The core set with the rest of the packet around it."""
    header, counter = shot["header"], (shot["header"]["shot"] & 15) << 4
    status = bytes((counter | header["laser_on"] << 1 | header["clock_locked"],)) + cuc(header["due_ns"])
    numbers = counter | header["mode"], INTERFACE_VERSION, header["shot"], header["pattern"]
    number = struct.pack(">BBIB", *numbers)
    first, *beams = core(shot, details=1)
    messages = [first, (base(shot) + 1, status), (base(shot) + 2, number), *beams]
    for slot, beam in enumerate(shot["beams"]):
        messages.append((base(shot) + 0x10 + slot, quality(counter, beam)))
    for slot, beam in enumerate(shot["beams"]):
        messages.append((base(shot) + 0x18 + slot, geometry(counter, beam)))
    return messages


def quality(counter: int, beam: dict[str, Any]) -> bytes:
    """Reasons, returns, sigmas and residual: as in the beam block."""
    block = beam_block(beam)
    return bytes((counter | beam["reason"], beam["returns"] << 4 | beam["second_reason"])) + block[16:22]


def geometry(counter: int, beam: dict[str, Any]) -> bytes:
    """Time offset, angle, second range and its sigma."""
    word = counter >> 4
    word = word << 17 | steps(beam["time_offset_s"], "0.000001", 0x1FFFF)
    word = word << 14 | steps(beam["beam_angle_deg"], "0.01", 0x3FFF)
    word = word << 21 | steps(beam["second_range_m"], "0.01", 0x1FFFFF)
    return struct.pack(">Q", word << 8 | steps(beam["second_sigma_range_m"], "0.005", 0xFF))


def fd(shot: Shot) -> list[tuple[int, bytes]]:
    """The packet's header and beam blocks, each in a frame."""
    counter = bytes(((shot["header"]["shot"] & 15) << 4,))
    messages = [(base(shot) + 0x20, counter + packet_header(shot))]
    return messages + [
        (base(shot) + 0x28 + slot, counter + beam_block(beam)) for slot, beam in enumerate(shot["beams"])
    ]


CAN_SETS = {"core": core, "full": full, "fd": fd}

if __name__ == "__main__":
    main()
