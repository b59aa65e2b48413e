"""The speckle of beams that hardly move between shots, against the overlap of Gaussian modes and its closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import echoes
from scipy import stats
from speckle_process import speckle_at, speckle_model

import lidar_emu
from lidar_emu.receiver.echoes import LEAST_FADE
from lidar_emu.receiver.returns import FACE, Echoes
from lidar_emu.receiver.speckle_field import set_place
from lidar_emu.scenario.load import load

WAIST_M, WAVELENGTH_M = 0.017, 1550e-9
RAYLEIGH_M = np.pi * WAIST_M**2 / WAVELENGTH_M
DOWN = np.array([0.0, 0.0, -1.0])
Place = tuple[np.ndarray, np.ndarray]
"""Sensor and axis."""


def _beams(
    places: list[Place], beams: int, beamlets: int, drift_mps: tuple[float, float, float] = (0, 0, 0)
) -> Echoes:
    """A shot at each place, of independent beams."""
    light = echoes(np.full((len(places), beams, beamlets), 500.0), 10.0)
    for s, (sensor_m, axis) in enumerate(places):
        for b in range(beams):
            rows = light.speckle_place[s, b], light.speckle_motion[s, b]
            set_place(np.array(axis, float), tuple(map(float, sensor_m)), drift_mps, WAIST_M, *rows)
    return light


def _field(places: list[Place], beams: int = 200, beamlets: int = 61) -> np.ndarray:
    """(places, beams, beamlets)"""
    light, shot = _beams(places, beams, beamlets), np.arange(len(places))
    return speckle_at(speckle_model(), light, np.zeros(1), shot)[:, :, 0, 0]


def _correlation(one: Place, other: Place) -> float:
    first, second = _field([one, other])
    return float(abs(np.mean(np.conj(first) * second)))


def _tilted(angle_rad: float, azimuth_rad: float = 0.0) -> np.ndarray:
    sine = np.sin(angle_rad)
    return np.array([sine * np.cos(azimuth_rad), sine * np.sin(azimuth_rad), -np.cos(angle_rad)])


def _modes_overlap(one: Place, other: Place) -> float:
    """Overlap of the two-way modes on level ground at the height 0: the correlation of light from random scatterers."""

    def mode(place: Place, points_m: np.ndarray) -> np.ndarray:
        sensor_m, axis = place
        along = (points_m - sensor_m) @ axis
        across2 = np.sum((points_m - sensor_m) ** 2, axis=-1) - along**2
        width2 = WAIST_M**2 * (1 + (along / RAYLEIGH_M) ** 2)
        curvature_m = along * (1 + (RAYLEIGH_M / along) ** 2)
        phase = 2 * np.pi / WAVELENGTH_M * (along + across2 / (2 * curvature_m)) - np.arctan(
            along / RAYLEIGH_M
        )
        return np.exp(-2 * across2 / width2 + 2j * phase) / width2

    height_m = max(one[0][2], other[0][2])
    reach_m = 3 * WAIST_M * np.hypot(1, height_m / RAYLEIGH_M)
    centre_m = one[0] + one[1] * (one[0][2] / -one[1][2])
    side = np.linspace(-reach_m, reach_m, 700)
    points_m = np.stack([*np.meshgrid(centre_m[0] + side, centre_m[1] + side), np.zeros((700, 700))], axis=-1)
    a, b = mode(one, points_m), mode(other, points_m)
    return float(abs(np.vdot(a, b)) / np.sqrt(np.vdot(a, a).real * np.vdot(b, b).real))


def test_field_is_circular_gaussian() -> None:
    z = _field([(np.array([1e3 * k, -70.0 * k, 500.0]), _tilted(0.1 + 1e-3 * k)) for k in range(20)], beams=5)
    assert stats.kstest(abs(z.ravel()) ** 2, "expon").pvalue > 1e-3
    assert stats.kstest(np.angle(z.ravel()) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    for one, other in ((z[1:], z[:-1]), (z[:, 1:], z[:, :-1]), (z[..., 1:], z[..., :-1])):
        assert abs(np.mean(one * np.conj(other))) < 5 / np.sqrt(one.size)


AT_HEIGHT = [50.0, 500.0, 5000.0]
MOTIONS = {
    "across": (np.array([0.009, 0.004, 0.0]), 0.0),
    "along": (np.array([0.0, 0.0, -45.0]), 0.0),
    "turn": (np.zeros(3), 2e-5),
    "across and turn": (np.array([0.006, -0.008, 0.0]), -1.5e-5),
}


@pytest.mark.parametrize("height_m", AT_HEIGHT)
@pytest.mark.parametrize("motion", MOTIONS)
def test_correlation_is_the_overlap_of_the_modes(motion: str, height_m: float) -> None:
    """On the ground, whatever the range: not at infinity, where the waves come from."""
    moved_m, turned_rad = MOTIONS[motion]
    start = np.array([300.0, -200.0, height_m])
    one, other = (start, _tilted(0.0)), (start + moved_m, _tilted(turned_rad))
    assert _correlation(one, other) == pytest.approx(_modes_overlap(one, other), abs=0.03)


@pytest.mark.parametrize("along_m", [0.0, 300.0, 600.0, 1000.0, 2344.0])
@pytest.mark.parametrize(
    "axis", [DOWN, np.array([0.6, 0.0, -0.8]), np.array([0.1, 0.995, 0.0]) / np.hypot(0.1, 0.995)]
)
def test_correlation_along_the_beam(axis: np.ndarray, along_m: float) -> None:
    """1/(1 + jz/2zR): 0.58 and 0.20 of the power's after one and 2.3 km."""
    start = np.array([40.0, 70.0, 3000.0])
    found = _correlation((start, axis), (start + along_m * axis, axis))
    assert found**2 == pytest.approx(1 / (1 + (along_m / (2 * RAYLEIGH_M)) ** 2), abs=0.04)


@pytest.mark.parametrize("origin_m", [0.0, 5000.0])
@pytest.mark.parametrize("turn_w", [0.0, 0.4, 0.9, 1.3])
def test_correlation_over_a_turn(origin_m: float, turn_w: float) -> None:
    """exp(-(π w0 θ/λ)²), however far the sensor is from the site's origin."""
    sensor_m, turn_rad = np.array([origin_m, 0.0, 1000.0]), turn_w * WAVELENGTH_M / (np.pi * WAIST_M)
    found = _correlation((sensor_m, _tilted(0.3)), (sensor_m, _tilted(0.3 + turn_rad)))
    assert found == pytest.approx(np.exp(-(turn_w**2)), abs=0.03)


def test_nothing_comes_back_far_away() -> None:
    """Directions at equal distances would send the same light again after λ/2 over their distance."""
    for across_m in (0.05, 0.0675, 0.135, 1.0):
        assert (
            _correlation((np.array([0.0, 0.0, 900.0]), DOWN), (np.array([across_m, 0.0, 900.0]), DOWN)) < 0.03
        )


def test_a_single_beamlet_has_the_waves_of_many() -> None:
    one, other = (np.array([0.0, 0.0, 900.0]), DOWN), (np.array([0.03, 0.0, 900.0]), DOWN)
    first, second = _field([one, other], beams=3000, beamlets=1)[..., 0]
    assert np.mean(abs(first) ** 2) == pytest.approx(1.0, abs=5 / np.sqrt(3000))
    assert stats.kstest(abs(first) ** 2, "expon").pvalue > 1e-3
    power = np.corrcoef(abs(first) ** 2, abs(second) ** 2)[0, 1]
    assert power == pytest.approx(np.exp(-2 * (0.03 / WAIST_M) ** 2), abs=0.07)


def test_drift_within_a_measurement_is_a_motion_across() -> None:
    model, start, drift = speckle_model(), np.array([10.0, 20.0, 700.0]), (9.0, -12.0, 0.0)
    light = _beams([(start, DOWN)], 50, 61, drift)
    times_s = np.array([-4e-4, 0.0, 5e-4])
    gliding = speckle_at(model, light, times_s, np.zeros(1))[0, :, :, 0]
    moved = _field([(start + np.array(drift) * time_s, DOWN) for time_s in times_s], beams=50)
    apart = abs(gliding - np.moveaxis(moved, 0, 1)).max(axis=(1, 2))
    # Between measurements, waves of some beams are others.
    assert np.median(apart) < 2e-4


def test_a_steady_beam_forgets_its_waves() -> None:
    """Over 60 m its beamlets return the same mean power, as from scatterers: waves for ever would leave 0.4 of it."""
    places = [(np.array([0.03 * k, -0.02 * k, 900.0]), _tilted(0.4)) for k in range(2000)]
    mean = np.mean(abs(_field(places, beams=10)) ** 2, axis=0)
    assert mean.std() < 0.1


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_a_place_that_is_no_number_has_the_speckle_of_its_shot(value: float) -> None:
    light = _beams([(np.array([10.0, 20.0, 700.0]), DOWN)], 1, 5)
    other = echoes(np.full((1, 1, 5), 500.0), 10.0)
    for column in range(6):
        hostile = light.speckle_place.copy()
        hostile[0, 0, column] = value
        fields = [
            speckle_at(speckle_model(), each, np.zeros(1), np.arange(1))
            for each in (light._replace(speckle_place=hostile), other)
        ]
        np.testing.assert_array_equal(*fields)


def _glide(across_mps: float, shots: int) -> dict[str, object]:
    """Four beams straight down that glide over level ground, a hundred shots a second; 0.1 degrees down."""
    half_m = 0.51 * across_mps * float(np.sin(np.radians(0.1))) * 0.01 * shots
    waypoints = [{"altitude_m": 300 + side * half_m, "speed_mps": across_mps} for side in (1, -1)]
    return {
        "timing.rate_hz": 100,
        "duration_s": 0.01 * shots,
        "site": {"base": "flat"},
        "scanner": {"pattern": {"kind": "directions", "beams": [[0, 0]] * 4}},
        "trajectory": {"kind": "profile", "path_angle_deg": 0.1, "waypoints": waypoints},
    }


@pytest.mark.parametrize(("side", "in_field"), [(0.98, True), (1.02, False)])
def test_both_sides_of_the_rule(side: float, in_field: bool) -> None:
    """Where the power's correlation from shot to shot falls to a thousandth, nothing else changes."""
    limit_mps = WAIST_M * np.sqrt(-0.5 * np.log(LEAST_FADE)) * 100.0
    run = lidar_emu.simulate(load("descent", _glide(side * limit_mps, 600)), seed=2)
    from lidar_emu.shots.model import build_model, initial_state, measure

    model = build_model(load("descent", _glide(side * limit_mps, 600)))
    measure(model, 5, 1, initial_state(model))
    faces = model.echo_model._echoes.speckle_place[..., FACE]  # type: ignore[attr-defined]
    assert (faces != 0).all() == in_field
    power = 10 ** (run.snr_db / 10)
    assert run.range_valid.mean() > 0.9
    relative = np.nan_to_num(power / np.nanmean(power))
    near = np.corrcoef(relative[1:].ravel(), relative[:-1].ravel())[0, 1]
    assert abs(near) < 4 / np.sqrt(relative.size)


@pytest.mark.parametrize("across_w", [0.3, 0.7, 1.1])
def test_shots_near_each_other_fade_together(across_w: float) -> None:
    """exp(-2D²/w0²), through all of the product."""
    run = lidar_emu.simulate(load("descent", _glide(across_w * WAIST_M * 100.0, 1500)), seed=4)
    power = np.nan_to_num(10 ** (run.snr_db / 10))
    found = np.corrcoef(power[1:].ravel(), power[:-1].ravel())[0, 1]
    independent = power.size * min(1.0, across_w)
    # Segments average some of the fading, which lowers the contrast and not the correlation.
    assert found == pytest.approx(np.exp(-2 * across_w**2), abs=4 / np.sqrt(independent) + 0.03)


def test_a_beam_straight_down_in_a_vertical_descent_fades_as_its_mode_grows() -> None:
    """From 2 to 1 km the power keeps 0.58 of its correlation, not all of it."""
    keys = _glide(1.0, 2) | {
        "timing.rate_hz": 0.05,
        "duration_s": 39,
        "trajectory": {
            "kind": "profile",
            "waypoints": [{"altitude_m": 2000, "speed_mps": 50}, {"altitude_m": 10, "speed_mps": 50}],
        },
    }
    scenario = load("descent", keys)
    power = np.array([10 ** (lidar_emu.simulate(scenario, seed=seed).snr_db[:2] / 10) for seed in range(150)])
    early, late = np.nan_to_num(power[:, 0]).ravel(), np.nan_to_num(power[:, 1]).ravel()
    expected = 1 / (1 + (1000 / (2 * RAYLEIGH_M)) ** 2)
    assert np.corrcoef(early, late)[0, 1] == pytest.approx(expected, abs=0.12)
