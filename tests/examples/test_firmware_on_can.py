"""The firmware of examples/flight_processor, built for this machine, takes a shot on CAN whole or not at all."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidar_emu import Measurement, load, simulate
from lidar_emu.wire import Encoder
from lidar_protocol import CanCommandReader, CanFrame, HostMessage, default_interface

ROOT = Path(__file__).resolve().parents[2]
FIRMWARE, HEADER = ROOT / "examples" / "flight_processor" / "src", ROOT / "protocol" / "lidar_protocol"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
STRICT = ["-std=c99", "-pedantic", "-O1", "-Wall", "-Wextra", "-Werror", "-fsanitize=undefined,address"]
SHOTS, STRUCK = 24, 5
BEAMS, QUALITIES = slice(3, 7), slice(7, 11)
TRUST = default_interface().enumerations["trust"]
NOT_NEEDED = [1, *range(15)[QUALITIES]]  # status and quality

pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler")
Frames = list[list[CanFrame]]


@pytest.fixture(scope="module")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("firmware") / "firmware"
    sources = [FIRMWARE / f"{name}.c" for name in ("can", "flight", "navigation", "report")]
    command = [str(COMPILER), *STRICT, "-DLIDAR_MAXIMUM_BEAMS=4", f"-I{FIRMWARE}", f"-I{HEADER}"]
    board = Path(__file__).with_name("frames_from_stdin.c")
    subprocess.run([*command, *map(str, sources), str(board), "-o", str(program)], check=True)
    return program


@pytest.fixture(scope="module")
def run() -> Measurement:
    return simulate(load("descent.yaml"))


@pytest.fixture(scope="module")
def ranges_mm(run: Measurement) -> list[list[str]]:
    """Ranges of each shot as the firmware prints them."""
    return [
        [
            f"{np.floor(value * 1000 + 0.5):.0f}" if valid else "none"
            for value, valid in zip(*row, strict=True)
        ]
        for row in zip(run.range_m[:SHOTS], run.range_valid[:SHOTS], strict=True)
    ]


@pytest.fixture
def frames(run: Measurement) -> Frames:
    """Frames of each shot, in the order in which they are sent."""
    encoder = Encoder(load("descent.yaml").wire, can=True, fd=False, beam_count=run.beam_count)
    packets = [packet for packet, _ in zip(encoder.packets(run), range(SHOTS), strict=False)]
    return [[frame for frame in packet if isinstance(frame, CanFrame)] for packet in packets]


def reported(firmware: Path, frames: Frames, word: str = "shot") -> list[list[str]]:
    """Words of the lines of shots, or of frames that were sent."""
    records = [
        frame.can_id.to_bytes(2, "big") + bytes([len(frame.data)]) + frame.data.ljust(8, b"\0")
        for shot in frames
        for frame in shot
    ]
    done = subprocess.run([str(firmware)], input=b"".join(records), capture_output=True, check=True)
    return [line.split() for line in done.stdout.decode().splitlines() if line.startswith(f"{word} ")]


def assert_all_but(shots: list[list[str]], lost: set[int], ranges_mm: list[list[str]]) -> None:
    received = [number for number in range(SHOTS) if number not in lost]
    assert [int(shot[1]) for shot in shots] == received
    assert [shot[4:8] for shot in shots] == [ranges_mm[number] for number in received]
    assert int(shots[-1][16]) == len(lost)


@pytest.mark.parametrize("missing", range(15))
def test_a_missing_frame(missing: int, firmware: Path, frames: Frames, ranges_mm: list[list[str]]) -> None:
    assert len(frames[STRUCK]) == 15
    del frames[STRUCK][missing]
    shots = reported(firmware, frames)
    is_needed = missing not in NOT_NEEDED
    assert_all_but(shots, {STRUCK} if is_needed else set(), ranges_mm)
    assert (int(shots[-1][17]) > 0) == is_needed


def test_frames_of_two_shots_are_not_mixed(
    firmware: Path, frames: Frames, ranges_mm: list[list[str]]
) -> None:
    """A beam of the next shot comes where one of this shot is missing."""
    del frames[STRUCK][BEAMS.start :]
    del frames[STRUCK + 1][: BEAMS.start]
    assert_all_but(reported(firmware, frames), {STRUCK, STRUCK + 1}, ranges_mm)


def test_a_frame_that_is_not_awaited_ends_a_shot(
    firmware: Path, frames: Frames, ranges_mm: list[list[str]]
) -> None:
    """Sixteen shots later, when the counter is the same, nothing is added to it."""
    del frames[STRUCK][BEAMS.start :]
    for shot in range(STRUCK + 1, STRUCK + 16):
        frames[shot] = frames[shot][BEAMS]
    del frames[STRUCK + 16][: BEAMS.start]
    assert_all_but(reported(firmware, frames), set(range(STRUCK, STRUCK + 17)), ranges_mm)


def test_solutions_are_sent_back(firmware: Path, run: Measurement, frames: Frames) -> None:
    """One for each shot but the last, whose frames the end of the input cuts off; commands are sent between them."""
    reader, found = CanCommandReader(default_interface()), list[Any]()
    for _, can_id, data in reported(firmware, frames, "sent"):
        found += reader.feed(int(can_id), bytes.fromhex(data))
    solutions = [each for each in found if isinstance(each, HostMessage)]
    assert len(solutions) == SHOTS - 1
    assert reader.counters.incomplete == reader.counters.rejected == 0
    assert [each.sequence for each in solutions] == [*range(SHOTS - 1)]
    for shot, each in enumerate(solutions):
        height_m = (run.range_m[shot] * np.cos(np.radians(run.beam_angle_deg[shot])))[
            run.range_valid[shot]
        ].mean()
        assert each.values["altitude_m"] == pytest.approx(height_m, abs=0.002)
        is_solved = run.speed_valid[shot].sum() >= 3
        expected = pytest.approx(run.velocity_site_mps[shot, 2], abs=0.5) if is_solved else None
        assert each.values["velocity_up_mps"] == expected
        assert each.values["time_ns"] == pytest.approx(run.time_ns[shot, 0], abs=60)
        speed_word = "used" if is_solved else "excluded"
        for what, valid, word in (
            ("range", run.range_valid[shot], "used"),
            ("speed", run.speed_valid[shot], speed_word),
        ):
            words = [word if good else "invalid" for good in valid] + ["not_judged"] * 4
            stated = [each.values[f"{what}_trust_{beam}"] for beam in range(8)]
            assert stated == [TRUST[word] for word in words]
        assert each.values["velocity_east_mps"] is each.values["sigma_altitude_m"] is None


def test_a_frame_of_another_length_is_not_taken(
    firmware: Path, frames: Frames, ranges_mm: list[list[str]]
) -> None:
    beam = frames[STRUCK][BEAMS.start]
    frames[STRUCK][BEAMS.start] = CanFrame(beam.can_id, beam.data[:7])
    assert_all_but(reported(firmware, frames), {STRUCK}, ranges_mm)
