"""The byte stream of a run through two other people's decoders of CCSDS space packets."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import ccsdspy
import handwritten
import numpy as np
from ccsdspy import PacketField
from programs import FarEnd, Program
from spacepackets.ccsds import SpacePacketHeader
from spacepackets.ccsds.spacepacket import PacketType, SequenceFlags

from lidar_emu.measurement import Measurement

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]

# INTERFACE.md, section 2: name, type, bits, step, code for no value.
HEADER = [("seconds", "uint", 32), ("fraction", "uint", 24), ("due_seconds", "uint", 32), ("due_fraction", "uint", 24),
          ("interface_version", "uint", 8), ("mode", "uint", 8), ("unused", "uint", 6), ("laser_on", "uint", 1),
          ("clock_locked", "uint", 1), ("beam_count", "uint", 8), ("shot", "uint", 32),
          ("pattern", "uint", 8)]  # fmt: skip
BEAM = [
    ("fired", "uint", 1, None, None),
    ("range_valid", "uint", 1, None, None),
    ("speed_valid", "uint", 1, None, None),
    ("sign_resolved", "uint", 1, None, None),
    ("unused", "uint", 1, None, None),
    ("segments", "uint", 3, None, None),
    ("reason", "uint", 4, None, None),
    ("returns", "uint", 4, None, None),
    ("snr_db", "int", 16, 0.01, -0x8000),
    ("range_m", "uint", 32, 0.001, 0xFFFFFFFF),
    ("closing_speed_mps", "int", 32, 0.0001, -0x80000000),
    ("second_range_m", "uint", 32, 0.001, 0xFFFFFFFF),
    ("sigma_range_m", "uint", 16, 0.0001, 0xFFFF),
    ("sigma_speed_mps", "uint", 16, 0.00001, 0xFFFF),
    ("residual_mps", "int", 16, 0.0001, -0x8000),
    ("beam_angle_deg", "uint", 16, 0.01, 0xFFFF),
    ("time_offset_s", "uint", 32, 1e-6, 0xFFFFFFFF),
    ("second_sigma_range_m", "uint", 16, 0.0001, 0xFFFF),
    ("spare", "uint", 4, None, None),
    ("second_reason", "uint", 4, None, None),
]


def packets_of(start: Start, far_end: FarEnd, *arguments: str) -> list[bytes]:
    """The shots that a run sends."""
    start("run", *arguments, "--port", far_end.path, "--baud", "3000000", "--pace", "max").succeed()
    return handwritten.shots(far_end.data)


def columns_of(packets: list[bytes], beams: int) -> dict[str, Any]:
    fields = [PacketField(name, kind, bits) for name, kind, bits in HEADER]
    for k in range(beams):
        fields += [PacketField(f"{name}_{k}", kind, bits) for name, kind, bits, _, _ in BEAM]
    fields.append(PacketField("crc", "uint", 16))
    columns: dict[str, Any] = ccsdspy.FixedLength(fields).load(
        io.BytesIO(b"".join(packets)), include_primary_header=True
    )
    return columns


def test_spacepackets_reads_every_header(start: Start, far_end: FarEnd) -> None:
    packets = packets_of(start, far_end, "descent.yaml", "--set", "wire.unit=5")
    assert len(packets) == 1008
    for k, packet in enumerate(packets):
        header = SpacePacketHeader.unpack(packet)
        assert (header.ccsds_version, header.packet_type, header.sec_header_flag) == (0, PacketType.TM, True)
        assert header.apid == 0x2A5
        assert header.seq_flags == SequenceFlags.UNSEGMENTED
        assert header.seq_count == k
        assert header.packet_len == len(packet) == 155


def test_ccsdspy_reads_every_value(start: Start, far_end: FarEnd, simulated: Simulated) -> None:
    columns = columns_of(packets_of(start, far_end, "descent.yaml"), beams=4)
    expected = simulated("descent.yaml")
    np.testing.assert_array_equal(columns["shot"], expected.shot)
    for name, value in (("CCSDS_APID", 0x2A0), ("interface_version", 3), ("mode", 4), ("laser_on", 1)):
        assert set(columns[name]) == {value}
    for name, column_ns in (("", expected.time_ns[:, 0]), ("due_", expected.due_ns)):
        received_s = columns[f"{name}seconds"] + columns[f"{name}fraction"] / 2**24
        np.testing.assert_allclose(received_s, column_ns * 1e-9, rtol=0, atol=0.5 * 2**-24 + 1e-12)
    for k in range(4):
        for name, _, _, step, none in BEAM:
            received = columns[f"{name}_{k}"]
            if name in ("unused", "spare"):
                assert not received.any()
            elif step is None:
                np.testing.assert_array_equal(received, getattr(expected, name)[:, k], name)
            elif name == "time_offset_s":
                assert not received.any(), "all beams fire together"
            else:
                values = np.where(received == none, np.nan, received.astype(np.float64) * step)
                atol = 0.5 * step * (1 + 1e-6)
                np.testing.assert_allclose(
                    values, getattr(expected, name)[:, k], rtol=0, atol=atol, err_msg=name
                )
