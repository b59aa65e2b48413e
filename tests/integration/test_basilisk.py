"""Basilisk in the loop: the example lands by the lidar's packets, and its parts agree with geometry."""

from __future__ import annotations

import csv
import importlib
import importlib.util
import math
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from programs import Program
from waiting import LIMIT_S

from lidar_protocol import Message, SerialReceiver, default_interface

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "basilisk_descent"
Load = Callable[[str], ModuleType]


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Load:
    """A module of the example, as its programs import it."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    return importlib.import_module


def test_the_ground_stands_still_in_the_site_frame(load: Load) -> None:
    """A stone on the ground, an hour later: where it was, at rest, though it moves at ω r cos(latitude)."""
    site = load("site_frame").SiteFrame(60.0, 23.0, 1_737_400.0, 2.6617e-6)
    stone_m = np.array([300.0, -200.0, 50.0])
    for time_s in (0.0, 3600.0):
        position_m, velocity_mps = site.to_inertial(time_s, stone_m, np.zeros(3))
        assert np.linalg.norm(velocity_mps) == pytest.approx(2.6617e-6 * 1_737_400 * 0.5, rel=1e-3)
        back_m, at_rest_mps = site.to_site(time_s, position_m, velocity_mps)
        assert back_m == pytest.approx(stone_m, abs=1e-8)
        assert at_rest_mps == pytest.approx(np.zeros(3), abs=1e-12)
    up = site.site_from_inertial(0.0).T @ [0.0, 0.0, 1.0]
    assert up == pytest.approx(
        [0.5 * math.cos(math.radians(23)), 0.5 * math.sin(math.radians(23)), 0.75**0.5]
    )


@pytest.mark.parametrize("blind", [None, 2])
def test_beams_on_a_slope_give_height_normal_and_velocity(load: Load, blind: int | None) -> None:
    """Ranges and speeds of a plane in closed form; three beams do."""
    estimate = load("estimate")
    up, height_m, velocity_mps = np.array([0.1, -0.2, -1.0]), 120.0, np.array([3.0, -4.0, 9.0])
    up /= np.linalg.norm(up)
    beams: list[dict[str, Any]] = []
    for k, azimuth_deg in enumerate((45.0, 135.0, 225.0, 315.0)):
        off, around = math.radians(22.5), math.radians(azimuth_deg)
        axis = [math.sin(off) * math.cos(around), math.sin(off) * math.sin(around), math.cos(off)]
        valid = k != blind
        beams.append(
            {
                "beam_angle_deg": 22.5,
                "range_valid": valid,
                "speed_valid": valid,
                "range_m": height_m / -float(up @ axis) if valid else None,
                "closing_speed_mps": float(velocity_mps @ axis) if valid else None,
            }
        )
    reported = estimate.solve(Message(0, {}, tuple(beams)))
    assert reported.height_m == pytest.approx(height_m)
    assert reported.up_body == pytest.approx(up)
    assert reported.velocity_body_mps == pytest.approx(velocity_mps)
    assert reported.climb_mps == pytest.approx(float(up @ velocity_mps))
    assert reported.drift_body_mps @ up == pytest.approx(0, abs=1e-9)
    for beam in beams[:2]:
        beam["range_valid"] = False
    assert estimate.solve(Message(0, {}, tuple(beams))) is None


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


def table(file: Path) -> list[dict[str, float]]:
    with file.open(newline="") as opened:
        return [{name: float(text) for name, text in row.items()} for row in csv.DictReader(opened)]


def land(start: Callable[..., Program], folder: Path) -> None:
    """Emulator, navigator and simulation, to touchdown."""
    folder.mkdir()
    listens, commands = (f"127.0.0.1:{free_port()}" for _ in range(2))
    scenario = str(EXAMPLE / "descent.yaml")
    run = start(
        "run", scenario, "--pace", "lockstep", "--port", "pty", "--set", f"trajectory.listen=udp:{listens}"
    )
    pty = run.word_after(" on ")
    navigator = subprocess.Popen(
        [sys.executable, EXAMPLE / "navigator.py", pty, "--commands", commands, "--log", "navigator.csv"],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        subprocess.run(
            [
                *(sys.executable, EXAMPLE / "simulation.py", "--truth", listens, "--commands", commands),
                *("--log", "truth.csv", "--packets", "packets.bin"),
            ],
            cwd=folder,
            check=True,
            timeout=LIMIT_S,
        )
        run.succeed()
        output, _ = navigator.communicate(timeout=LIMIT_S)
    finally:
        navigator.kill()
        navigator.wait()
    assert navigator.returncode == 0
    assert output.endswith(" 0 lost\n")


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("Basilisk") is None,
    reason="Basilisk is not installed: pip install 'lidar-emu[basilisk]'",
)
def test_basilisk_lands_by_the_packets_and_lands_the_same_way_again(
    start: Callable[..., Program], tmp_path: Path
) -> None:
    for name in ("first", "second"):
        land(start, tmp_path / name)
    flown, seen = table(tmp_path / "first" / "truth.csv"), table(tmp_path / "first" / "navigator.csv")
    assert flown[0]["height_m"] > 700
    assert math.hypot(flown[0]["east_mps"], flown[0]["north_mps"]) > 10
    landing = [row for row in flown if row["height_m"] <= 5]
    assert landing[-1]["height_m"] <= 1.5
    for row in landing:
        assert 0 < -row["up_mps"] < 2
        assert math.hypot(row["east_mps"], row["north_mps"]) < 0.3

    # The size of the velocity is the same whatever the ground's slope makes of climb and drift.
    speed_mps = [math.hypot(row["climb_mps"], row["drift_mps"]) for row in seen]
    flown_mps = [math.hypot(row["east_mps"], row["north_mps"], row["up_mps"]) for row in flown]
    when_s = [row["time_s"] for row in seen]
    true_mps = np.interp(when_s, [row["time_s"] for row in flown], flown_mps)
    assert np.abs(speed_mps - true_mps).max() < 0.005

    packets = (tmp_path / "first" / "packets.bin").read_bytes()
    assert len(SerialReceiver(default_interface()).receive(packets)) == len(seen) > 1000
    assert packets == (tmp_path / "second" / "packets.bin").read_bytes()
    assert (tmp_path / "first" / "truth.csv").read_bytes() == (tmp_path / "second" / "truth.csv").read_bytes()
