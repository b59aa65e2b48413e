"""How runs end before their time: by the user, or by the system."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import handwritten
import pytest
from click.testing import CliRunner
from comparison import assert_equal
from programs import FarEnd, Program, is_running, read_summary

from lidar_emu.cli import cli
from lidar_emu.errors import RunError
from lidar_emu.measurement import Measurement

# Nobody wakes up, decides and writes within a microsecond: every packet is late.
ALWAYS_LATE = ["level=geometric", "timing.late_after_s=1e-6", "device.housekeeping_rate_hz=0"]

Start = Callable[..., Program]
Simulated = Callable[..., Measurement]


def test_a_flight_that_never_began_counts_from_the_opening_of_the_port(start: Start, tmp_path: Path) -> None:
    run = start("run", "descent.yaml", "--port", "pty", "--start", "on-command", "--summary", "s.json")
    run.word_after("descent on ")
    run.signal(signal.SIGINT)
    run.succeed()
    (event,) = read_summary(tmp_path / "s.json")["link_events"]
    assert event["what"] == "nobody connected"
    assert abs(event["time_s"]) < 60


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_with_its_summary(
    number: signal.Signals, start: Start, far_end: FarEnd, simulated: Simulated, tmp_path: Path
) -> None:
    run = start("run", "descent.yaml", "--port", far_end.path, "--baud", "921600", "--summary", "s.json")
    port = run.port_process()
    far_end.wait_for(6 * 158)
    run.signal(number)
    run.succeed()
    assert "the run was interrupted" in run.out
    summary = read_summary(tmp_path / "s.json")
    assert summary["interrupted"] is True
    assert 5 <= summary["shots"]["sent"] <= summary["shots"]["due"] < summary["planned_shots"] == 1008
    rows = handwritten.rows(far_end.data)
    assert len(rows) == 4 * summary["shots"]["sent"]
    assert len(far_end.data) == summary["wire"]["sent_bytes"]
    assert_equal(rows, simulated("descent.yaml"))
    assert sum(summary["beams"][0].values()) == summary["shots"]["due"]
    assert not is_running(port)


@pytest.mark.slow
def test_ctrl_c_as_fast_as_the_link_takes_it(start: Start, far_end: FarEnd, tmp_path: Path) -> None:
    scenario = ["bench.yaml", "--set", "timing.rate_hz=1000", "--set", "bench_pattern.duration_s=1000"]
    options = ["--port", far_end.path, "--baud", "3000000", "--pace", "max", "--summary", "s.json"]
    run = start("run", *scenario, *options, "--record", "r.mcap")
    far_end.wait_for(2010 * 158)
    run.signal(signal.SIGINT)
    run.succeed()
    shots = read_summary(tmp_path / "s.json")["shots"]
    assert 2000 <= shots["sent"] == shots["due"] < 1_000_000
    assert len(handwritten.shots(far_end.data)) == shots["sent"]


def test_a_signal_while_the_start_is_awaited(start: Start, tmp_path: Path) -> None:
    run = start("run", "descent.yaml", "--start", "2099-01-01T00:00:00Z", "--summary", "s.json")
    run.word_after("descent on ")
    run.signal(signal.SIGINT)
    run.succeed()
    assert read_summary(tmp_path / "s.json")["shots"]["due"] == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_host_is_awaited(number: signal.Signals, start: Start, tmp_path: Path) -> None:
    run = start("run", "descent.yaml", "--port", f"pty:{tmp_path}/lidar", "--summary", "s.json")
    assert run.word_after("descent on ") == f"{tmp_path}/lidar"
    port = run.port_process()
    run.signal(number)
    run.succeed()
    assert "waits for a host to open it, at most 60 s; Ctrl-C ends it" in run.out
    assert "0 due of 1008 planned" in run.out
    assert "the run was interrupted" in run.out
    assert not is_running(port)
    assert not (tmp_path / "lidar").is_symlink()


def test_a_late_packet_ends_a_run_that_wants_it_so(tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    settings = [f"--set={setting}" for setting in (*ALWAYS_LATE, "timing.when_late=abort")]
    run = ["run", "descent.yaml", "--duration", "1", *settings, "--summary", str(summary)]
    done, reported = CliRunner().invoke(cli, run, standalone_mode=False), json.loads(summary.read_text())
    assert isinstance(done.exception, RunError)  # exit code 1
    assert str(done.exception).startswith("shot 0 was ")
    assert "timing.when_late is abort" in str(done.exception)
    assert reported["error"] == str(done.exception)
    assert (reported["shots"]["due"], reported["shots"]["late"], reported["shots"]["sent"]) == (1, 1, 0)
    assert reported["wire"]["sent_bytes"] == 0
    assert reported["interrupted"] is False
