"""Firmware flies on emulated processors: it receives every shot with the values of `simulate`, and commands."""

from __future__ import annotations

import os
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from installed_programs import with_programs

from lidar_emu import Measurement, load, simulate

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "flight_processor"))

from fly import PROCESSORS, fly, missing

pytestmark = pytest.mark.slow
SETTINGS = {
    "timing.rate_hz": "20",
    "trajectory.waypoints": "[{altitude_m: 560, speed_mps: 40}, {altitude_m: 440, speed_mps: 36}]",
    "device.boot_s": "0.5",
    "device.self_test_s": "0.5",
    "device.housekeeping_rate_hz": "10",
}
ANGLE, RANGES, SPEEDS, ALTITUDE, VELOCITY = 3, slice(4, 8), slice(8, 12), 12, slice(13, 16)
SHOTS_LOST, BAD_FRAMES = 16, 17


@cache
def simulated() -> Measurement:
    """The same flight without a wire."""
    return simulate(load("descent.yaml", SETTINGS))


def steps(values: np.ndarray, valid: np.ndarray, steps_per_unit: int) -> list[str]:
    """Values as the firmware prints them."""
    rounded = np.floor(values * steps_per_unit + 0.5)
    return [f"{value:.0f}" if is_valid else "none" for value, is_valid in zip(rounded, valid, strict=True)]


def expected(shot: int) -> list[str]:
    """Ranges in mm and speeds in 0.1 mm/s of a shot."""
    truth = simulated()
    return [
        *steps(truth.range_m[shot], truth.range_valid[shot], 1000),
        *steps(truth.closing_speed_mps[shot], truth.speed_valid[shot], 10_000),
    ]


def solved(shot: int) -> tuple[float, np.ndarray]:
    """Altitude and velocity of a shot by least squares, in m and m/s."""
    truth = simulated()
    valid, angle = truth.speed_valid[shot], np.radians(truth.beam_angle_deg[shot])
    azimuth = np.radians(45 + 90 * np.arange(4))
    axes = np.stack(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1
    )
    velocity_mps = np.linalg.lstsq(axes[valid], truth.closing_speed_mps[shot, valid], rcond=None)[0]
    return float(np.mean((truth.range_m[shot] * axes[:, 2])[truth.range_valid[shot]])), velocity_mps


@pytest.mark.parametrize("processor", PROCESSORS)
def test_a_flight(processor: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if wanted := missing(processor):
        pytest.skip(wanted)
    for name, value in with_programs().items():
        monkeypatch.setitem(os.environ, name, value)
    settings = [part for key, value in SETTINGS.items() for part in ("--set", f"{key}={value}")]
    sent, lines = fly(processor, tmp_path, settings)
    shots = [line.split() for line in lines if line.startswith("shot ")]
    assert sent == len(shots) == len(simulated().time_s)
    assert [int(shot[1]) for shot in shots] == list(range(sent))
    assert (shots[-1][SHOTS_LOST], shots[-1][BAD_FRAMES]) == ("0", "0")
    assert {shot[ANGLE] for shot in shots} == {"2250", "750"}
    for number, shot in enumerate(shots):
        assert int(shot[ANGLE]) == round(100 * simulated().beam_angle_deg[number, 0]), number
        assert shot[RANGES] + shot[SPEEDS] == expected(number), number
        if np.count_nonzero(simulated().speed_valid[number]) >= 3:
            altitude_m, velocity_mps = solved(number)
            assert float(shot[ALTITUDE]) / 1000 == pytest.approx(altitude_m, abs=0.002)
            velocity = np.array(shot[VELOCITY], float) / 1000
            np.testing.assert_allclose(velocity, velocity_mps, atol=0.003)
    answers = [line.split() for line in lines if line.startswith("acknowledge ")]
    accepted = [answer[1] for answer in answers if answer[3] == "0"]
    assert list(dict.fromkeys(accepted)) == ["1", "2"], "set_mode, then set_pattern"
