"""Basilisk in the loop: the example lands by the lidar's packets, and its parts agree with geometry."""

from __future__ import annotations

import csv
import importlib
import importlib.util
import math
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from installed_programs import with_programs
from waiting import LIMIT_S, eventually

from lidar_protocol import Message

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


def table(file: Path) -> list[dict[str, float]]:
    with file.open(newline="") as opened:
        return [{name: float(text) for name, text in row.items()} for row in csv.DictReader(opened)]


def printed_commands() -> list[str]:
    """The three commands for three terminals."""
    page = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    commands = re.findall(r"^    ((?:lidar-emu|python) .*)$", page, re.MULTILINE)
    assert len(commands) == 3
    return commands


def land(folder: Path) -> None:
    """Fly to touchdown with the commands of the page, as printed, in a copy of the example."""
    shutil.copytree(EXAMPLE.parent, folder)
    terminals = []
    try:
        for command in printed_commands():
            if " lidar " in command:
                eventually((folder / EXAMPLE.name / "lidar").exists)
            terminals.append(
                subprocess.Popen(
                    shlex.split(command),
                    cwd=folder / EXAMPLE.name,
                    env=with_programs(),
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                )
            )
        *_, navigator, simulation = terminals
        _, reason = simulation.communicate(timeout=LIMIT_S)
        assert simulation.returncode == 0, reason
        output, reason = navigator.communicate(timeout=LIMIT_S)
        assert navigator.returncode == 0, reason
        assert output.endswith(" 0 lost\n")
        assert terminals[0].wait(LIMIT_S) == 0
    finally:
        for terminal in terminals:
            terminal.kill()
            terminal.communicate()


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("Basilisk") is None,
    reason="Basilisk is not installed: pip install '.[basilisk]'",
)
def test_basilisk_lands_by_the_packets_and_lands_the_same_way_again(tmp_path: Path) -> None:
    first, second = (tmp_path / name for name in ("first", "second"))
    for folder in (first, second):
        land(folder)
    first, second = (folder / EXAMPLE.name for folder in (first, second))
    flown, seen = table(first / "truth.csv"), table(first / "navigator.csv")
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

    assert len(seen) > 1000
    for log in ("truth.csv", "navigator.csv"):
        assert (first / log).read_bytes() == (second / log).read_bytes()
