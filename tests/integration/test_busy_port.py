"""A port that a driver reads: others are refused, and poke the device through the run."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from programs import LONG_BENCH, Program, read_summary
from waiting import LIMIT_S, eventually

from lidar_protocol import Acknowledge, Housekeeping, Message, SerialReceiver, default_interface

_DRIVER = """
import os, sys
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
try:
    while data := os.read(port, 4096):
        sys.stdout.buffer.write(data)
        sys.stdout.flush()
except OSError:  # EIO: the run has ended
    pass
"""


def test_a_driver_receives_every_packet_while_others_try_its_port(
    start: Callable[..., Program], tmp_path: Path
) -> None:
    run = start("run", *LONG_BENCH, "--set", "timing.late_after_s=900", "--port", "pty:lidar", "--control", "c",
                "--record", "f.mcap", "--summary", "s.json")  # fmt: skip
    eventually((tmp_path / "lidar").exists)
    with (tmp_path / "received").open("wb") as out:
        driver = subprocess.Popen([sys.executable, "-c", _DRIVER, tmp_path / "lidar"], stdout=out)
    try:
        eventually(lambda: received(tmp_path))
        for words in (["send", "--port", "lidar", "no_op"], ["listen", "--port", "lidar"]):
            refused = start(*words)
            assert (refused.wait(), refused.out) == (2, "")
            assert f"(process {driver.pid})" in refused.err
            assert "send --control PATH" in refused.err
        words = ["--json", "set_rate_hz", "rate_hz=5", "set_pattern", "pattern=9", "no_op"]
        poke = start("send", "--control", "c", *words)
        assert poke.wait() == 1, poke.err
        assert [json.loads(line)["verdict"] for line in poke.out.splitlines()] == ["accepted", "out_of_range"]
        eventually(lambda: shot_steps_ms(tmp_path)[-1:] == [200])
        run.signal(signal.SIGINT)
        run.succeed()
        assert driver.wait(LIMIT_S) == 0
    finally:
        driver.kill()
    sent, messages = read_summary(tmp_path / "s.json"), received(tmp_path)
    assert sum(isinstance(each, Message) for each in messages) == sent["shots"]["sent"] > 0
    assert sum(isinstance(each, Housekeeping) for each in messages) == sent["housekeeping"]["sent"]
    assert not [each for each in messages if isinstance(each, Acknowledge)]
    assert sent["commands"]["accepted"] == 1
    assert sorted(recorded_commands(tmp_path / "f.mcap")) == [
        ("set_pattern", {"pattern": 9}, None, "out_of_range"),
        ("set_rate_hz", {"rate_hz": 5.0}, None, "accepted"),
    ]
    again = start("replay", "f.mcap", "--recompute")
    again.succeed()
    assert re.search(r"\b(\d+) recorded: \1 equal, 0 different", again.out)


def received(folder: Path) -> list[object]:
    return list(SerialReceiver(default_interface()).receive((folder / "received").read_bytes()))


def shot_steps_ms(folder: Path) -> list[int]:
    times = [each.time_ns or 0 for each in received(folder) if isinstance(each, Message)]
    return [round((later - earlier) * 1e-6) for earlier, later in pairwise(times)]


def recorded_commands(path: Path) -> list[tuple[Any, ...]]:
    with path.open("rb") as file:
        found = [
            json.loads(message.data) for _, _, message in make_reader(file).iter_messages(topics=["/command"])
        ]
    return [tuple(each[key] for key in ("command", "values", "sequence", "verdict")) for each in found]


def test_what_cannot_be_sent_through_a_run(start: Callable[..., Program]) -> None:
    for words, message in (
        (["--port", "lidar", "no_op"], "--port: cannot be combined with --control"),
        (["--sequence", "0", "no_op"], "--sequence: cannot be combined with --control"),
        (["no_op"], "--control: c: No such file or directory; name the path of a run's --control"),
    ):
        send = start("send", "--control", "c", *words)
        assert send.wait() == 2
        assert message in send.err
