"""A flight with the firmware of examples/flight_processor, and what its report is held to."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from installed_programs import with_programs

from lidar_emu import Measurement, load, simulate
from lidar_emu.recording.read import read_recording
from lidar_emu.recording.readers import HostMessages

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "flight_processor"))

from fly import ON_CAN, PROCESSORS, fly, missing

__all__ = [
    "ON_CAN",
    "PROCESSORS",
    "assert_commanded",
    "assert_shots",
    "assert_solutions",
    "flown",
    "simulated",
]

_SETTINGS = {
    "timing.rate_hz": "20",
    "trajectory.waypoints": "[{altitude_m: 560, speed_mps: 40}, {altitude_m: 440, speed_mps: 36}]",
    "device.boot_s": "0.5",
    "device.self_test_s": "0.5",
    "device.housekeeping_rate_hz": "10",
}
_ON_CAN_SETTINGS = _SETTINGS | {
    "timing.rate_hz": "5",
    "trajectory.waypoints": "[{altitude_m: 560, speed_mps: 8}, {altitude_m: 440, speed_mps: 7}]",
    "device.housekeeping_rate_hz": "2",
}
"""Slow enough for a kernel run as a program, whose one processor computes shots and firmware beside other kernels."""
_NUMBER, _TIME, _ANGLE, _RANGES, _SPEEDS = 1, 2, 3, slice(4, 8), slice(8, 12)
_ALTITUDE, _VELOCITY = 12, slice(13, 16)


@dataclass(frozen=True)
class Flown:
    """Shots that the lidar sent, and words of the lines that the firmware reported."""

    sent: int
    solutions: HostMessages
    shots: list[list[str]]
    acknowledges: list[list[str]]

    @property
    def numbers(self) -> list[int]:
        """Shots that the firmware received."""
        return [int(shot[_NUMBER]) for shot in self.shots]

    @property
    def lost_and_bad(self) -> tuple[int, int]:
        """Shots lost and bad frames in the last line."""
        lost, bad = self.shots[-1][16:18]
        return int(lost), int(bad)


def flown(processor: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Flown:
    """Fly; skip the test if the processor needs what is missing."""
    if wanted := missing(processor):
        pytest.skip(wanted)
    for name, value in with_programs().items():
        monkeypatch.setitem(os.environ, name, value)
    settings = [part for key, value in _settings(processor).items() for part in ("--set", f"{key}={value}")]
    sent, report = fly(processor, folder, settings)
    lines = [line.split() for line in report]
    shots, acknowledges = ([line for line in lines if line[0] == word] for word in ("shot", "acknowledge"))
    solutions = read_recording(folder / "flight.mcap").host_messages()
    return Flown(sent, solutions, shots, acknowledges)


def _settings(processor: str) -> dict[str, str]:
    return _ON_CAN_SETTINGS if processor == ON_CAN else _SETTINGS


@cache
def simulated(processor: str) -> Measurement:
    """The same flight without a wire."""
    return simulate(load("descent.yaml", _settings(processor)))


def assert_shots(processor: str, shots: Iterable[list[str]]) -> None:
    """Check angles, ranges and speeds against `simulate`, and what is solved against a solution in double precision."""
    truth = simulated(processor)
    for shot in shots:
        number = int(shot[_NUMBER])
        assert int(shot[_ANGLE]) == round(100 * truth.beam_angle_deg[number, 0]), number
        assert shot[_RANGES] + shot[_SPEEDS] == _expected(truth, number), number
        if np.count_nonzero(truth.speed_valid[number]) >= 3:
            altitude_m, velocity_mps = _solved(truth, number)
            assert float(shot[_ALTITUDE]) / 1000 == pytest.approx(altitude_m, abs=0.002)
            velocity = np.array(shot[_VELOCITY], float) / 1000
            np.testing.assert_allclose(velocity, velocity_mps, atol=0.003)


def assert_solutions(flight: Flown) -> None:
    """Check the solutions that the lidar received against those that the firmware reported. How many come before the
    end depends on the machine."""
    reported = {int(shot[_TIME]): shot for shot in flight.shots}
    found, values = flight.solutions, flight.solutions.values
    assert 0 < len(found) <= len(flight.shots)
    assert (np.diff(found.sequence) > 0).all()
    for row, time_ns in enumerate(values["time_ns"].tolist()):
        shot = reported[time_ns]
        for word, number in (
            (shot[_ALTITUDE], values["altitude_m"][row]),
            (shot[_VELOCITY][2], -values["velocity_up_mps"][row]),
        ):
            assert (
                np.isnan(number)
                if word == "none"
                else float(word) / 1000 == pytest.approx(number, abs=0.0011)
            )


def assert_commanded(flight: Flown) -> None:
    """Check that the device accepted set_mode, then set_pattern, and flew with both patterns."""
    accepted = [command for _, command, _, verdict in flight.acknowledges if verdict == "0"]
    assert list(dict.fromkeys(accepted)) == ["1", "2"]
    assert {shot[_ANGLE] for shot in flight.shots} == {"2250", "750"}


def _expected(truth: Measurement, shot: int) -> list[str]:
    """Ranges in mm and speeds in 0.1 mm/s of a shot."""
    return [
        *_steps(truth.range_m[shot], truth.range_valid[shot], 1000),
        *_steps(truth.closing_speed_mps[shot], truth.speed_valid[shot], 10_000),
    ]


def _steps(values: np.ndarray, valid: np.ndarray, steps_per_unit: int) -> list[str]:
    """Values as the firmware prints them."""
    rounded = np.floor(values * steps_per_unit + 0.5)
    return [f"{value:.0f}" if is_valid else "none" for value, is_valid in zip(rounded, valid, strict=True)]


def _solved(truth: Measurement, shot: int) -> tuple[float, np.ndarray]:
    """Altitude and velocity of a shot by least squares, in m and m/s."""
    valid, angle = truth.speed_valid[shot], np.radians(truth.beam_angle_deg[shot])
    azimuth = np.radians(45 + 90 * np.arange(4))
    axes = np.stack(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1
    )
    velocity_mps = np.linalg.lstsq(axes[valid], truth.closing_speed_mps[shot, valid], rcond=None)[0]
    return float(np.mean((truth.range_m[shot] * axes[:, 2])[truth.range_valid[shot]])), velocity_mps
