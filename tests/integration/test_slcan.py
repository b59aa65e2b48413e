"""A run on CAN through python-can's slcan: lines read by hand, frames by cantools with the DBC alone."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import slcan_lines
from comparison import CODES, FLAGS, SERIAL_HELD, SERIAL_STEPS, assert_complete, assert_equal
from programs import LONG_BENCH, FarEnd, Program, listened_beams, read_summary
from waiting import eventually

from lidar_emu.measurement import Measurement

BEAMS = 4
CORE_STEPS = {"snr_db": 1.0, "range_m": 0.001, "closing_speed_mps": 0.0001}
CORE_HELD = {"snr_db": (0.0, 62.0)}
CORE_EXACT = ("range_valid", "speed_valid", "sign_resolved", "segments")
FULL_STEPS = SERIAL_STEPS | CORE_STEPS
FULL_HELD = SERIAL_HELD | CORE_HELD
FULL_EXACT = (*CORE_EXACT, "reason", "returns")

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]


def slcan(path: str, *options: str) -> list[str]:
    return ["-i", "slcan", "-c", path, "--bitrate", "1000000", *options]


def assert_instants_equal(seconds: list[dict[str, Any]], name: str, expected_ns: Any) -> None:
    received_s = np.array([shot[f"{name}_seconds"] + shot[f"{name}_fraction"] for shot in seconds])
    np.testing.assert_allclose(received_s, expected_ns * 1e-9, rtol=0, atol=0.5 * 2**-24 + 1e-12)


@pytest.mark.slow
def test_a_whole_descent_in_the_full_set(
    start: Start, far_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    start("run", "descent.yaml", *slcan(far_end.path), "--pace", "max", "--summary", "s.json").succeed()
    assert b"\rS8\r" in far_end.data, "1 Mbit/s"
    lines = slcan_lines.frames(far_end.data)
    assert {line.kind for line in lines} == {"t"}
    shots = slcan_lines.shots(lines)
    rows = slcan_lines.rows(shots)
    expected = simulated("descent.yaml")
    assert_complete(rows, read_summary(tmp_path / "s.json"), BEAMS)
    assert len(rows) == BEAMS * len(expected)
    assert_equal(rows, expected, FULL_STEPS, FULL_HELD, FULL_EXACT)
    names = ["Header", "Status", "Shot"] + [
        f"{kind}{k}" for kind in ("Beam", "Quality", "Geometry") for k in range(4)
    ]
    assert {tuple(shot["messages"]) for shot in shots} == {tuple(names)}
    assert_instants_equal(shots, "time", expected.time_ns[:, 0])
    assert_instants_equal(shots, "due", expected.due_ns)
    assert {(shot["mode"], shot["interface_version"], shot["details"]) for shot in shots} == {(4, 2, 1)}


@pytest.mark.slow
def test_the_core_set_at_the_pace_of_the_clock(
    start: Start, far_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    options = ["--duration", "2", "--set", "wire.can_messages=core", "--set", "wire.unit=2"]
    start("run", "descent.yaml", *slcan(far_end.path), *options, "--summary", "s.json").succeed()
    shots = slcan_lines.shots(slcan_lines.frames(far_end.data), unit=2)
    rows = slcan_lines.rows(shots)
    assert_complete(rows, read_summary(tmp_path / "s.json"), BEAMS)
    assert_equal(rows, simulated("descent.yaml"), CORE_STEPS, CORE_HELD, CORE_EXACT)
    assert {tuple(shot["messages"]) for shot in shots} == {("Header", "Beam0", "Beam1", "Beam2", "Beam3")}
    assert {shot["details"] for shot in shots} == {0}
    expected = simulated("descent.yaml").time_ns[[row["shot"] for row in rows[::BEAMS]], 0]
    assert_instants_equal(shots, "time", expected)


def test_fd_frames(start: Start, far_end: FarEnd, simulated: Simulated) -> None:
    options = slcan(far_end.path, "--fd", "--data-bitrate", "5000000")
    start("run", "descent.yaml", *options, "--pace", "max").succeed()
    lines = slcan_lines.of_shots(slcan_lines.frames(far_end.data))
    assert {line.kind for line in lines} == {"b"}
    assert {len(line.data) for line in lines} == {24, 32}
    shots = slcan_lines.shots(lines)
    rows, expected = slcan_lines.rows(shots), simulated("descent.yaml")
    assert len(rows) == BEAMS * len(expected)
    assert_equal(rows, expected, exact=FLAGS + CODES)
    assert_instants_equal(shots, "time", expected.time_ns[:, 0])


@pytest.mark.parametrize("can_set", ["core", "full"])
def test_listen_at_the_other_end_of_the_bus(
    can_set: str, start: Start, far_end: FarEnd, other_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    listener = start("listen", *slcan(other_end.path), "--json")
    listener.word_after("listening on ")
    far_end.deliver_to(other_end)
    # A core set does not carry the number of its shot, so on a busy machine none may be skipped as late.
    settings = ["--set", f"wire.can_messages={can_set}", "--set", "timing.late_after_s=60"]
    options = ["--duration", "2", *settings, "--summary", "s.json"]
    start("run", "descent.yaml", *slcan(far_end.path), *options).succeed()
    summary = read_summary(tmp_path / "s.json")
    count = BEAMS * summary["shots"]["sent"]
    eventually(lambda: len(listened_beams(listener)) >= count)
    listener.signal(signal.SIGINT)
    assert listener.wait() == 0
    rows = listened_beams(listener)
    if can_set == "full":
        assert_complete(rows, summary, BEAMS)
        assert_equal(rows, simulated("descent.yaml"), FULL_STEPS, FULL_HELD, FULL_EXACT)
    else:
        assert summary["shots"]["sent"] == summary["shots"]["due"], "without numbers all must be there"
        numbered = [{**row, "shot": k // BEAMS} for k, row in enumerate(rows)]
        assert_complete(numbered, summary, BEAMS)
        assert_equal(numbered, simulated("descent.yaml"), CORE_STEPS, CORE_HELD, CORE_EXACT)


@pytest.mark.slow
def test_listen_and_send_by_slcan(start: Start, far_end: FarEnd, other_end: FarEnd, tmp_path: Path) -> None:
    """An adapter has one host: one after the other, each receives what the device sends meanwhile."""
    far_end.deliver_to(other_end)
    other_end.deliver_to(far_end)
    unit = [
        "--set",
        "wire.unit=3",
        "--set",
        "device.start=standby",
        "--set",
        "device.housekeeping_rate_hz=10",
    ]
    run = start("run", *LONG_BENCH, *slcan(far_end.path), *unit, "--summary", "s.json")
    eventually(lambda: b"t1F9" in far_end.data)
    send = start(
        "send", *slcan(other_end.path), "--unit", "3", "set_mode", "mode=track", "set_mode", "mode=fault"
    )
    assert send.wait() == 1, send.err
    assert send.out == "set_mode mode=track: accepted\nset_mode mode=fault: out of range\n"
    eventually(lambda: b"t1C0" in far_end.data)
    listener = start("listen", *slcan(other_end.path), "--count", "20")
    assert listener.wait() == 0
    run.signal(signal.SIGINT)
    run.succeed()
    for value in ("mode=track", "interlock_closed=yes laser_on=yes"):  # perhaps after a first mode=acquire
        assert value in listener.out
    assert listener.out.count(" unit 3 shot ") == 20
    assert "acknowledgements" not in listener.err, "they were the other host's"
    commands = read_summary(tmp_path / "s.json")["commands"]
    assert (commands["accepted"], commands["rejected"]) == (2, {"out_of_range": 1})
