"""What a host says on the bus: commands by cansend, and more than anybody reads."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from itertools import groupby
from pathlib import Path

import slcan_lines
from can_tools import candump, run_tool, send, send_command
from programs import Program, eventually, read_summary

from lidar_protocol import Host, default_interface

BUS = ["-i", "socketcan", "-c", "vcan0", "--bitrate", "1000000"]

Start = Callable[..., Program]


def test_the_beams_follow_a_command_by_cansend(start: Start, tmp_path: Path) -> None:
    host = Host(default_interface())
    flat = ["--set", "level=geometric", "--set", "site=flat"]
    with candump(tmp_path) as dump:
        run = start("run", "descent.yaml", *BUS, *flat, "--summary", "s.json")
        eventually(lambda: len(dump.shots()) > 60)
        send_command(host.encode_command_frame("set_pattern", sequence=0, pattern=1))
        send(0x132, b"\x01")  # a command cut short
        send_command(host.encode_command_frame("set_pattern", sequence=1, pattern=77))
        eventually(lambda: sum(frame.can_id == 0x138 for frame in dump.frames()) >= 3)
        sent = len(dump.shots())
        eventually(lambda: len(dump.shots()) > sent + 150)
        run.signal(signal.SIGINT)
        run.succeed()
    answers = [frame for frame in dump.frames() if frame.can_id == 0x138]
    told = [slcan_lines.DATABASE.decode_message(frame.can_id, frame.data) for frame in answers]
    summary = read_summary(tmp_path / "s.json")
    assert [str(answer["verdict"]) for answer in told] == ["accepted", "malformed", "out_of_range"]
    assert summary["commands"]["accepted"] == 1
    assert summary["commands"]["rejected"] == {"malformed": 1, "out_of_range": 1}
    angles = [beam["beam_angle_deg"] for shot in slcan_lines.shots(dump.shots()) for beam in shot["beams"]]
    assert [angle for angle, _ in groupby(angles)] == [22.5, 7.5]


def test_a_flood_that_is_not_read_in_time_is_told(start: Start, tmp_path: Path) -> None:
    with candump(tmp_path) as dump:
        run = start("run", "bench.yaml", *BUS, "--summary", "s.json")
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
    told = [event["what"] for event in summary["link_events"]]
    lost = [int(match[1]) for text in told if (match := re.match(r"(\d+) received frames lost", text))]
    assert sum(lost) == summary["wire"]["lost_frames"] > 0
    assert summary["shots"]["sent"] + summary["shots"]["late"] == summary["shots"]["due"]
