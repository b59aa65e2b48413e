"""What arrives, against differences of the path that light takes and the decorrelation of a Gaussian beam's speckle."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.footprint import beam_radius_m, sample_footprint
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.receiver.echoes import compute_echoes
from lidar_emu.receiver.link_budget import coherent_power_w
from lidar_emu.receiver.returns import ACROSS_A, ACROSS_B, ALONG, DRIFT_A, DRIFT_B, TRAVEL
from lidar_emu.receiver.speckle_field import PITCH_W

WAIST_M, WAVELENGTH_M = 0.017, 1550e-9
RAYLEIGH_M = np.pi * WAIST_M**2 / WAVELENGTH_M
NADIR = {"pattern": {"kind": "ring", "count": 1, "angle_deg": 0}}


def tumbling(altitude_m: float) -> dict:
    """A fast slanted descent on a turning body, with the sensor away from the centre, over a slope."""
    return {
        "trajectory": {
            "kind": "profile",
            "path_angle_deg": 30,
            "heading_deg": 20,
            "waypoints": [
                {"altitude_m": altitude_m, "speed_mps": 80},
                {"altitude_m": altitude_m / 2, "speed_mps": 40},
            ],
            "attitude": {"roll_deg": 3, "pitch_deg": 2, "yaw_deg": 30, "body_rate_radps": [0.1, 0.5, -0.2]},
        },
        "mounting": {"lever_arm_m": [2.0, 0.3, -0.5], "pitch_deg": 5},
        "site": {"ground": {"kind": "plane", "slope_deg": 15, "downhill_azimuth_deg": 70}},
        "scanner": {"pattern": {"kind": "ring", "count": 3, "angle_deg": 22.5}},
        "instrument": {"optics": {"waist_radius_m": WAIST_M}},
    }


def look(scenario, shots, period_ns=None, beamlets=19):
    """Pointing, hits of the axes and echoes at shots as close together as wanted."""
    flight = Flight(scenario)
    if period_ns is not None:
        flight.period_ns = period_ns
    pointing, _ = flight.point(np.asarray(shots, dtype=np.int64), flight.scanner.initial)
    hits = flight.cast(pointing)
    return (
        pointing,
        hits,
        compute_echoes(scenario.instrument, scenario.site, flight, beamlets, pointing, hits),
    )


def path_m(pointing, point_site_m):
    """L = s + x²/(2 Rc) from the sensor to fixed points (beams, points, 3), at each shot."""
    away = point_site_m - pointing.sensor_site_m[:, :, None]
    axis = pointing.true_site[:, :, None]
    along_m = dot(away, axis)
    across = away - along_m[..., None] * axis
    return along_m + 0.5 * dot(across, across) * along_m / (along_m**2 + RAYLEIGH_M**2)


@pytest.mark.parametrize("altitude_m", [30, 300, 4000])
def test_closing_speed_of_a_beamlet_is_that_of_its_path(make_flight, altitude_m) -> None:
    pointing, hits, echoes = look(make_flight(**tumbling(altitude_m)), [0, 1, 2], period_ns=20_000)
    footprint = sample_footprint(
        pointing.sensor_site_m[1], pointing.true_site[1], hits.range_m[1], 19, WAIST_M, WAVELENGTH_M
    )
    points = footprint.start_site_m + echoes.range_m[1, ..., None] * footprint.ray_site
    path = path_m(pointing, points)
    closing_mps = -(path[2] - path[0]) / 40e-6
    np.testing.assert_allclose(echoes.closing_speed_mps[1], closing_mps, atol=3e-6)
    turning_mps = closing_mps - dot(pointing.sensor_velocity_site_mps[1, :, None], footprint.doppler_site)
    assert np.max(np.abs(turning_mps)) > 3e-4


@pytest.mark.parametrize("altitude_m", [30, 300, 4000])
def test_range_rate_is_that_of_the_moving_beam_on_the_ground(make_flight, altitude_m) -> None:
    _, _, echoes = look(make_flight(**tumbling(altitude_m)), [0, 1, 2], period_ns=20_000)
    rate_mps = (echoes.range_m[2] - echoes.range_m[0]) / 40e-6
    np.testing.assert_allclose(echoes.range_rate_mps[1][:, 0], rate_mps[:, 0], rtol=1e-7, atol=1e-6)
    # The beamlets' directions turn with their own rates, which differ by the width of the footprint.
    radius_m = beam_radius_m(echoes.range_m[1], WAIST_M, WAVELENGTH_M)
    assert np.all(np.abs(echoes.range_rate_mps[1] - rate_mps) < radius_m)
    assert np.max(np.abs(rate_mps + echoes.closing_speed_mps[1])) > 10


def test_a_beamlet_is_lit_down_to_the_ground(make_flight) -> None:
    profile = {
        "kind": "profile",
        "path_angle_deg": 90,
        "waypoints": [{"altitude_m": 0.9, "speed_mps": 1}, {"altitude_m": 0.1, "speed_mps": 1}],
    }
    _, _, echoes = look(make_flight(trajectory=profile, scanner=NADIR), [0], beamlets=1)
    assert 0.1 < echoes.range_m[0, 0, 0] < 0.95
    assert echoes.power_w[0, 0, 0] > 0


def test_range_rate_stays_finite_at_grazing_incidence(make_flight) -> None:
    scanner = {"pattern": {"kind": "ring", "count": 1, "angle_deg": 89.9999}}
    _, _, echoes = look(make_flight(scanner=scanner), [0])
    slides = echoes.range_rate_mps[~np.isnan(echoes.range_m)]
    assert slides.size
    assert np.all(np.abs(slides) < 60.001 / 1e-3)


@pytest.mark.parametrize("altitude_m", [30, 300, 4000])
def test_closing_acceleration_follows_the_beam_from_segment_to_segment(make_flight, altitude_m) -> None:
    pointing, _, echoes = look(make_flight(**tumbling(altitude_m)), [0, 1, 2], period_ns=300_000)
    closing_mps = dot(pointing.sensor_velocity_site_mps, pointing.true_site)
    by_difference = (closing_mps[2] - closing_mps[0]) / 600e-6
    np.testing.assert_allclose(echoes.closing_acceleration_mps2[1], by_difference, atol=1e-5)


@pytest.mark.parametrize("range_m", [50, 200, 585, 2000, 10_000])
@pytest.mark.parametrize(
    ("speed_mps", "rate_radps"),
    [(40, [0, 0, 0]), (1e-6, [0.02, 0.03, 0]), (20, [0.02, 0, 0]), (20, [0.02, 0.03, 0]), (20, [-0.01, -0.04, 1])],
)  # fmt: skip
def test_speckle_decorrelates_as_that_of_a_gaussian_beam(make_flight, range_m, speed_mps, rate_radps) -> None:
    """exp(-d²/w0²) for a shift, exp(-(π w0 θ/λ)²) for a turn, the product for both: at any range.

    The pattern of beamlets has the second moment of the beam exactly, its fourth a little low.
    """
    flight = {
        "kind": "profile",
        "path_angle_deg": 0.1,
        "waypoints": [
            {"altitude_m": range_m, "speed_mps": speed_mps},
            {"altitude_m": range_m - 1e-3, "speed_mps": speed_mps},
        ],
        "attitude": {"body_rate_radps": rate_radps},
    }
    _, _, echoes = look(make_flight(scanner=NADIR, trajectory=flight), [0], beamlets=127)
    time_s = np.array([100e-6, 300e-6, 600e-6])
    share = echoes.power_w[0, 0] / echoes.power_w[0, 0].sum()
    turns = 2 / WAVELENGTH_M * (echoes.closing_speed_mps[0, 0] - echoes.closing_speed_mps[0, 0, 0])
    by_phase = np.abs((share * np.exp(2j * np.pi * turns * time_s[:, None])).sum(axis=1))
    slid_w = PITCH_W * echoes.speckle_motion[0, 0, TRAVEL] * time_s
    shift_w0, turn = speed_mps * time_s / WAIST_M, np.hypot(*rate_radps[:2]) * time_s
    exponent = shift_w0**2 + (np.pi * WAIST_M * turn / WAVELENGTH_M) ** 2
    error = by_phase * np.exp(-(slid_w**2)) / np.exp(-exponent) - 1
    assert np.all(np.abs(error) < 0.03 * exponent**2 + 1e-5)
    assert np.max(exponent) > 0.1


def test_a_single_beamlet_and_the_place_decorrelate_over_the_waist(make_flight) -> None:
    """What the beamlets' own Doppler shifts do not tell, the drift of a single one and the place of the shot do."""
    slanted = {
        "kind": "profile",
        "path_angle_deg": 60,
        "waypoints": [{"altitude_m": 2000, "speed_mps": 50}, {"altitude_m": 500, "speed_mps": 50}],
    }
    scenario = make_flight(scanner=NADIR, trajectory=slanted)
    pointing, _, echoes = look(scenario, np.arange(0, 600), beamlets=1)
    moved_m = np.diff(pointing.sensor_site_m[:, 0, :2], axis=0)
    place, motion = echoes.speckle_place[:, 0], echoes.speckle_motion[:, 0]
    np.testing.assert_allclose(np.diff(place[:, [ACROSS_A, ACROSS_B]], axis=0), moved_m, atol=1e-9)
    np.testing.assert_allclose(-np.diff(place[:, ALONG]), np.diff(pointing.sensor_site_m[:, 0, 2]), atol=1e-9)
    np.testing.assert_allclose(motion[:, TRAVEL] * PITCH_W * WAIST_M, 25.0, rtol=1e-9)
    np.testing.assert_allclose(np.hypot(*motion[:, [DRIFT_A, DRIFT_B]].T), 25.0, rtol=1e-9)


def test_beams_that_meet_nothing_or_do_not_fire_have_a_place(make_flight) -> None:
    scanner = {
        "pattern": {"kind": "square", "angle_deg": 22.5},
        "switches": [{"kind": "time", "at_s": 0, "pattern": {"kind": "ring", "count": 2, "angle_deg": 85}}],
    }
    attitude = {"roll_deg": 12, "pitch_deg": 12}
    waypoints = [{"altitude_m": 1000, "speed_mps": 60}, {"altitude_m": 100, "speed_mps": 20}]
    scenario = make_flight(
        scanner=scanner, trajectory={"kind": "profile", "waypoints": waypoints, "attitude": attitude}
    )
    pointing, hits, echoes = look(scenario, [0])
    nothing = np.isnan(hits.range_m)
    assert nothing[pointing.fired].any()
    assert not pointing.fired.all()
    np.testing.assert_array_equal(echoes.speckle_motion[nothing], 0)
    assert np.isfinite(echoes.speckle_place).all()
    assert np.isfinite(echoes.closing_acceleration_mps2[pointing.fired]).all()
    np.testing.assert_array_equal(np.isnan(echoes.range_rate_mps), np.isnan(echoes.range_m))
    np.testing.assert_array_equal(echoes.power_w[np.isnan(echoes.range_m)], 0)


@pytest.mark.parametrize("air", [None, {"extinction_per_m": 2e-4, "backscatter_per_m_sr": 1e-6}])
@pytest.mark.parametrize("beamlets", [1, 19])
def test_power_is_that_of_the_link_budget(make_flight, air, beamlets) -> None:
    """Each beamlet's share of what the whole beam would return from its range and incidence, on a slope."""
    parts = tumbling(3000)
    parts["site"] |= {"atmosphere": air, "surface": {"reflectance": 0.3, "lommel_seeliger_share": 0.4}}
    parts["instrument"]["optics"] |= {"alignment_error_rad": 2e-5, "depolarisation": 0.8}
    scenario = make_flight(**parts)
    pointing, hits, echoes = look(scenario, [0, 20], beamlets=beamlets)
    for shot, beam in np.ndindex(hits.range_m.shape):
        sampled = sample_footprint(
            pointing.sensor_site_m[shot, [beam]],
            pointing.true_site[shot, [beam]],
            hits.range_m[shot, [beam]],
            beamlets,
            WAIST_M,
            WAVELENGTH_M,
        )
        cosine = -dot(hits.normal_site[shot, beam], sampled.ray_site[0])
        whole_w = coherent_power_w(
            scenario.instrument,
            scenario.site.surface,
            scenario.site.atmosphere,
            echoes.range_m[shot, beam],
            cosine,
            np.linalg.norm(np.cross(pointing.turning_site_radps, pointing.true_site)[shot, beam]),
        )
        expected_w = np.nan_to_num(whole_w * sampled.weight, nan=0.0)
        np.testing.assert_allclose(echoes.power_w[shot, beam], expected_w, rtol=1e-13)
    assert np.count_nonzero(echoes.power_w) > 3 * beamlets


def test_air_closes_with_the_sensor_less_the_wind(make_flight) -> None:
    parts = tumbling(3000)
    wind_mps = [7.0, -3.0, 2.0]
    parts["site"] |= {"atmosphere": {"extinction_per_m": 1e-4, "wind_mps": wind_mps}}
    pointing, _, echoes = look(make_flight(**parts), [0, 20])
    expected_mps = dot(pointing.sensor_velocity_site_mps - np.array(wind_mps), pointing.true_site)
    np.testing.assert_allclose(echoes.air_speed_mps, expected_mps, rtol=1e-12)
