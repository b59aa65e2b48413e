"""Poles on tones and on noise against their formulas, and the digitiser against its noise."""

from __future__ import annotations

import numpy as np
import pytest
from beamlet_samples import Beamlets, analytic_record, phasor, receive_record
from scipy.signal import cont2discrete, lfilter

from lidar_emu.receiver.whole_spectrum import transform, window_noise_power
from lidar_emu.reference.analog_receiver import FLAT, AnalogResponse, Digitiser, draw_noise, noise_level
from lidar_emu.reference.laser_sweep import draw_drift, frequency_plan
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Waveform

RATE_HZ = 20e6
WAVEFORM = Waveform(fft_length=2048, sample_rate_hz=RATE_HZ)
POLES = AnalogResponse(bandwidth_hz=10e6, ac_coupling_hz=50e3)


def _steady(beat_hz: list[float], weight: list[complex]) -> Beamlets:
    """Tones of the constant segment."""
    speed_mps = np.array(beat_hz) * WAVEFORM.wavelength_m / 2
    return Beamlets(np.full(len(beat_hz), 800.0), speed_mps, 0.0, np.array(weight, dtype=complex))


@pytest.mark.parametrize("beat_hz", [30e3, 2.5e6, -4.4e6, 9.99e6, 13.7e6, 31e6, -77e6])
def test_tone_gets_the_gain_of_its_true_frequency(beat_hz: float) -> None:
    constant = frequency_plan(WAVEFORM)[1]
    weight = 0.8 - 0.3j
    gain = complex(POLES.gain(np.array(beat_hz)))
    assert gain == pytest.approx(
        1 / (1 + 1j * beat_hz / 10e6) * (1j * beat_hz / 50e3) / (1 + 1j * beat_hz / 50e3), rel=1e-12
    )
    ours = transform(receive_record(WAVEFORM, constant, _steady([beat_hz], [weight]), POLES).real, "hann")
    expected = transform(
        analytic_record(WAVEFORM, constant, _steady([beat_hz], [weight * gain])).real, "hann"
    )
    assert abs(ours - expected).max() < 5e-9 * abs(expected).max()


def test_beamlets_and_records_add_up() -> None:
    up = frequency_plan(WAVEFORM)[0]
    rng = np.random.default_rng(1)
    weight = rng.standard_normal((5, 3)) + 1j * rng.standard_normal((5, 3))
    range_m, speed_mps = np.array([100.0, 150.0, 700.0]), np.array([1.0, 2.0, 3.0])
    together = receive_record(WAVEFORM, up, Beamlets(range_m, speed_mps, 2.0, weight), POLES).real
    alone = sum(
        receive_record(WAVEFORM, up, Beamlets(range_m[[i]], speed_mps[[i]], 2.0, weight[3, [i]]), POLES).real
        for i in range(3)
    )
    np.testing.assert_allclose(together[3], alone, atol=1e-12)


def _folded_gain(response: AnalogResponse, frequency_hz: np.ndarray, folds: int) -> np.ndarray:
    shift_hz = np.arange(-folds, folds + 1) * RATE_HZ
    return np.sum(abs(response.gain(frequency_hz[:, None] + shift_hz)) ** 2, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "response",
    [
        FLAT,
        AnalogResponse(5e6),
        AnalogResponse(10e6, 50e3),
        AnalogResponse(3e6, 2e6),
        AnalogResponse(None, 1e6),
    ],
)
def test_noise_bins_have_the_folded_gain(response: AnalogResponse) -> None:
    waveform = Waveform(fft_length=256, sample_rate_hz=RATE_HZ)
    records = 10_000
    noise = draw_noise(np.random.default_rng(4), records, waveform, response)
    folds = 2000 if response.bandwidth_hz else 0
    expected = _folded_gain(response, np.arange(129) * RATE_HZ / 256, folds)
    for window in ("rect", "hann", "hamming"):
        mean = np.mean(abs(transform(noise, window)) ** 2, axis=0) / window_noise_power(window, 256)
        inner = slice(8 if window == "rect" else 4, 120)
        # Unit exponentials: five standard deviations, and what leaks into a short record's bins from others.
        np.testing.assert_allclose(mean[inner], expected[inner], rtol=5 / np.sqrt(records) + 0.01)


@pytest.mark.parametrize(
    "response", [FLAT, AnalogResponse(5e6), AnalogResponse(10e6, 50e3), AnalogResponse(None, 1e6)]
)
def test_noise_level_is_the_folded_gain(response: AnalogResponse) -> None:
    waveform = Waveform(fft_length=256, sample_rate_hz=RATE_HZ)
    folds = 20_000 if response.bandwidth_hz else 0
    expected = _folded_gain(response, np.arange(129) * RATE_HZ / 256, folds)
    np.testing.assert_allclose(noise_level(waveform, response), expected, rtol=1e-4, atol=1e-4)


def test_coupled_noise_at_dc_is_what_folds_there() -> None:
    waveform, response = Waveform(fft_length=4096, sample_rate_hz=RATE_HZ), AnalogResponse(5e6, 50e3)
    noise = draw_noise(np.random.default_rng(4), 1000, waveform, response)
    mean = np.mean(abs(transform(noise, "hann")) ** 2, axis=0) / window_noise_power("hann", 4096)
    expected = _folded_gain(response, np.arange(2, 60) * RATE_HZ / 4096, 2000)
    assert expected[0] < 0.25 * expected[-1]
    np.testing.assert_allclose(mean[2:60], expected, rtol=5 / np.sqrt(1000) + 0.02)


def test_noise_has_its_power_from_the_first_sample() -> None:
    waveform, response = Waveform(fft_length=256, sample_rate_hz=RATE_HZ), AnalogResponse(300e3, 100e3)
    noise = draw_noise(np.random.default_rng(4), 20_000, waveform, response)
    power = np.mean(noise**2, axis=0)
    # ∫ |H|² df over all frequencies is π B²/(B + b) for corners B and b.
    expected = 256 / 4 / RATE_HZ * np.pi * 300e3 * 300e3 / (300e3 + 100e3)
    np.testing.assert_allclose(power[[0, 1, 128, 255]], expected, rtol=5 * np.sqrt(2 / 20_000))


def test_coinciding_poles_are_refused() -> None:
    with pytest.raises(ValueError, match="coincide"):
        draw_noise(np.random.default_rng(1), 1, WAVEFORM, AnalogResponse(1e6, 1e6))


def test_digitiser_clips_and_adds_a_twelfth_of_a_step_squared() -> None:
    digitiser = Digitiser(full_scale=2.0, bits=8.0)
    samples = np.random.default_rng(2).uniform(-0.9, 0.9, 100_000)
    error = digitiser.digitise(samples) - samples
    assert np.mean(error**2) == pytest.approx((2.0 / 256) ** 2 / 12, rel=0.02)
    assert digitiser.digitise(np.array([-7.0, 0.0, 1.3])).tolist() == [-1.0, 0.0, 1.0]


def test_swept_echo_rings_through_the_poles_as_a_state_equation_reports() -> None:
    """The echo of the segment before sweeps through zero: no single gain describes it."""
    waveform = Waveform(fft_length=2048, sample_rate_hz=RATE_HZ, chirp_slope_hz_per_s=2e10)
    segment = frequency_plan(waveform)[0]
    range_m = waveform.record_edge_range_m + SPEED_OF_LIGHT_MPS / 2 * 0.4 * waveform.record_time_s
    beamlets = Beamlets(np.array([range_m]), np.array([2.8]), 0.0, np.array([1.0 + 0j]))
    response = AnalogResponse(None, 200e3)
    ours = receive_record(waveform, segment, beamlets, response, edges=True).real
    # First-order hold at 16 times the rate, over a run-in twice as long as ours.
    ahead, fine = 2 * response.run_in(RATE_HZ), 16
    time_s = (np.arange((ahead + 2048) * fine) / fine - ahead - 2047 / 2) / RATE_HZ
    signal = phasor(segment, beamlets, 0, time_s, True).real
    pole = 2 * np.pi * 200e3
    numerator, denominator, _ = cont2discrete(([1.0, 0.0], [1.0, pole]), 1 / (fine * RATE_HZ), method="foh")
    slow = lfilter(numerator.ravel(), denominator, signal)[ahead * fine :: fine]
    assert abs(ours - slow).max() < 2e-3
    assert abs(ours - analytic_record(waveform, segment, beamlets, edges=True).real).max() > 0.1


@pytest.mark.parametrize("samples", [0.3, 7.0, 40.6])
def test_laser_drifts_as_a_random_walk(samples: float) -> None:
    """Variance 2πΔντ at each time, and what two times have in common falls off as a triangle over the delay."""
    waveform = Waveform(fft_length=256, sample_rate_hz=1e6, linewidth_hz=300.0, segment_time_s=300e-6)
    drift = np.angle(draw_drift(np.random.default_rng(3), 20_000, waveform, samples / 1e6))
    expected = 2 * np.pi * 300.0 * samples / 1e6
    for apart in (0, 1, 20, 60):
        common = np.mean(drift[:, : 256 - apart] * drift[:, apart:])
        assert common == pytest.approx(expected * max(0.0, 1 - apart / samples), abs=0.02 * expected)
