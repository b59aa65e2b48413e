"""Beam axes and the lever arm of logs whose scanner and mounting are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from lidar_emu.cli import cli
from lidar_emu.sensor_fit.characteristics import Row
from lidar_emu.sensor_fit.flight_log import read_log
from lidar_emu.sensor_fit.validation import characterised

TILTS_MRAD = [[5, 0], [-5, 3], [0, -8], [10, 2]]
ARM_M = [1.5, -0.5, 2.0]
SCENARIO = f"""
name: turning
timing: {{rate_hz: 10}}
instrument: ndl_fine
site: flat
scanner:
  pattern: {{kind: square, angle_deg: 22.5}}
  misalignment_mrad: {TILTS_MRAD}
mounting: {{lever_arm_m: {ARM_M}}}
trajectory:
  kind: table
  file: motion.csv
  time: {{column: time_s, unit: s}}
  east: {{column: east_m, unit: m}}
  north: {{column: north_m, unit: m}}
  up: {{column: up_m, unit: m}}
  roll: {{column: roll_deg, unit: deg}}
  pitch: {{column: pitch_deg, unit: deg}}
  yaw: {{column: yaw_deg, unit: deg}}
"""


def rows_of(folder: Path, turns: float, wanders: float) -> dict[tuple[str, int | None], Row]:
    """Rows of a descent of 60 s that turns and wanders as much as stated."""
    t = np.arange(0, 61, 0.5)
    columns = {
        "time_s": t,
        "east_m": wanders * 60 * np.sin(t / 5),
        "north_m": wanders * 80 * np.sin(t / 7 + 1),
        "up_m": 900 - 12 * t,
        **{
            f"{name}_deg": turns * 6 * np.sin(t / s + k)
            for k, (name, s) in enumerate([("roll", 1.7), ("pitch", 2.3), ("yaw", 2.9)])
        },
    }
    rows = np.column_stack(list(columns.values()))
    np.savetxt(folder / "motion.csv", rows, delimiter=",", header=",".join(columns), comments="")
    (folder / "turning.yaml").write_text(SCENARIO)
    arguments = ["simulate", str(folder / "turning.yaml"), "--out", str(folder / "log.csv")]
    assert CliRunner().invoke(cli, arguments, catch_exceptions=False).exit_code == 0
    found = characterised(read_log(folder / "log.csv", {}), 2.0).rows
    return {(row.what, row.beam): row for row in found}


def true_axes() -> list[np.ndarray]:
    """Unit vectors in the body frame: 22.5 degrees off z at 45, 135, ... degrees from x, and tilted."""
    off, around = np.radians(22.5), np.radians([45, 135, 225, 315])
    published = np.stack(
        [np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.full(4, np.cos(off))], axis=1
    )
    return [
        Rotation.from_rotvec([x / 1e3, y / 1e3, 0]).apply(axis)
        for (x, y), axis in zip(TILTS_MRAD, published, strict=True)
    ]


def test_axes_and_lever_arm_of_a_vehicle_that_turns(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, turns=1.0, wanders=1.0)
    known = {(f"beam axis, body {name}", beam): axis[k]
             for beam, axis in enumerate(true_axes()) for k, name in enumerate("xyz")}  # fmt: skip
    known |= {(f"lever arm, body {name}", None): arm_m for name, arm_m in zip("xyz", ARM_M, strict=True)}
    held = []
    for key, true in known.items():
        found = rows[key].estimate
        held.append(found.low <= true <= found.high)
        assert abs(found.value - true) < 2.0 * (found.high - found.low), key
        # A tilt of a milliradian and an arm of a decimetre are seen.
        assert found.high - found.low < (0.1 if key[0].startswith("lever") else 1e-3), key
    assert sum(held) >= 10


@pytest.mark.parametrize("wanders", [0.0, 1e-12])
def test_a_straight_flight_shows_one_component(tmp_path: Path, wanders: float) -> None:
    straight = rows_of(tmp_path, turns=0.0, wanders=wanders)
    assert straight["beam axis, body z", 0].estimate.is_known
    assert np.isnan(straight["beam axis, body x", 0].estimate.value)
    assert straight["beam axis, body x", 0].word == "the velocity varies too little in direction"
    assert straight["lever arm, body y", None].word == "the vehicle turns too little"


def test_a_vehicle_that_wanders_without_a_turn_shows_its_beams_and_no_lever_arm(tmp_path: Path) -> None:
    wandering = rows_of(tmp_path, turns=0.0, wanders=1.0)
    assert wandering["beam axis, body x", 0].estimate.is_known
    assert wandering["lever arm, body x", None].word == "the vehicle turns too little"


def test_a_log_without_the_motion_has_no_rows(tmp_path: Path) -> None:
    rows = [f"{k / 10},{500 - k},10,{500 - k},10" for k in range(200)]
    names = "time_s,range_m,closing_speed_mps,true_range_m,true_closing_speed_mps"
    (tmp_path / "log.csv").write_text("\n".join([names, *rows]) + "\n")
    found = characterised(read_log(tmp_path / "log.csv", {}), 2.0).rows
    assert not [row for row in found if "beam axis" in row.what or "lever" in row.what]
