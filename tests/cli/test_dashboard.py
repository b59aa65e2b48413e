"""The live display of a run: it fits a terminal of any size, and restores the terminal."""

from __future__ import annotations

import fcntl
import io
import json
import math
import os
import re
import select
import signal
import struct
import subprocess
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from installed_programs import LIDAR_EMU
from rich.console import Console
from waiting import LIMIT_S

import lidar_emu
from lidar_emu.api import simulate
from lidar_emu.cli.dashboard import Dashboard, render
from lidar_emu.cli.displays import (
    LastMinute,
    LatestMessages,
    RunDisplay,
    ScheduledEvent,
    next_events,
    scheduled_events,
)
from lidar_emu.report.beam_colours import beam_rgb
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, OutgoingPacket, Pace
from lidar_emu.runtime.summary import Tally
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model
from lidar_emu.wire import Encoder
from lidar_protocol import Housekeeping, SerialReceiver, default_interface

HIDDEN, SHOWN = b"\x1b[?25l", b"\x1b[?25h"


def reported(beams: int) -> dict[str, Any]:
    rows = [(str(k), 12345.678, -123.4567, 31.5, None if k % 2 else "below threshold") for k in range(beams)]
    lines = [
        ("time", "1.000 s, shot 20"),
        ("device", "unit 0, track, " + "laser on, " * 9),
        ("faults", "lost"),
    ]
    return {"beams": rows, "lines": lines}


@pytest.mark.parametrize(("width", "height"), [(40, 16), (80, 24), (120, 40), (20, 5)])
@pytest.mark.parametrize("beams", [0, 4, 100])
def test_it_fits_the_terminal(width: int, height: int, beams: int) -> None:
    console = Console(width=width, file=io.StringIO())
    console.print(render(reported(beams), width, height))
    assert isinstance(console.file, io.StringIO)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    assert len(lines) <= max(height, 8)
    shown = sum("12345.678" in line for line in lines)
    if width >= 40:
        assert shown == min(beams, max(1, height - 7))
        assert (f"and {beams - shown} beams more" in "".join(lines)) == (shown < beams)


class Slate:
    """A dashboard that keeps what it is shown."""

    is_due = True

    def show(self, reported: dict[str, Any]) -> None:
        self.reported = json.loads(json.dumps(reported))


def test_a_run_shows_what_is_on_the_wire() -> None:
    scenario = load("bench.yaml")
    measured = simulate(scenario).part(0, 3)
    packets = list(Encoder(scenario.wire, can=False, fd=False, beam_count=4).packets(measured))
    slate, tally = Slate(), Tally(Pace.WALL)
    events = [ScheduledEvent(0.1, "lost"), ScheduledEvent(9.2, "interlock opens")]
    display = RunDisplay(slate, default_interface(), False, tally, 20.0, events)  # type: ignore[arg-type]
    for shot, late_ns in enumerate((5000, 9000, 2000)):
        report = DeliveryReport(shot, shot * 10**8, shot * 10**8 + late_ns, DeliveryStatus.SENT)
        tally.add_report(report)
        display.on_report(OutgoingPacket(shot, report.due_ns, bytes(packets[shot])), report)
    lines = dict(slate.reported["lines"])
    assert lines["shots"] == "3 sent, 0 late, 0 dropped"
    assert lines["lateness"] == "2 us, at most 9 us so far"
    assert lines["time"] == "0.200 s of 20 s, shot 2"
    assert lines["next"] == "interlock opens in 9 s"
    ranges = [beam[1] for beam in slate.reported["beams"][:3]]
    assert ranges == pytest.approx(measured.range_m[2, :3], abs=1e-3)
    assert slate.reported["beams"][3][1] is None
    assert slate.reported["beams"][3][4] is not None


def test_the_last_minute_is_counted_by_second() -> None:
    """Two packets a second, each second later and longer than the one before; the first forty are forgotten."""
    minute = LastMinute()
    for second in range(100):
        for half in (0, 500_000_000):
            minute.add_packet(second * 10**9 + half, 1000 * (second + 1), 30 + second)
    (late, load) = minute.curves(True)
    assert late[0] == "lateness"
    assert late[1] == pytest.approx([(second + 1) / 100 for second in range(40, 100)])
    assert load[1] == pytest.approx([(30 + second) / 129 for second in range(40, 100)])
    assert minute.load_bps() == 2 * (30 + 98)
    assert [label for label, _, _ in minute.curves(False)] == ["load"]


@pytest.mark.parametrize(("width", "shown"), [(80, False), (200, True)])
def test_a_wide_terminal_shows_the_curves(width: int, shown: bool) -> None:
    content = {**reported(4), "curves": [("validity", [0.0, 0.5, 1.0], "50.0 % of the last minute")]}
    console = Console(width=width, file=io.StringIO())
    console.print(render(content, width, 40))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert (" ▄█  50.0 % of the last minute" in text) == shown
    assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("width", [80, 200])
def test_a_beam_has_a_bar_of_its_range_in_its_colour(width: int) -> None:
    content = {**reported(2), "scale_m": 4 * 12345.678}
    console = Console(width=width, file=io.StringIO(), force_terminal=True, color_system="truecolor")
    console.print(render(content, width, 40))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    longest = min(width - 62, 60)
    for beam in range(2):
        red, green, blue = beam_rgb(beam)
        (bar,) = re.findall(rf"38;2;{red};{green};{blue}m([█-▏]+)", text)
        assert len(bar) == math.ceil(longest / 4)
    assert max(map(len, re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines())) <= width


def test_several_units_and_their_modes() -> None:
    scenario, arrived = load("bench.yaml"), b""
    for unit in (3, 1):
        twin = load("bench.yaml", {"wire.unit": str(unit)})
        encoder = Encoder(twin.wire, can=False, fd=False, beam_count=4)
        arrived += b"".join(map(bytes, encoder.packets(simulate(scenario).part(0, 1))))
    latest = LatestMessages(default_interface())
    latest.store(SerialReceiver(default_interface()).receive(arrived))
    latest.store([Housekeeping(3, {"mode": 4, "interlock_closed": False})])
    assert [beam[0] for beam in latest.beams()] == [f"{u}.{b}" for u in (1, 3) for b in range(4)]
    (_, first), (_, second) = latest.lines()
    assert first.startswith("unit 1, ")
    assert second.startswith("unit 3, ")
    assert "interlock open" in second


class Terminal:
    """A program on a terminal of 80 by 24, as a shell starts it."""

    def __init__(self, arguments: list[str], folder: Path) -> None:
        self._master, slave = os.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self.seen = b""
        self.process = subprocess.Popen(
            [LIDAR_EMU, *arguments], cwd=folder, stdin=slave, stdout=slave, stderr=slave,
            env={**os.environ, "TERM": "xterm"}, start_new_session=True,
        )  # fmt: skip
        os.close(slave)

    def read_until(self, what: bytes) -> None:
        """Up to these bytes, or to the end of everybody who writes there."""
        while what not in self.seen:
            assert select.select([self._master], [], [], LIMIT_S)[0], self.seen[-2000:]
            try:
                self.seen += os.read(self._master, 65536)
            except OSError:  # nobody is left
                assert what == b"the end"
                return

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._master)


@contextmanager
def on_terminal(folder: Path, *arguments: str) -> Iterator[Terminal]:
    terminal = Terminal(list(arguments), folder)
    try:
        yield terminal
    finally:
        terminal.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow), signal.SIGKILL]
)
def test_the_terminal_is_given_back(number: signal.Signals, tmp_path: Path) -> None:
    """Ctrl-C goes to all that are in the foreground; after `kill -9` only the one that draws can clean up."""
    with on_terminal(tmp_path, "run", "bench.yaml") as terminal:
        terminal.read_until(b"lateness")
        os.killpg(terminal.process.pid, number)
        terminal.read_until(b"the end")
    assert terminal.seen.rindex(SHOWN) > terminal.seen.rindex(HIDDEN)
    after = terminal.seen[terminal.seen.rindex(SHOWN) :].decode()
    assert ("the run was interrupted" in after) == (number != signal.SIGKILL)
    assert "Traceback" not in terminal.seen.decode()


@pytest.mark.slow
def test_lines_if_asked_for(tmp_path: Path) -> None:
    with on_terminal(
        tmp_path, "run", "bench.yaml", "--plain", "--duration", "1", "--pace", "max"
    ) as terminal:
        terminal.read_until(b"the end")
    assert b"SNR dB" not in terminal.seen
    lines = terminal.seen.decode().splitlines()
    heading = lines.index(next(line for line in lines if "time unit shot" in line))
    assert lines[heading + 2].split()[:3] == ["0.000", "0", "0"]
    assert max(map(len, lines)) <= 80


@pytest.mark.slow
def test_what_is_reported_stays_above_the_display(tmp_path: Path) -> None:
    with on_terminal(tmp_path, "listen", "--port", "pty") as listener:
        listener.read_until(b"\n")
        (path,) = re.findall(r"/dev/pts/\d+", listener.seen.decode())
        with on_terminal(tmp_path, "run", "bench.yaml", "--port", path, "--duration", "2") as run:
            run.read_until(b"the end")
        listener.read_until(b"unit 0, track")
        os.killpg(listener.process.pid, signal.SIGINT)
        listener.read_until(b"the end")
    assert b"bench on " + path.encode() in run.seen
    assert b"received: frames 2" in listener.seen[listener.seen.rindex(SHOWN) :]


def test_who_flies_does_not_wait_for_who_draws(capfd: pytest.CaptureFixture[str]) -> None:
    """One that stands still, and one that is gone."""
    with Dashboard() as dashboard:
        dashboard._process.send_signal(signal.SIGSTOP)
        for _ in range(2000):
            dashboard.show(reported(100))
        dashboard._process.kill()
        dashboard._process.wait()
        dashboard.print_line("stated all the same")
    assert "stated all the same" in capfd.readouterr().out


def test_the_next_events_are_those_of_the_scenario() -> None:
    scenario = lidar_emu.load(
        "descent.yaml",
        {
            "faults": "[{kind: interlock, from_s: 3}, "
            "{kind: dropout, from_s: 4, to_s: 6}, {kind: lost, at_s: 5}, {kind: bias, range_m: 1}]",
            "scanner.switches": "[{kind: time, at_s: 7, pattern: {kind: square, angle_deg: 10}}]",
        },
    )
    events = scheduled_events(scenario, None)
    assert events == [
        (3.0, "interlock begins"),
        (4.0, "dropout begins"),
        (5.0, "lost"),
        (6.0, "dropout ends"),
        (7.0, "change of pattern"),
    ]
    assert next_events(events, 4.5) == "lost in 0 s; dropout ends in 2 s; change of pattern in 2 s"
    assert next_events(events, 7.0) == ""


def test_a_change_of_pattern_at_an_altitude_is_among_the_next_events() -> None:
    """`descent.yaml` changes at 500 m; the packets of a flight show when."""
    scenario = lidar_emu.load("descent.yaml", {"level": "geometric"})
    flown = simulate(scenario)
    changed = int(np.argmax(flown.beam_angle_deg[:, 0] < 10.0))
    model = build_model(scenario)
    assert model.flight is not None
    (event,) = scheduled_events(scenario, model.flight.trajectory)
    assert event.what == "change of pattern below 500 m"
    assert event.time_s == pytest.approx(changed / scenario.timing.rate_hz, abs=0.2)
