"""Phases of the beamlets' lattice against the sum over its beamlets, and the plan's choice of a finer one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lidar_emu.beams.footprint import beamlet_pattern
from lidar_emu.plan.motion import lattice_correlation
from lidar_emu.report.geometry_export import record_geometry
from lidar_emu.scenario.load import load
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model, measure_whole


@pytest.mark.parametrize(("count", "within"), [(7, 0.06), (19, 0.02), (37, 0.02), (61, 0.02), (127, 0.02)])
def test_the_worst_direction_is_the_largest_sum_over_the_beamlets(count: int, within: float) -> None:
    """Beyond the Gaussian's own correlation exp(-u²/16), over directions in one twelfth of a turn."""
    phase_per_w, direction_rad = np.linspace(0.0, 36.0, 73), np.linspace(0.0, np.pi / 6, 61)
    offset_w, weight = beamlet_pattern(count)
    along_w = np.cos(direction_rad) * offset_w[:, :1] + np.sin(direction_rad) * offset_w[:, 1:]
    added = [
        np.abs(weight @ np.exp(1j * phase * along_w) - np.exp(-(phase**2) / 16)).max()
        for phase in phase_per_w
    ]
    np.testing.assert_allclose(lattice_correlation(phase_per_w, count), added, atol=within)


def fast_flight(altitude_m: float, speed_mps: float, beamlets: int) -> dict[str, str]:
    """Keys of a flight over a plane with everything computed."""
    return {
        "left_out_share": "0",
        "duration_s": "0.2",
        "instrument": "{base: ndl_fine, waveform: {linewidth_hz: 0}}",
        "instrument.optics.beamlets": str(beamlets),
        "site": "flat",
        "scanner": "{pattern: {kind: directions, beams: [[7.5, 0]]}}",
        "trajectory": f"{{kind: profile, path_angle_deg: 5, waypoints: [{{altitude_m: {altitude_m + 20}, "
        f"speed_mps: {speed_mps}}}, {{altitude_m: {altitude_m - 20}, speed_mps: {speed_mps}}}]}}",
    }


@pytest.mark.parametrize(
    ("altitude_m", "speed_mps", "asked", "used"),
    [(5000.0, 100.0, 19, 37), (5000.0, 100.0, 61, 61), (5000.0, 30.0, 19, 19), (300.0, 100.0, 19, 19)],
)
def test_fast_beams_far_away_have_more_beamlets(
    altitude_m: float, speed_mps: float, asked: int, used: int
) -> None:
    """Near the ground the exchange of scatterers hides the return, and slow beams have none."""
    settings = fast_flight(altitude_m, speed_mps, asked)
    assert FlightModel(load("descent", settings)).plan.beamlets == used


def test_recorded_geometry_has_the_beamlets_of_the_plan(tmp_path: Path) -> None:
    """A flight whose plan takes more than the instrument's measures the same from the file."""
    scenario = load("descent", fast_flight(5000.0, 100.0, 19))
    path = tmp_path / "geometry.npz"
    assert record_geometry(scenario, path).beamlets == 37
    direct, replayed = (measure_whole(build_model(scenario, file)) for file in (None, path))
    assert np.isfinite(direct.range_m).any()
    np.testing.assert_array_equal(replayed.range_m, direct.range_m)
