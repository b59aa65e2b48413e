"""A port that a driver reads: other programs are refused, and command the device through the run."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from programs import LONG_BENCH, read_summary
from waiting import LIMIT_S, eventually

from lidar_protocol import Housekeeping, Message, SerialReceiver, default_interface

_DRIVER = """
import contextlib, os, sys
port = os.open("lidar", os.O_RDWR | os.O_NOCTTY)
with contextlib.suppress(OSError):  # EIO: the run has ended
    with open("received", "ab", 0) as file:
        while data := os.read(port, 4096):
            file.write(data)
"""


@pytest.mark.slow
def test_a_driver_receives_every_packet_while_others_try_its_port(start: Any, tmp_path: Path) -> None:
    run = start("run", *LONG_BENCH, "--set", "timing.late_after_s=900", "--port", "pty:lidar", "--control", "c",
                "--record", "f.mcap", "--summary", "s.json")  # fmt: skip
    eventually((tmp_path / "lidar").exists)
    driver = subprocess.Popen([sys.executable, "-c", _DRIVER], cwd=tmp_path)
    try:
        eventually(lambda: (tmp_path / "received").exists() and received(tmp_path))
        for words in (["send", "--port", "lidar", "no_op"], ["listen", "--port", "lidar"]):
            refused = start(*words)
            assert (refused.wait(), refused.out) == (2, "")
            assert f"(process {driver.pid})" in refused.err
            assert "send --control PATH" in refused.err
        words = ["--json", "set_rate_hz", "rate_hz=5", "set_pattern", "pattern=9", "no_op"]
        poke = start("send", "--control", "c", *words)
        assert poke.wait() == 1, poke.err
        assert [json.loads(line)["verdict"] for line in poke.out.splitlines()] == ["accepted", "out_of_range"]
        eventually(lambda: last_step_ms(tmp_path) == 200)
        run.signal(signal.SIGINT)
        run.succeed()
        assert driver.wait(LIMIT_S) == 0
    finally:
        driver.kill()
        driver.wait()
    summary, kinds = read_summary(tmp_path / "s.json"), Counter(type(each) for each in received(tmp_path))
    sent = {Message: summary["shots"]["sent"], Housekeeping: summary["housekeeping"]["sent"]}
    assert kinds == sent, "and no acknowledgement"
    with (tmp_path / "f.mcap").open("rb") as file:
        recorded = [json.loads(each.data) for _, _, each in make_reader(file).iter_messages("/command")]
    assert sorted((each["command"], each["sequence"], each["verdict"]) for each in recorded) == [
        ("set_pattern", None, "out_of_range"), ("set_rate_hz", None, "accepted"),
    ]  # fmt: skip
    (again := start("replay", "f.mcap", "--recompute")).succeed()
    assert re.search(r"\b(\d+) recorded: \1 equal, 0 different", again.out)


def received(folder: Path) -> list[Any]:
    return list(SerialReceiver(default_interface()).receive((folder / "received").read_bytes()))


def last_step_ms(folder: Path) -> int:
    times_ns = [each.time_ns or 0 for each in received(folder) if isinstance(each, Message)]
    return round((times_ns[-1] - times_ns[-2]) * 1e-6) if len(times_ns) > 1 else 0
