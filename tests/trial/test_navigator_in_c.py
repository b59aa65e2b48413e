"""The navigator in C: it compiles as strictly as compilers go, passes where it must, and refuses what it cannot use."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from c_programs import COMPILER, NEEDS_COMPILER, SANITIZERS, STRICT
from click.testing import CliRunner

from lidar_emu.cli import cli

ROOT = Path(__file__).resolve().parents[2]
PACK = """
name: short
requirements:
  - {id: ALTITUDE, text: Altitudes are right., solution: altitude_error_m_abs, at_most: 3, share: 0.95}
  - {id: VELOCITY, text: Velocities are right., solution: velocity_error_mps_abs, at_most: 0.5, share: 0.95}
  - {id: AVAILABLE, text: Solutions are there., flight: available_share, at_least: 0.75}
  - {id: SIGMAS, text: Sigmas are right., flight: velocity_within_3_sigma, at_least: 0.9}
  - {id: DISTRUST, text: A wrong beam is distrusted., solution: distrust_s, at_most: 0.5}
  - {id: TRUST, text: The others are used., flight: false_distrust_share, at_most: 0.05}
cases:
  - id: biased
    question: Does it reject a beam with a false speed and range, and bridge a silent second?
    scenario: descent.yaml
    set:
      site: flat
      duration_s: 8
      trajectory.waypoints: [{altitude_m: 400, speed_mps: 30}, {altitude_m: 100, speed_mps: 20}]
      faults:
        - {kind: bias, beams: [1], range_m: 60, closing_speed_mps: 8, from_s: 3, to_s: 5}
        - {kind: silence, from_s: 6, to_s: 7}
  - id: tilted
    question: Does it turn the beams by the attitude of an inertial unit?
    scenario: powered_descent.yaml
    set: {duration_s: 6, site: flat}
"""


@pytest.fixture
def navigator(tmp_path: Path) -> str:
    source, header = ROOT / "examples" / "navigation" / "navigator.c", ROOT / "protocol" / "lidar_protocol"
    program = tmp_path / "navigator"
    subprocess.run([COMPILER, *STRICT, SANITIZERS, "-I", header, source, "-o", program, "-lm"], check=True)
    return str(program)


@pytest.mark.slow
@NEEDS_COMPILER
def test_it_passes_with_attitude_and_misses_the_tilted_case_without(navigator: str, tmp_path: Path) -> None:
    (folder := tmp_path / "short").mkdir()
    (folder / "pack.yaml").write_text(PACK)
    motion = str(tmp_path / "motion_{case}.csv")
    simulate = shlex.join([sys.executable, "-m", "lidar_emu", "simulate", "{scenario}", "--out", motion])
    with_attitude = f"sh -c {shlex.quote(f'{simulate} && exec {navigator} {{port}} {motion}')}"
    for host, missed in ((with_attitude, set()), (f"{navigator} {{port}}", {("tilted", "VELOCITY")})):
        words = ["trial", str(folder), "--port", "pty", "--baud", "921600", "--out", str(tmp_path / "out")]
        CliRunner().invoke(cli, [*words, "--host", host])
        document = json.loads((tmp_path / "out" / "trial.json").read_text())
        found = {
            (case["id"], one["id"])
            for case in document["cases"]
            for one in case["requirements"]
            if one["verdict"] != "pass"
        }
        assert found >= missed, document
        assert missed or not found, document


@NEEDS_COMPILER
def test_what_it_cannot_use_is_one_line(navigator: str, tmp_path: Path) -> None:
    table = tmp_path / "motion.csv"
    table.write_text("time_s,range_m\n0,1\n")
    for words in (
        [],
        [str(tmp_path / "no_port")],
        ["port", str(tmp_path / "none.csv")],
        ["port", str(table)],
    ):
        done = subprocess.run([navigator, *words], capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1
