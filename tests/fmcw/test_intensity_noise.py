"""Peak of the laser's intensity noise: its spectrum at all levels, and what it costs an echo beside it."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import echoes, plain

from lidar_emu.errors import InputError
from lidar_emu.fmcw.analog_response import noise_level
from lidar_emu.fmcw.receiver import receive
from lidar_emu.fmcw.receiver_constants import build_receiver
from lidar_emu.fmcw.receiver_faults import decimated, noisier
from lidar_emu.fmcw.waveform.analog_receiver import AnalogResponse
from lidar_emu.fmcw.waveform.analog_receiver import noise_level as level_behind_poles
from lidar_emu.fmcw.waveform.detection import transform
from lidar_emu.fmcw.waveform.intensity_noise import NoisePeak
from lidar_emu.fmcw.waveform.level import measure_echoes
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.scenario.instrument import Instrument, Optics, Receiver
from lidar_emu.scenario.load import load

SHORT = {"fft_length": 512, "sample_rate_hz": 600e6 / 256}
ELECTRON_C = 1.602176634e-19
PEAK_HZ, WIDTH_HZ, LEVEL_DB = 400e3, 60e3, -105.0
SPEED_MPS = 0.0203


def _receiver(**keys: object) -> Receiver:
    """Flat, without noise but the local oscillator's shot noise and the peak."""
    peak = {
        "intensity_noise_peak_db_per_hz": LEVEL_DB,
        "intensity_noise_peak_hz": PEAK_HZ,
        "intensity_noise_peak_width_hz": WIDTH_HZ,
    }
    quiet = {
        "adc": None,
        "bandwidth_hz": None,
        "ac_coupling_hz": 0.0,
        "dark_current_a": 0.0,
        "transimpedance_ohm": 1e12,
        "relative_intensity_noise_db_per_hz": None,
    }
    return Receiver.model_validate(quiet | peak | keys)


def _instrument(receiver: Receiver, **detection: object) -> Instrument:
    short = plain(SHORT, **({"peak": "hann", "combine": "least_squares"} | detection))
    return short.model_copy(update={"optics": Optics(speckle=False), "receiver": receiver})


def _quiet(instrument: Instrument) -> Instrument:
    without = instrument.receiver.model_copy(update={"intensity_noise_peak_db_per_hz": None})
    return instrument.model_copy(update={"receiver": without})


def _over_shot(receiver: Receiver, frequency_hz: np.ndarray | float) -> np.ndarray | float:
    """RIN (ℛP)²/CMRR over 2qℛP, on the flank of a Lorentzian."""
    current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    rin_per_hz = 10 ** ((LEVEL_DB - receiver.common_mode_rejection_db) / 10)
    away = (frequency_hz - PEAK_HZ) / (WIDTH_HZ / 2)
    return rin_per_hz * current_a / (2 * ELECTRON_C) / (1 + away**2)


def _levels(instrument: Instrument) -> np.ndarray:
    model = build_receiver(instrument)
    k = np.arange(257.0)
    return np.array(
        [interpreted(noise_level)(model.response, 1.0, 1.0, 0.0, b, np.sin(np.pi * b / 512)) for b in k]
    )


def test_noise_of_a_bin_is_the_ratio_of_densities() -> None:
    receiver = _receiver()
    instrument = _instrument(receiver)
    expected = 1.0 + _over_shot(receiver, np.arange(257) * instrument.waveform.bin_width_hz)
    assert expected.max() > 50
    np.testing.assert_allclose(_levels(instrument), expected, rtol=2e-6)
    assert build_receiver(instrument).response.mean_noise == pytest.approx(expected.mean(), rel=0.01)


@pytest.mark.parametrize(
    "poles", [{}, {"bandwidth_hz": 500e3}, {"bandwidth_hz": 1e6, "ac_coupling_hz": 50e3}]
)
def test_drawn_noise_has_the_noise_of_the_bins(poles: dict[str, float]) -> None:
    """Neighbouring bins differ by a factor of 1.5 on the flanks; a Hann window keeps their mean."""
    receiver = _receiver(**poles)
    instrument = _instrument(receiver)
    waveform, response = instrument.waveform, AnalogResponse.of(receiver)
    peak = NoisePeak.of(receiver, build_receiver(instrument).response)
    assert peak is not None
    noise = peak.draw(np.random.default_rng(5), 4000, waveform, response)
    drawn = np.mean(np.abs(transform(noise, "rect")) ** 2, axis=0)
    without = _quiet(instrument)
    added = _levels(instrument) - _levels(without)
    near = np.abs(np.arange(257) * waveform.bin_width_hz - PEAK_HZ) < 2 * WIDTH_HZ
    np.testing.assert_allclose(drawn[near], added[near], rtol=0.12)
    np.testing.assert_allclose(peak.bins(waveform, response)[1:], added[1:], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(level_behind_poles(waveform, response)[8:], _levels(without)[8:], rtol=2e-3)


@pytest.mark.parametrize("level", ["spectral", pytest.param("waveform", marks=pytest.mark.slow)])
def test_an_echo_on_the_peak_scatters_more(level: str) -> None:
    """The chirps' variances grow by the ratio of the noise at their beats, the constant segment's does not."""
    receiver = _receiver()
    instrument = _instrument(receiver)
    range_m = PEAK_HZ * 299_792_458.0 / (2 * instrument.waveform.chirp_slope_hz_per_s) + 0.4
    shots = 400 if level == "waveform" else 3000
    beams, shot = echoes(np.full((shots, 1, 1), range_m), SPEED_MPS, 1e-8), np.arange(shots)
    loud_m, quiet_m = (
        measure_echoes(each, build_receiver(each), beams, shot, 2).range_m
        if level == "waveform"
        else receive(build_receiver(each), beams, shot, 1).range_m
        for each in (instrument, _quiet(instrument))
    )
    beat_hz = 2 * instrument.waveform.chirp_slope_hz_per_s * range_m / 299_792_458.0
    chirps_hz = beat_hz + np.array([-1, 1]) * 2 * SPEED_MPS / instrument.waveform.wavelength_m
    ratio = np.sqrt(1.0 + np.mean(_over_shot(receiver, chirps_hz)))
    assert ratio > 5
    assert loud_m.std() / quiet_m.std() == pytest.approx(ratio, rel=0.12 if level == "waveform" else 0.06)


def test_false_alarms_are_as_frequent() -> None:
    """The detector knows the noise of each bin: 0.2 of the spectra alarm, on the peak and off it alike."""
    instrument = _instrument(_receiver(), false_alarm_probability=0.2, peak="bin")
    shots = 4000
    dark = echoes(np.full((shots, 1, 1), 30.0), 0.0, 0.0)
    found, quiet = (
        receive(build_receiver(each), dark, np.arange(shots), 1) for each in (instrument, _quiet(instrument))
    )
    for segment in range(3):
        assert ((found.segments >> segment) & 1).mean() == ((quiet.segments >> segment) & 1).mean() > 0.1
    loud = np.abs(found.segment_peak_hz - PEAK_HZ) < WIDTH_HZ
    expected = 2 * WIDTH_HZ / (instrument.waveform.sample_rate_hz / 2)
    assert loud.sum() / np.isfinite(found.segment_peak_hz).sum() == pytest.approx(expected, abs=0.04)


def test_faulty_receivers_see_it_relative_to_their_noise() -> None:
    model = build_receiver(_instrument(_receiver()))
    assert noisier(model, _instrument(_receiver()).detection, 3.0103).response.noise_peak == pytest.approx(
        0.5 * model.response.noise_peak, rel=1e-5
    )
    folded = decimated(model, 4).response
    assert folded.noise_peak == 0.25 * model.response.noise_peak
    assert folded.noise_peak_bin == pytest.approx(128 - model.response.noise_peak_bin)


@pytest.mark.parametrize(("peak_hz", "fits"), [("2.9e8", True), ("3.0e8", False)])
def test_its_frequency_lies_below_half_the_sample_rate(peak_hz: str, fits: bool) -> None:
    settings = {
        "instrument.receiver.intensity_noise_peak_db_per_hz": "-105",
        "instrument.receiver.intensity_noise_peak_hz": peak_hz,
    }
    if fits:
        load("descent", settings)
        return
    with pytest.raises(InputError, match=r"intensity_noise_peak_hz.*below 3e\+08, half the sample rate"):
        load("descent", settings)
