"""Trials in which the host flies the vehicle: it sends live truth, in real time and in lockstep."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from free_ports import free_udp_port

from lidar_emu.cli import cli
from lidar_emu.errors import InputError

LANDER = Path(__file__).resolve().parents[1] / "support" / "lander.py"
PACK = """
name: landing
requirements:
  - {id: ALTITUDE, text: Altitudes are within 2 m., solution: altitude_error_m_abs, at_most: 2, share: 0.9}
  - {id: VELOCITY, text: Speeds are within 1 m/s., solution: vertical_speed_error_mps_abs, at_most: 1, share: 0.9}
  - {id: AVAILABLE, text: Solutions are there., flight: available_share, at_least: 0.5}
  - {id: TOUCHDOWN, text: It lands at 2 m/s at most., flight: touchdown_vertical_speed_mps, at_most: 2}
  - {id: SPEED, text: It lands at 2 m/s at most., flight: touchdown_speed_mps, at_most: 2}
  - {id: DISTANCE, text: It lands at the origin., flight: touchdown_distance_m, at_most: 5}
  - {id: GROUND, text: It reaches the ground., flight: touchdown_altitude_m, at_most: 1.5}
cases:
  - id: landing
    question: Does it land softly?
    scenario: live.yaml
    set: {site: flat, trajectory.listen: "udp:127.0.0.1:PORT"}
"""
MISSED = {"": set(), "sign of the speed": {"VELOCITY", "TOUCHDOWN", "SPEED"}}
"""Requirements that each lander must miss."""


@pytest.fixture
def pack(tmp_path: Path) -> Path:
    (folder := tmp_path / "landing").mkdir()
    (folder / "pack.yaml").write_text(PACK.replace("PORT", str(free_udp_port())))
    return folder


def trial(pack: Path, *arguments: str) -> Result:
    out = str(pack.parent / "out")
    return CliRunner().invoke(cli, ["trial", str(pack), "--port", "pty", "--out", out, *arguments])


def landed(pack: Path, pace: str, mistake: str) -> dict[str, Any]:
    """The case of a flight, as JSON."""
    lander = shlex.join([sys.executable, str(LANDER), "{port}", "{truth}", pace, mistake])
    trial(pack, "--baud", "921600", "--pace", pace, "--host", lander)
    (case,) = json.loads((pack.parent / "out" / "trial.json").read_text())["cases"]
    return dict(case)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISSED)
def test_a_landing_is_judged_alike_in_real_time_and_in_lockstep(mistake: str, pack: Path) -> None:
    for pace in ("wall", "lockstep"):
        case = landed(pack, pace, mistake)
        missed = {one["id"] for one in case["requirements"] if one["verdict"] != "pass"}
        assert missed == MISSED[mistake], (pace, case)
        (speed_mps,) = (one["figures"]["touchdown_speed_mps"] for one in case["flights"])
        if mistake:
            # It falls freely from 30 m at 10 m/s: v^2 = 10^2 + 2 g h, to 0.3 m, with a shot of 0.05 s at the end.
            assert speed_mps == pytest.approx((100 + 2 * 1.62 * 29.7) ** 0.5, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("pace", ["wall", "lockstep"])
def test_a_host_that_ends_in_flight_misses_everything(pace: str, pack: Path) -> None:
    case = landed(pack, pace, "dies")
    assert all(one["verdict"] != "pass" for one in case["requirements"])
    assert "ended with exit code 0 before the last truth: no fuel" in case["flights"][0]["problem"]


@pytest.mark.slow
def test_a_host_that_hangs_in_lockstep_misses_everything(pack: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidar_emu.trial.fly._HANGS_S", 3.0)
    case = landed(pack, "lockstep", "hangs")
    assert case["flights"][0]["problem"] == "no truth of the host for 3 s"


@pytest.mark.slow
def test_a_flight_that_is_over_in_the_air_has_not_landed(pack: Path) -> None:
    text = (pack / "pack.yaml").read_text()
    (pack / "pack.yaml").write_text(text.replace("set: {", "set: {duration_s: 3, "))
    case = landed(pack, "wall", "hangs")
    missed = {one["id"] for one in case["requirements"] if one["verdict"] != "pass"}
    assert {"GROUND", "TOUCHDOWN"} <= missed
    assert "DISTANCE" not in missed
    # It is extrapolated from the height that it had after a second, at 3 m/s or more.
    assert 1.5 < case["flights"][0]["figures"]["touchdown_altitude_m"] < 25


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["--pace", "max"], "--pace: must be wall or lockstep"),
        (["--jobs", "2", "--host", "cat"], "--jobs: must be 1"),
    ],
)
def test_what_does_not_suit_live_truth_is_one_line(arguments: list[str], reported: str, pack: Path) -> None:
    done = trial(pack, *arguments)
    assert isinstance(done.exception, InputError)
    assert str(done.exception).startswith(reported)
    assert not (pack.parent / "out").exists()


def test_a_planned_flight_has_no_lockstep(tmp_path: Path) -> None:
    words = ["trial", "nominal", "--port", "pty", "--pace", "lockstep", "--out", str(tmp_path / "out")]
    found = CliRunner().invoke(cli, words).exception
    assert isinstance(found, InputError)
    assert str(found).startswith("--pace: must be wall or max unless trajectory.kind is live")
