"""The same scenario and seed give the same bytes, however, where to and how late they are sent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import handwritten
import pytest
from mcap.reader import make_reader
from programs import FarEnd, Program

import lidar_emu
from lidar_emu.session import Session
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder

SHOTS, RATE_HZ = 200, 100
FAST = ["descent.yaml", "--set", f"timing.rate_hz={RATE_HZ}", "--duration", str(SHOTS / RATE_HZ)]
SHOTS_ALONE = ["--set", "device.housekeeping_rate_hz=0"]

Start = Callable[..., Program]


def in_blocks(block_shots: int, **overrides: str) -> list[Any]:
    """The packets of a descent, computed in this process."""
    scenario = lidar_emu.load("descent.yaml", {k.replace("__", "."): v for k, v in overrides.items()})
    session = Session(build_model(scenario), Encoder(scenario.wire, False, False, 4))
    packets: list[Any] = []
    while (block := session.shoot(block_shots)) is not None:
        packets += block.packets
    return packets


def computed(shots: int = SHOTS) -> list[Any]:
    """The first packets of FAST."""
    packets = in_blocks(128, timing__rate_hz=str(RATE_HZ), duration_s=str(shots / RATE_HZ))
    assert len(packets) == shots
    return packets


def recorded(file: Path, topic: str) -> list[bytes]:
    """What a recording holds under a topic, read by the mcap library."""
    with file.open("rb") as stream:
        return [message.data for _, _, message in make_reader(stream).iter_messages(topics=[topic])]


@pytest.fixture
def sent_bytes(start: Start, far_end: FarEnd) -> Callable[..., bytes]:
    """The shots that a run of FAST sends to a serial port."""

    def run(*options: str) -> bytes:
        far_end.data.clear()
        start("run", *FAST, *SHOTS_ALONE, "--port", far_end.path, "--baud", "921600", *options).succeed()
        return bytes(far_end.data)

    return run


@pytest.mark.slow
def test_blocks_do_not_matter() -> None:
    reference = in_blocks(128)
    assert len(reference) == 1008
    assert len({handwritten.rows(packet)[0]["beam_angle_deg"] for packet in reference}) == 2, (
        "the beams switch"
    )
    assert in_blocks(1) == reference
    assert in_blocks(7) == reference


@pytest.mark.slow
def test_neither_pace_nor_repetition_nor_link_matters(
    sent_bytes: Callable[..., bytes], start: Start, tmp_path: Path
) -> None:
    reference = b"".join(computed())
    assert sent_bytes("--pace", "max") == reference
    assert sent_bytes("--pace", "max") == reference
    start("run", *FAST, "--pace", "max", "--record", "loopback.mcap").succeed()
    assert b"".join(recorded(tmp_path / "loopback.mcap", "/packet")) == reference


@pytest.mark.slow
def test_the_pace_of_the_clock_sends_the_same(sent_bytes: Callable[..., bytes]) -> None:
    """No shot is late, and the terminal has room for all of them, whether or not its far end reads in time."""
    stream = sent_bytes("--duration", "1", "--set", "timing.late_after_s=3600")
    assert stream == b"".join(computed(RATE_HZ))


@pytest.mark.parametrize(("fd", "can_messages"), [(False, "core"), (False, "full"), (True, "full")])
def test_two_units_on_can_differ_in_their_identifiers_alone(fd: bool, can_messages: str) -> None:
    def frames(unit: int) -> list[tuple[int, bytes, bool]]:
        overrides = {"wire.unit": str(unit), "wire.can_messages": can_messages, "duration_s": "1"}
        scenario = lidar_emu.load("descent.yaml", overrides)
        block = Session(build_model(scenario), Encoder(scenario.wire, True, fd, 4)).shoot(128)
        assert block is not None
        packets: list[Any] = block.packets
        return [(frame.can_id, frame.data, frame.is_fd) for packet in packets for frame in packet]

    shifted = [(can_id + 0x40, data, is_fd) for can_id, data, is_fd in frames(0)]
    assert frames(1) == shifted
