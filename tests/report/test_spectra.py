"""Spectra of chosen shots beside the beats of an FMCW lidar on paper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lidar_emu.report.figures import NoSpectraError, choose_measurements, compute_spectra
from lidar_emu.report.recorded_run import RecordedRun, read_recorded_run
from lidar_emu.shots.model import build_model

LIGHT_MPS = 299_792_458.0


@pytest.fixture(scope="module")
def descent(record) -> RecordedRun:
    return read_recorded_run(record("descent.yaml", duration_s="1", site="flat"))


@pytest.mark.slow
def test_peaks_are_where_the_beats_of_range_and_speed_are(descent):
    model, measured = build_model(descent.recording.scenario), descent.measurement
    waveform = model.scenario.instrument.waveform
    for row, beam in choose_measurements(measured, ()):
        heard = compute_spectra(model, measured, row, beam)
        range_hz = 2.0 * measured.true_range_m[row, beam] * waveform.chirp_slope_hz_per_s / LIGHT_MPS
        doppler_hz = 2.0 * measured.true_closing_speed_mps[row, beam] / waveform.wavelength_m
        expected_hz = np.abs([range_hz - doppler_hz, doppler_hz, range_hz + doppler_hz])
        found_hz = heard.bin_hz * heard.power[:, 1:-1].argmax(axis=1) + heard.bin_hz
        # A footprint spreads over bins, and the beam moves on between the segments: 0.03 m and 3 mm/s.
        assert np.abs(found_hz - expected_hz).max() < 4.0 * heard.bin_hz
        assert (heard.power.max(axis=1) > heard.threshold).all()


def test_noise_is_of_mean_one_away_from_the_lines(descent):
    heard = compute_spectra(build_model(descent.recording.scenario), descent.measurement, 0, 0)
    noise = heard.power[1, len(heard.power[1]) // 2 : -1]
    assert noise.mean() == pytest.approx(1.0, abs=5.0 / np.sqrt(noise.size / 2))


def test_the_nearest_to_an_instant_is_chosen(descent):
    times_s = descent.measurement.time_ns * 1e-9
    ((row, beam),) = choose_measurements(descent.measurement, (0.52,))
    assert abs(times_s[row, beam] - 0.52) <= 0.05


def test_a_shot_that_followed_a_command_is_not_made_up(descent):
    elsewhere = replace(descent.measurement, true_range_m=descent.measurement.true_range_m * 1.01)
    with pytest.raises(NoSpectraError, match="commands"):
        compute_spectra(build_model(descent.recording.scenario), elsewhere, 0, 0)


def test_an_instrument_that_averages_has_none(record):
    averaged = read_recorded_run(
        record("descent.yaml", duration_s="0.2", site="flat", instrument__detection__looks="2")
    )
    with pytest.raises(NoSpectraError, match="several looks"):
        compute_spectra(build_model(averaged.recording.scenario), averaged.measurement, 0, 0)
