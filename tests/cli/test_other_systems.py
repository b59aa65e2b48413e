"""On a system that is not Linux, ports are refused in one line and everything else works."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import LIMIT_S

STUB = Path(__file__).resolve().parents[1] / "support" / "another_system"


def done(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join(filter(None, (str(STUB), os.environ.get("PYTHONPATH"))))
    return subprocess.run(
        [sys.executable, "-m", "lidar_emu", *arguments],
        env={**os.environ, "PYTHONPATH": paths},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT_S,
    )


@pytest.mark.parametrize(
    "command",
    [
        "run descent.yaml",
        "listen --port pty",
        pytest.param("run descent.yaml --port udp:5600", marks=pytest.mark.slow),
        pytest.param("send --port pty set_mode mode=track", marks=pytest.mark.slow),
        pytest.param("replay flight.mcap --port pty", marks=pytest.mark.slow),
        pytest.param("bench realtime", marks=pytest.mark.slow),
        pytest.param("bench response", marks=pytest.mark.slow),
    ],
)
def test_ports_are_refused_in_one_line(command: str, tmp_path: Path) -> None:
    refused = done(tmp_path, *command.split())
    assert refused.returncode == 2
    assert refused.stderr.startswith("lidar-emu: this command needs Linux: no ")
    assert refused.stderr.count("\n") == 1


def test_the_doctor_says_what_needs_linux(tmp_path: Path) -> None:
    said = done(tmp_path, "doctor")
    assert (said.returncode, said.stderr) == (1, "")
    assert "\nneeded   Linux: run, replay, listen and send need it, other commands do not; " in said.stdout


def test_faults_of_a_running_flight_need_unix_sockets(tmp_path: Path) -> None:
    refused = done(tmp_path, "inject", "control.sock", "kind=lost")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "no Unix sockets" in refused.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        "simulate descent.yaml --out descent.csv --plot descent.png",
        "plan descent.yaml",
        "detection descent.yaml",
        "ground descent.yaml --set site=cratered",
        "hazards hazards.yaml",
        "campaign dispersed_descent.yaml --plan --runs 4",
        "campaign dispersed_descent.yaml --out results --runs 4",
    ],
)
def test_computing_works(command: str, tmp_path: Path) -> None:
    flown = done(tmp_path, *command.split())
    assert flown.returncode == 0, flown.stderr
