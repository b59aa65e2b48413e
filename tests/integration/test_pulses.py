"""Time at the tone by a pulse line: the port process runs with a stand-in driver that reads a FIFO."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from time import monotonic_ns

import pytest
from programs import FarEnd, Program, read_summary
from waiting import eventually

from lidar_protocol import Acknowledge, Host, SerialReceiver, default_interface

Start = Callable[..., Program]
HOST = Host(default_interface())
TONE_NS = 500_000_000_000
BETWEEN_S = 0.3

DRIVER = """
import fcntl, os, pathlib, termios, time
here, real, level = pathlib.Path(__file__).parent, fcntl.ioctl, [0]
def ioctl(descriptor, request, argument=0, *more):
    if request == termios.TIOCMIWAIT:
        with open(here / "edges", "rb") as edges:
            level[0] = int(edges.read(1) or 0)
        return 0
    if request == termios.TIOCMGET:
        argument[:] = (termios.TIOCM_CD * level[0]).to_bytes(4, "little")
        if level[0]:
            (here / "seen").touch()
        return 0
    if request in (termios.TIOCMBIS, termios.TIOCMBIC) and argument == (termios.TIOCM_DTR).to_bytes(4, "little"):
        with open(here / "given", "a") as given:
            given.write(f"{time.monotonic_ns()} {int(request == termios.TIOCMBIS)}\\n")
        return 0
    return real(descriptor, request, argument, *more)
fcntl.ioctl = ioctl
"""


@pytest.fixture
def driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of the driver: what is written to `edges` there is the level after an edge."""
    (tmp_path / "sitecustomize.py").write_text(DRIVER)
    os.mkfifo(tmp_path / "edges")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}")
    return tmp_path


def answers(far_end: FarEnd) -> list[Acknowledge]:
    received = SerialReceiver(default_interface()).receive(bytes(far_end.data))
    return [message for message in received if isinstance(message, Acknowledge)]


@pytest.mark.parametrize("line", ["cd", None])
def test_the_time_is_that_at_the_last_pulse(
    line: str | None, start: Start, far_end: FarEnd, driver: Path
) -> None:
    settings = ["--set", f"device.clock.pulse_line={line or 'null'}"]
    run = start(
        "run", "bench.yaml", *settings, "--port", far_end.path, "--baud", "921600", "--summary", "s.json"
    )
    far_end.wait_for(145)
    far_end.send(HOST.encode_command("no_op", sequence=0))
    eventually(lambda: len(answers(far_end)) == 1)
    before_edge_ns = monotonic_ns()
    if line:
        (driver / "edges").write_bytes(b"1")
        eventually((driver / "seen").exists)
    after_edge_ns = monotonic_ns()
    threading.Event().wait(BETWEEN_S)
    before_command_ns = monotonic_ns()
    far_end.send(HOST.encode_command("time_at_tone", sequence=1, tone_ns=TONE_NS))
    eventually(lambda: len(answers(far_end)) == 2)
    heard_ns = monotonic_ns()
    answer = answers(far_end)[1]
    assert answer.verdict == "accepted"
    since_tone_ns = answer.values["time_ns"] - TONE_NS
    if line:
        assert before_command_ns - after_edge_ns <= since_tone_ns <= heard_ns - before_edge_ns
    else:
        assert since_tone_ns == 0, "the command's arrival, at which it is answered"
    run.process.terminate()
    run.succeed()
    events = [event["what"] for event in read_summary(driver / "s.json")["link_events"]]
    assert events == ["modem lines: CTS off, DSR off, CD off"]


def rises_ns(driver: Path) -> list[int]:
    """When the device's pulses began: they take turns with their ends."""
    # Opening a port raises the line; the device then lowers it.
    given = [line.split() for line in (driver / "given").read_text().splitlines()[1:]]
    levels = [level for _, level in given]
    if levels[-2:] == ["0", "0"]:
        levels.pop()  # closing the port lowers the line, be it high or not
    assert levels == ["0", "1"] * (len(levels) // 2) + ["0"] * (len(levels) % 2)
    return [int(time_ns) for time_ns, level in given if level == "1"]


def test_each_measured_shot_has_a_pulse_and_no_other(start: Start, far_end: FarEnd, driver: Path) -> None:
    settings = ["--set", "device.clock.pulse_out=dtr", "--port", far_end.path, "--baud", "921600"]
    run = start("run", "bench.yaml", *settings, "--summary", "s.json", "--record", "r.mcap")
    far_end.wait_for(145 * 5)
    far_end.send(HOST.encode_command("no_op", sequence=0))
    far_end.send(HOST.encode_command("set_mode", sequence=1, mode="standby"))
    eventually(lambda: len(answers(far_end)) == 2)
    threading.Event().wait(BETWEEN_S)
    before = len(rises_ns(driver))
    threading.Event().wait(4 * BETWEEN_S)
    assert len(rises_ns(driver)) == before, "in standby"
    far_end.send(HOST.encode_command("set_mode", sequence=2, mode="track"))
    eventually(lambda: len(rises_ns(driver)) >= before + 5)
    run.process.terminate()
    run.succeed()
    wire = read_summary(driver / "s.json")["wire"]
    rises = rises_ns(driver)
    assert wire["pulses"] == len(rises)
    assert 0 < wire["pulse_delay_max_ns"] < 50_000_000, "one that is late by its length is left out"
