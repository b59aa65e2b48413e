"""Wire time against lengths worked out from the frame formats, and published rates."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.errors import InputError
from lidar_emu.transports.frames import Frame, pack_frames, unpack_frames
from lidar_emu.transports.spec import Kind, PortSpec, check_wire_load, drain_time_s, frame_bits, wire_load

CAN_500K = PortSpec(Kind.CAN, interface="socketcan", channel="can0", bitrate=500_000)
CAN_FD = PortSpec(
    Kind.CAN, interface="socketcan", channel="can0", bitrate=500_000, fd=True, data_bitrate=2_000_000
)


def fd_frame(length: int, **flags: bool) -> Frame:
    return Frame(0x100, bytes(length), is_fd=True, **flags)


@pytest.mark.parametrize(
    ("frame", "slow_bits", "fast_bits"),
    [
        # Davis et al. 2007: 55 + 10 n bits with an 11-bit identifier, 80 + 10 n with 29 bits.
        (Frame(0x100, bytes(0)), 55, 0),
        (Frame(0x100, bytes(8)), 135, 0),
        (Frame(0x100, bytes(0), is_extended=True), 80, 0),
        (Frame(0x100, bytes(8), is_extended=True), 160, 0),
        # Head 17 + 4 stuffed + 12 behind; ESI, DLC, 64 bytes: 517 with 129 stuffed; count and CRC-21: 25 with
        # 7 fixed; delimiter 1.
        (fd_frame(64, bitrate_switch=True), 33, 517 + 129 + 25 + 7 + 1),
        # 8 bytes: 69 with floor(85/4) - 4 = 17 stuffed; count and CRC-17: 21 with 6 fixed; delimiter 1.
        (fd_frame(8, bitrate_switch=True), 33, 69 + 17 + 21 + 6 + 1),
        (fd_frame(8), 33 + 114, 0),
        # 29-bit identifier: head 36 + 8 stuffed + 12; 69 with floor(104/4) - 8 = 18 stuffed.
        (fd_frame(8, bitrate_switch=True, is_extended=True), 56, 69 + 18 + 21 + 6 + 1),
        # There is no FD frame of 9 bytes: it is padded to 12.
        (fd_frame(9, bitrate_switch=True), *frame_bits(fd_frame(12, bitrate_switch=True))),
    ],
)
def test_bits_of_a_frame(frame: Frame, slow_bits: int, fast_bits: int) -> None:
    assert frame_bits(frame) == (slow_bits, fast_bits)


def test_a_serial_byte_is_ten_bits() -> None:
    # 115200 Bd carry 180 packets of 64 bytes a second, 3 MBd 4687.
    assert wire_load(PortSpec(Kind.SERIAL, "/dev/ttyS0", baud=115_200), bytes(64), 180) == pytest.approx(1.0)
    assert wire_load(PortSpec(Kind.PTY, baud=3_000_000), bytes(114), 1111) == pytest.approx(0.422, abs=1e-3)


@pytest.mark.parametrize(
    ("serial_format", "bits"), [("8N1", 10), ("8E1", 11), ("8O1", 11), ("8N2", 11), ("8E2", 12)]
)
def test_parity_and_stop_bits_take_time(serial_format: str, bits: int) -> None:
    line = PortSpec(Kind.SERIAL, "/dev/ttyS0", baud=9600, serial_format=serial_format)
    assert wire_load(line, bytes(96), 10) == pytest.approx(bits / 10)
    assert drain_time_s(line, 960) == pytest.approx(bits / 10)


def test_an_interface_states_the_format_of_a_port_that_has_none() -> None:
    assert PortSpec(Kind.SERIAL).on_line("8E1").serial_format == "8E1"
    assert PortSpec(Kind.SERIAL, serial_format="8N2").on_line("8E1").serial_format == "8N2"


def test_frames_of_a_shot_add_up() -> None:
    payload = pack_frames([Frame(0x100 + k, bytes(8)) for k in range(5)])
    assert wire_load(CAN_500K, payload, 100) == pytest.approx(100 * 5 * 135 / 500e3)
    fd_payload = pack_frames([fd_frame(64, bitrate_switch=True)] * 2)
    assert wire_load(CAN_FD, fd_payload, 100) == pytest.approx(100 * 2 * (33 / 500e3 + 679 / 2e6))


def test_behind_a_bridge_is_the_line_that_was_named() -> None:
    assert wire_load(PortSpec(Kind.UDP, "bridge:5600", baud=115_200), bytes(64), 180) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "spec",
    [
        PortSpec(),
        PortSpec(Kind.UDP, "bridge:5600", baud=0),
        PortSpec(Kind.SERIAL, "socket://localhost:7000", baud=9600),
    ],
)
def test_what_has_no_bit_rate_is_never_full(spec: PortSpec) -> None:
    assert wire_load(spec, bytes(1000), 1e6) == 0
    assert check_wire_load(spec, bytes(1000), 1e6) is None


def test_the_door_lets_pass_warns_and_refuses() -> None:
    line = PortSpec(Kind.SERIAL, "/dev/ttyS0", baud=10_000)
    assert check_wire_load(line, bytes(10), 69) is None
    warning = check_wire_load(line, bytes(10), 99)
    assert warning is not None
    assert "99 %" in warning
    assert check_wire_load(line, bytes(10), 100) is not None
    with pytest.raises(InputError, match="101 %") as refused:
        check_wire_load(line, bytes(10), 101)
    assert (refused.value.where, refused.value.value) == ("--baud", 10_000)


def test_a_bus_that_is_too_slow_is_refused_by_its_bit_rate() -> None:
    payload = pack_frames([Frame(0x100 + k, bytes(8)) for k in range(5)])
    with pytest.raises(InputError, match="5 frames") as refused:
        check_wire_load(CAN_500K, payload, 1111)
    assert refused.value.where == "--bitrate"


FRAMES = st.lists(
    st.builds(
        Frame, st.integers(0, 2**29 - 1), st.binary(max_size=64), st.booleans(), st.booleans(), st.booleans()
    )
)


@given(FRAMES)
def test_frame_records_come_back(frames: list[Frame]) -> None:
    assert unpack_frames(pack_frames(frames)) == frames


@pytest.mark.parametrize("length", [1, 5, 6, 7])
def test_torn_frame_records_are_an_error(length: int) -> None:
    payload = pack_frames([Frame(1, b"ab")])
    with pytest.raises(ValueError, match="records end"):
        unpack_frames(payload[:length])


def test_a_serial_line_takes_its_time_for_what_waits_in_it() -> None:
    assert drain_time_s(PortSpec(Kind.SERIAL, "/dev/ttyS0", baud=9600), 960) == 1.0
    for spec in (PortSpec(), PortSpec(Kind.PTY), PortSpec(Kind.SERIAL, "socket://host:1", baud=9600)):
        assert drain_time_s(spec, 960) == 0.0
