"""Somebody sets the machine's clock in flight: due times follow another, which cannot be set."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import slcan_lines
from can_tools import candump
from programs import LONG_BENCH, Program, read_summary
from waiting import eventually

Start = Callable[..., Program]
BUS = ["-i", "socketcan", "-c", "vcan0", "--bitrate", "1000000"]
STEPS = ("+1 hour", "-3 hours", "+2 hours")


def test_steps_of_the_wall_clock_change_nothing(start: Start, tmp_path: Path) -> None:
    options = ["--set", "timing.late_after_s=60", "--record", "r.mcap", "--summary", "s.json"]
    with candump(tmp_path) as dump:
        run = start("run", *LONG_BENCH, *BUS, *options)
        for step in STEPS:
            before = len(dump.shots())
            eventually(lambda before=before: len(dump.shots()) > before + 150)
            was_s = time.time()
            subprocess.run(["date", "-s", step], check=True, stdout=subprocess.DEVNULL)
            assert abs(time.time() - was_s) > 3000
        before = len(dump.shots())
        eventually(lambda: len(dump.shots()) > before + 150)
        run.signal(signal.SIGINT)
        run.succeed()
        shots = slcan_lines.shots(dump.frames())
    summary = read_summary(tmp_path / "s.json")
    assert summary["link_events"] == []
    assert summary["shots"]["sent"] == summary["shots"]["due"] == len(shots)
    numbers = [shot["shot"] for shot in shots]
    assert numbers == list(range(len(shots)))
    assert summary["lateness"]["max_ns"] < 1000 * 10**9, "a step of the clock is no lateness"
