"""The emulator on SocketCAN, and at the other end candump, cansend, cantools, tshark and `lidar-emu listen`."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
import slcan_lines
from can_tools import candump, run_tool, tshark
from comparison import CODES, FLAGS, assert_complete, assert_equal
from installed_programs import CANTOOLS
from programs import Program, listened_beams, read_summary
from slcan_lines import CORE_EXACT, CORE_HELD, CORE_STEPS, FULL_EXACT, FULL_HELD, FULL_STEPS
from waiting import eventually

import lidar_protocol
from lidar_emu.measurement import Measurement

BEAMS = 4
BUS = ["-i", "socketcan", "-c", "vcan0", "--bitrate", "1000000"]
PART = ["--pace", "max", "--duration", "5"]
SHOTS_ALONE = ["--set", "device.housekeeping_rate_hz=0"]
DBC = str(Path(lidar_protocol.__file__).parent / "lidar.dbc")

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]


def test_the_full_set_as_everybody_reads_it(start: Start, simulated: Simulated, tmp_path: Path) -> None:
    listener = start("listen", *BUS, "--json")
    with candump(tmp_path) as dump, tshark(tmp_path) as dissected:
        listener.word_after("listening on ")
        start("run", "descent.yaml", *BUS, *PART, "--summary", "s.json").succeed()
        summary = read_summary(tmp_path / "s.json")
        eventually(lambda: len(listened_beams(listener)) >= BEAMS * summary["shots"]["sent"])
        listener.signal(signal.SIGINT)
        assert listener.wait() == 0
        eventually(lambda: len(dissected()) >= len(dump.frames()))
        assert dissected() == [(frame.can_id, frame.data) for frame in dump.frames()]

    frames = dump.frames()
    rows = slcan_lines.rows(slcan_lines.shots(frames))
    heard = listened_beams(listener)
    for received in (rows, heard):
        assert_complete(received, summary, BEAMS)
        assert len(received) == BEAMS * summary["planned_shots"]
        assert_equal(received, simulated("descent.yaml"), FULL_STEPS, FULL_HELD, FULL_EXACT)
    assert summary["wire"]["lost_frames"] == summary["wire"]["error_frames"] == 0

    decoded = run_tool(CANTOOLS, "decode", "--single-line", DBC, stdin=dump.log).splitlines()
    reported = [re.search(r"Beam0\(.*?range_m: (\S+)", line) for line in decoded]
    ranges_m = [match[1] for match in reported if match]
    for text, row in zip(ranges_m, rows[::BEAMS], strict=True):
        assert (text[0] == "n") == (row["range_m"] is None)
        assert text[0] == "n" or float(text) == pytest.approx(row["range_m"], abs=1e-9)


@pytest.mark.parametrize(
    ("options", "kind", "messages"),
    [
        (["--set", "wire.can_messages=core"], "t", ["Header", *(f"Beam{k}" for k in range(4))]),
        (["--fd", "--data-bitrate", "5000000"], "b", ["FdHeader", *(f"FdBeam{k}" for k in range(4))]),
    ],
)
def test_the_other_sets_of_messages(
    options: list[str], kind: str, messages: list[str], start: Start, simulated: Simulated, tmp_path: Path
) -> None:
    with candump(tmp_path) as dump:
        start("run", "descent.yaml", *BUS, *options, "--pace", "max", "--summary", "s.json").succeed()
    frames = dump.shots()
    shots = slcan_lines.shots(frames)
    rows, expected = slcan_lines.rows(shots), simulated("descent.yaml")
    assert_complete(rows, read_summary(tmp_path / "s.json"), BEAMS)
    assert {frame.kind for frame in frames} == {kind}
    assert {tuple(shot["messages"]) for shot in shots} == {tuple(messages)}
    if kind == "b":
        assert_equal(rows, expected, exact=FLAGS + CODES)
    else:
        assert_equal(rows, expected, CORE_STEPS, CORE_HELD, CORE_EXACT)


@pytest.mark.parametrize(
    "options", [["--set", "wire.can_messages=core"], ["--fd", "--data-bitrate", "5000000"]]
)
def test_a_recording_and_a_log_of_candump_come_again(
    options: list[str], start: Start, tmp_path: Path
) -> None:
    """What candump saw of the run, of its replay, and of the replay of what candump saw."""
    bus = [*BUS, *(option for option in options if "=" not in option and option != "--set")]
    with candump(tmp_path) as dump, tshark(tmp_path) as dissected:
        start("run", "descent.yaml", *BUS, *options, *PART, *SHOTS_ALONE, "--record", "r.mcap").succeed()
        eventually(lambda: len(dissected()) >= len(dump.frames()))
    flown = dump.frames()
    shots = [line for line in dump.log.splitlines(keepends=True) if " 7FF#" not in line]
    (tmp_path / "seen.log").write_text("".join(shots))
    assert len(flown) == 100 * 5
    for file in ("r.mcap", "seen.log"):
        with candump(tmp_path) as dump:
            start("replay", file, *bus, "--speed", "max").succeed()
        assert dump.frames() == flown, file
    start("replay", "r.mcap", "--to", "r.pcap").succeed()
    fields = ["-T", "fields", "-e", "can.id", "-e", "data.data"]
    rows = [
        line.split("\t") for line in run_tool("tshark", "-r", str(tmp_path / "r.pcap"), *fields).splitlines()
    ]
    assert [(int(can_id, 0), bytes.fromhex(data)) for can_id, data in rows] == [
        (f.can_id, f.data) for f in flown
    ]


@pytest.mark.parametrize("options", [[], ["--fd", "--data-bitrate", "5000000"]])
def test_a_bus_is_checked_from_both_of_its_ends(options: list[str], start: Start) -> None:
    run = start(
        "check",
        *BUS,
        "-c",
        "vcan0",
        *options,
        "--duration",
        "2",
        "--json",
        "--set",
        "timing.late_after_s=100",
    )
    assert run.wait() == 0, run.out
    report = json.loads(run.out)
    assert report["arrived"] == 40
    assert report["commands"] == report["turnaround"]["count"] > 0
    assert report["packet"] == ("5 frames" if options else "15 frames")
