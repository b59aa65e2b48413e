"""What a host sends on the bus: commands by cansend, and more than the device reads."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import slcan_lines
from can_tools import Candump, candump, run_tool, send_command
from installed_programs import CANTOOLS
from programs import LONG_BENCH, Program, read_summary
from waiting import eventually

import lidar_protocol
from lidar_protocol import Host, default_interface

DBC = str(Path(lidar_protocol.__file__).parent / "lidar.dbc")
BUS = ["-i", "socketcan", "-c", "vcan0", "--bitrate", "1000000"]

FLAT = ["--set", "level=geometric", "--set", "site=flat"]
HEALTH = 0x139

Start = Callable[..., Program]


def modes(dump: Candump) -> list[str]:
    """The counts in housekeeping, without repetitions, as cantools decodes them with the DBC."""
    reported = [frame.data for frame in dump.frames() if frame.can_id == HEALTH]
    decoded = (slcan_lines.DATABASE.decode_message(HEALTH, data) for data in reported)
    return [mode for mode, _ in groupby(str(values["mode"]) for values in decoded)]


def commands_of(name: str, folder: Path) -> Any:
    return read_summary(folder / name)["commands"]


def test_a_flood_that_is_not_read_in_time_is_reported(start: Start, tmp_path: Path) -> None:
    with candump(tmp_path) as dump:
        run = start("run", *LONG_BENCH, *BUS, "--summary", "s.json")
        eventually(dump.frames)
    port = run.port_process()
    os.kill(port, signal.SIGSTOP)
    run_tool("cangen", "vcan0", "-g", "0", "-n", "40000", "-I", "7F0", "-L", "8", "-D", "00")
    os.kill(port, signal.SIGCONT)
    with candump(tmp_path) as dump:
        eventually(dump.shots)
    run.signal(signal.SIGINT)
    run.succeed()
    summary = read_summary(tmp_path / "s.json")
    reported = [event["what"] for event in summary["link_events"]]
    lost = [int(match[1]) for text in reported if (match := re.match(r"(\d+) received frames lost", text))]
    assert sum(lost) == summary["wire"]["lost_frames"] > 0
    assert summary["shots"]["sent"] + summary["shots"]["late"] == summary["shots"]["due"]


def test_a_device_boots_obeys_restarts_and_reports_how_it_is(start: Start, tmp_path: Path) -> None:
    host = Host(default_interface())
    device = {"start": "boot", "boot_s": 0.2, "self_test_s": 0.5, "acquisition_s": 0.5, "warm_restart_s": 0.3}
    settings = [word for key, value in device.items() for word in ("--set", f"device.{key}={value}")]
    listener = start("listen", *BUS, "--json")
    listener.word_after("listening on ")
    with candump(tmp_path) as dump:
        run = start("run", "descent.yaml", *BUS, *FLAT, *settings,
                    "--set", "device.housekeeping_rate_hz=10", "--summary", "s.json")  # fmt: skip
        eventually(lambda: modes(dump)[-1:] == ["standby"])
        assert dump.shots() == []
        send_command(host.encode_command_frame("set_mode", sequence=0, mode="track"))
        eventually(lambda: modes(dump)[-1:] == ["track"])
        send_command(host.encode_command_frame("set_pattern", sequence=1, pattern=1))
        eventually(lambda: len(dump.shots()) > 300)
        send_command(host.encode_command_frame("reset", sequence=2, restart="warm"))
        eventually(lambda: modes(dump)[-1:] == ["standby"])
        run.signal(signal.SIGINT)
        run.succeed()
    assert modes(dump) == ["self_test", "standby", "acquire", "track", "standby"]
    answers = [frame for frame in dump.frames() if frame.can_id == 0x138]
    reported = [slcan_lines.DATABASE.decode_message(frame.can_id, frame.data) for frame in answers]
    expected = [("set_mode", 0), ("set_pattern", 1), ("reset", 2)]
    assert [(str(answer["command"]), answer["sequence"]) for answer in reported] == expected
    assert {str(answer["verdict"]) for answer in reported} == {"accepted"}
    parts = [frame.can_id for frame in dump.frames() if frame.can_id >= HEALTH]
    assert parts == [*range(HEALTH, HEALTH + 5)] * (len(parts) // 5), "five frames each, in their order"
    summary = read_summary(tmp_path / "s.json")
    assert len(parts) == 5 * summary["housekeeping"]["sent"]

    decoded = run_tool(CANTOOLS, "decode", "--single-line", DBC, stdin=dump.log).splitlines()
    by_program = [match[1] for line in decoded if (match := re.search(r"Health\(\s*mode: '?(\w+)", line))]
    assert [mode for mode, _ in groupby(by_program)] == modes(dump)

    eventually(lambda: listener.out.count('"housekeeping"') == len(parts))
    listener.signal(signal.SIGINT)
    assert listener.wait() == 0
    rows = [json.loads(line) for line in listener.out.splitlines()]
    heard = [row["acknowledge"] for row in rows if "acknowledge" in row]
    assert [(row["command"], row["sequence"]) for row in heard] == expected
    assert re.search(rf"acknowledgements 3, housekeeping {len(parts)}\b", listener.err)
    assert sum("beam" in row for row in rows) == 4 * summary["shots"]["sent"]


def test_two_units_each_follow_their_own_commands_by_send(start: Start, tmp_path: Path) -> None:
    with candump(tmp_path) as dump:
        runs = [
            start("run", *LONG_BENCH, *BUS, "--set", f"wire.unit={unit}", "--summary", f"{unit}.json")
            for unit in (0, 3)
        ]
        eventually(lambda: {0x100, 0x1C0} <= {frame.can_id for frame in dump.frames()})
        for unit, words, code in (
            (3, ["set_rate_hz", "rate_hz=5", "enable_beams", "beams=0b11"], 0),
            (0, ["set_pattern", "pattern=9"], 1),
            (7, ["no_op"], 1),
        ):
            sender = start(
                "send", *BUS, "--unit", str(unit), "--timeout", "1" if unit == 7 else "900", *words
            )
            assert sender.wait() == code, sender.err
            assert sender.out.count("accepted") == (2 if unit == 3 else 0)
        for run in runs:
            run.signal(signal.SIGINT)
            run.succeed()
    assert commands_of("3.json", tmp_path)["accepted"] == 3, "with the no_op before them"
    # `send` repeats its no_op until it is acknowledged, on a slow machine more than once.
    assert commands_of("3.json", tmp_path)["rejected"].keys() <= {"bad_sequence"}
    assert commands_of("0.json", tmp_path)["accepted"] == 1
    assert commands_of("0.json", tmp_path)["rejected"].items() >= {"out_of_range": 1}.items()
    answers = [frame.can_id for frame in dump.frames() if frame.can_id in (0x138, 0x1F8)]
    assert [unit for unit, _ in groupby(answers)] == [0x1F8, 0x138]
