"""`lidar-emu bench realtime` with all its processes: what it counts, never how late anything was."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from waiting import LIMIT_S, eventually

from lidar_emu.bench.realtime import RealtimeOptions, measure_realtime, realtime_document
from lidar_emu.bench.realtime_statistics import NEVER
from lidar_emu.cli.bench_latency import print_realtime
from lidar_emu.transports.spec import parse_port

LIDAR_EMU = "from lidar_emu.cli import main; main()"
STAGES = ("wake_up", "due_to_written", "due_to_received")


def test_a_second_at_50_hz_is_measured_on_both_sides(capsys):
    seen = []
    report = measure_realtime(RealtimeOptions(50.0, 1.0, beamlets=7, recording=True), seen.append)
    reported = json.loads(json.dumps(realtime_document(report)))
    assert seen[0] == "preparing"
    assert report.emulator.due_ns.tolist() == report.control.due_ns.tolist()
    for side, measured in ((reported["emulator"], report.emulator), (reported["control"], report.control)):
        written = side["due_to_written"]["count"]
        assert side["due"] == side["wake_up"]["count"] == 50
        assert written == side["due_to_received"]["count"] == 50 - side["late"]
        assert written > 0
        sent = measured.written_ns != NEVER
        # One after the other, and each reader has a packet only after it was handed over.
        assert (measured.due_ns[sent] <= measured.woke_ns[sent]).all()
        assert (measured.woke_ns[sent] <= measured.written_ns[sent]).all()
        assert (measured.woke_ns[sent] < measured.received_ns[sent]).all()
        for stage in STAGES:
            quantiles = [side[stage][name] for name in ("p50_ns", "p99_ns", "p99_9_ns", "max_ns")]
            assert quantiles == sorted(quantiles)
    assert reported["emulator"]["dropped"] == 0
    assert reported["windows"]["count"] == len(reported["windows"]["each"]) == 1
    assert sum(reported["histogram"]["emulator"]) == reported["emulator"]["due_to_written"]["count"]
    assert reported["interrupted"] is False
    assert reported["granted"] == reported["control_granted"]
    print_realtime(reported)
    shown = capsys.readouterr().out
    assert "emulator, written" in shown
    assert "p99 due to written is" in shown


def test_another_port_is_written_to_and_its_far_end_is_not_measured():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        port = parse_port(f"udp:{host.getsockname()[1]}")
        report = measure_realtime(RealtimeOptions(50.0, 0.5, beamlets=7, port=port), lambda _: None)
        reported = realtime_document(report)
        assert len(host.recv(65536)) == reported["packet_bytes"]
    assert reported["port"] == str(port)
    assert reported["emulator"]["due_to_written"]["count"] > 0
    assert reported["emulator"]["due_to_received"]["count"] == 0
    assert reported["control"]["due_to_received"]["count"] > 0


@pytest.mark.slow
def test_interrupted_it_reports_what_it_has(tmp_path):
    log = tmp_path / "reported.json"
    with log.open("w") as out:
        bench = subprocess.Popen(
            [sys.executable, "-c", LIDAR_EMU, "bench", "realtime", "--rate", "50", "--duration", "600",
             "--beamlets", "7", "--json"],
            stdout=out, stderr=subprocess.PIPE, start_new_session=True, text=True,
        )  # fmt: skip
        pid = bench.pid
        eventually(lambda: port_is_open(pid) or bench.poll() is not None)
        bench.send_signal(signal.SIGINT)
        _, errors = bench.communicate(timeout=LIMIT_S)
    assert (bench.returncode, errors) == (0, "")
    reported = json.loads(log.read_text())
    assert reported["interrupted"] is True
    assert reported["emulator"]["due"] < 50 * 600


def port_is_open(pid: int) -> bool:
    """Whether the bench's port process runs: from then on Ctrl-C ends the flight, not the program."""
    for process in Path("/proc").iterdir():
        with suppress(OSError):
            is_child = process.name.isdecimal() and f"\nPPid:\t{pid}\n" in (process / "status").read_text()
            if is_child and "lidar_emu.runtime.port.process" in (process / "cmdline").read_text():
                return True
    return False
