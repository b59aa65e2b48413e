"""The forecast of an instrument, against the link budget, the windows' own sums and bounds."""

import numpy as np
import pytest

from lidar_emu.plan.detection_forecast import (
    beam_angles_deg,
    forecast_detection,
    mean_straddling_gain,
    rule_probability,
)
from lidar_emu.receiver.link_budget import coherent_power_w
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.spectrum import WINDOWS
from lidar_emu.scenario.load import load

SAMPLES = 256
ALTITUDE_M = np.geomspace(30.0, 10_000.0, 7)


def flight(**settings):
    settings = {"instrument": "ndl_as_published", "instrument__optics__speckle": "true"} | settings
    return load("descent", {key.replace("__", "."): value for key, value in settings.items()})


@pytest.mark.parametrize("name", WINDOWS)
def test_straddling_gain_of_an_actual_transform(name):
    """Tones all over a bin through a window of samples, against white noise through the same."""
    window = WINDOWS[name]
    # Neighbours of the centre tap are cosines of one turn over the record; -s is the window's dip at its ends.
    taper = window.centre + 2 * window.side * np.cos(2 * np.pi * np.arange(SAMPLES) / SAMPLES)
    offset = (np.arange(200) + 0.5) / 200 - 0.5
    tone = np.exp(2j * np.pi * (40 + offset)[:, None] * np.arange(SAMPLES) / SAMPLES)
    highest = (np.abs(np.fft.fft(taper * tone, axis=1)) ** 2).max(axis=1)
    gain = highest.mean() / SAMPLES / (taper**2).sum()
    assert mean_straddling_gain(window) == pytest.approx(gain, rel=1e-4)


def test_signal_to_noise_ratio_is_the_link_budgets():
    scenario = flight()
    forecast = forecast_detection(scenario, ALTITUDE_M)
    assert forecast.angle_deg.tolist() == [7.5, 22.5]
    cosine = np.cos(np.radians([[7.5], [22.5]]))
    np.testing.assert_allclose(forecast.range_m, ALTITUDE_M / cosine, rtol=1e-12)
    power_w = coherent_power_w(scenario.instrument, scenario.site.surface, None, ALTITUDE_M / cosine, cosine)
    on_bin_db = 10 * np.log10(power_w * build_receiver(scenario.instrument, scenario.site).snr_per_w)
    np.testing.assert_allclose(forecast.snr_db, on_bin_db - forecast.window_loss_db, atol=1e-9)
    assert forecast.window_loss_db == pytest.approx(1.89, abs=0.01)


def test_far_away_the_ratio_falls_as_the_square_and_one_look_in_speckle_has_a_closed_form():
    forecast = forecast_detection(flight(), np.array([4000.0, 8000.0]))
    assert np.diff(forecast.snr_db[0])[0] == pytest.approx(-20 * np.log10(2), abs=0.1)
    snr = 10 ** (forecast.snr_db / 10)
    np.testing.assert_allclose(
        forecast.segment_speckle, np.exp(-forecast.minus_log_pfa / (1 + snr)), rtol=1e-12
    )
    assert forecast.false_alarm == pytest.approx(1e-3, rel=1e-3)


@pytest.mark.parametrize("looks", [1, 4])
def test_bounds_hold(looks):
    forecast = forecast_detection(flight(instrument__detection__looks=str(looks)), ALTITUDE_M)
    assert (forecast.measurement_independent <= forecast.measurement_shared + 1e-10).all()
    assert (forecast.measurement_shared <= forecast.segment_speckle + 1e-10).all()
    for name in ("segment_steady", "segment_speckle", "measurement_shared", "measurement_independent"):
        assert (np.diff(getattr(forecast, name), axis=1) <= 1e-10).all()
    assert (np.diff(forecast.false_lock_speckle, axis=1) >= -1e-10).all()
    assert (forecast.false_lock_speckle < forecast.false_alarm).all()


@pytest.mark.parametrize(("rule", "needed"), [("all_three", 3), ("any_two", 2)])
def test_rules_count_segments(rule, needed):
    detection = flight().instrument.detection.model_copy(update={"rule": rule})
    segment = 0.3
    drawn = np.random.default_rng(1).random((200_000, 3)) < segment
    expected = (drawn.sum(axis=1) >= needed).mean()
    assert rule_probability(detection, np.array(segment)) == pytest.approx(expected, abs=0.005)


def test_beyond_the_maximum_range_there_is_nothing():
    forecast = forecast_detection(flight(), np.array([11_500.0, 11_950.0, 13_000.0]))
    assert np.isnan(forecast.snr_db).tolist() == [[False, True, True], [True, True, True]]
    for name in ("range_m", "segment_steady", "measurement_shared", "false_lock_speckle"):
        assert (np.isnan(getattr(forecast, name)) == np.isnan(forecast.snr_db)).all()


def test_a_black_ground_gives_false_alarms_only():
    forecast = forecast_detection(flight(site__surface__reflectance="0"), ALTITUDE_M)
    np.testing.assert_allclose(forecast.segment_steady, np.exp(-forecast.minus_log_pfa), rtol=1e-9)
    np.testing.assert_allclose(forecast.false_lock_steady, forecast.false_alarm, rtol=1e-6)
    assert np.isneginf(forecast.snr_db).all()


def test_a_tilted_sensor_has_an_angle_per_beam():
    tilted = flight(mounting="{pitch_deg: 10}", scanner__switches="[]")
    angle_deg = beam_angles_deg(tilted)
    assert len(angle_deg) == 2
    assert angle_deg[0] < 22.5 < angle_deg[1]
    level = forecast_detection(flight(mounting="{pitch_deg: 80}", scanner__switches="[]"), ALTITUDE_M)
    assert np.isnan(level.snr_db[-1]).all()
    assert np.isfinite(level.snr_db[0][:3]).all()


def test_line_and_poles_cost_what_they_leave_out():
    """A line of 3 kHz loses exp(-2πΔντ); beyond its pole the amplifier loses more of the echo than of folded noise."""
    altitude_m = np.array([500.0, 4000.0])
    plain = forecast_detection(flight(), altitude_m)
    lined = forecast_detection(flight(instrument__waveform__linewidth_hz="3e3"), altitude_m)
    drift = 2 * np.pi * 3e3 * 2 * plain.range_m / 299792458
    np.testing.assert_allclose(lined.snr_db - plain.snr_db, -10 * np.log10(np.e) * drift, atol=1e-9)
    poled = forecast_detection(flight(instrument__receiver__bandwidth_hz="300e6"), altitude_m)
    beat_hz = 2e12 * 2 * plain.range_m / 299792458
    zones = np.arange(-20_000, 20_001)[:, None, None] * 600e6
    folded = (1 / (1 + ((beat_hz + zones) / 300e6) ** 2)).sum(axis=0)
    passed = 1 / (1 + (beat_hz / 300e6) ** 2)
    np.testing.assert_allclose(poled.snr_db - plain.snr_db, 10 * np.log10(passed / folded), atol=1e-3)
