"""Periodic non-linearity of the chirps: side lines and shifts by closed forms, at level spectral and from samples."""

from __future__ import annotations

from math import pi, sin, sqrt

import numpy as np
import pytest
from beamlet_samples import measure_echoes
from instruments import echoes, plain
from scipy.special import jv

from lidar_emu.errors import InputError
from lidar_emu.receiver.false_targets import false_targets
from lidar_emu.receiver.peak_interpolation import PEAK_METHODS, passed_modulation
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import FalseTarget, Returns
from lidar_emu.receiver.spectrum import WINDOWS
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model

SHORT = {"fft_length": 2048, "sample_rate_hz": 600e6 / 64}
"""The record of the defaults, with few samples."""
BIN_HZ = 600e6 / 2**17
RANGE_M, SPEED_MPS = 250.0, 0.2003
DELAY_S = 2.0 * RANGE_M / SPEED_OF_LIGHT_MPS


def _instrument(ripple_hz: float, frequency_hz: float) -> Instrument:
    return plain(SHORT | {"ripple_hz": ripple_hz, "ripple_frequency_hz": frequency_hz}, peak="hann")


def _both(instrument: Instrument, shots: int) -> tuple[Returns, Returns]:
    """Spectral level and level waveform."""
    model = build_receiver(instrument)
    beams, shot = echoes(np.full((shots, 1, 1), RANGE_M), SPEED_MPS, 1e-11), np.arange(shots)
    return receive(model, beams, shot, 1), measure_echoes(instrument, model, beams, shot, 2)


def _ripple_of_index(index: float, frequency_hz: float) -> float:
    return 0.5 * index * frequency_hz / sin(pi * frequency_hz * DELAY_S)


def _hamming_power(place_bin: np.ndarray) -> np.ndarray:
    """Power of the highest bin of tones."""
    away = place_bin - np.rint(place_bin)
    sides = np.sinc(away - 1.0) + np.sinc(away + 1.0)
    return np.asarray((0.54 * np.sinc(away) + 0.23 * sides) ** 2)


def test_chirps_lock_onto_the_strongest_side_line() -> None:
    """At an index of 1.84 the first side lines are the strongest, and equally strong."""
    spacing_bin, index, shots = 13, 1.84, 200
    instrument = _instrument(_ripple_of_index(index, spacing_bin * BIN_HZ), spacing_bin * BIN_HZ)
    truth = np.full((shots, 1), RANGE_M), np.full((shots, 1), SPEED_MPS)
    for returns, without in zip(_both(instrument, shots), _both(_instrument(0.0, 1e4), 20), strict=True):
        for segment in (0, 2):
            line_hz = np.median(without.segment_peak_hz[:, 0, segment])
            order = (returns.segment_peak_hz[:, 0, segment] - line_hz) / BIN_HZ / spacing_bin
            np.testing.assert_allclose(np.abs(order), 1.0, atol=0.1 / spacing_bin)
            assert np.mean(order > 0.0) == pytest.approx(0.5, abs=0.15)
        np.testing.assert_allclose(
            returns.segment_peak_hz[:, 0, 1], np.median(without.segment_peak_hz[:, 0, 1]), atol=0.1 * BIN_HZ
        )
        chirps = jv(1, index) ** 2
        power = [np.mean(10.0 ** (each.snr_db / 10.0)) for each in (returns, without)]
        up, constant, down = _hamming_power(np.median(without.segment_peak_hz[:, 0], axis=0) / BIN_HZ)
        expected = (constant + chirps * (up + down)) / (up + constant + down)
        assert power[0] / power[1] == pytest.approx(expected, rel=0.03)
        found = false_targets(build_receiver(instrument), returns.segment_peak_hz, *truth)
        assert (found == FalseTarget.SIDE_LINE).all()
        unmoved = false_targets(
            build_receiver(instrument), without.segment_peak_hz, truth[0][:20], truth[1][:20]
        )
        assert (unmoved == FalseTarget.NONE).all()


@pytest.mark.slow
def test_a_slow_ripple_moves_the_peak() -> None:
    """By 2A sin(πf_mτ) times the transform of the estimator's weights on the frequency, the square of a Hann window."""
    frequency_hz, index, shots = 2e3, 0.5, 600
    instrument = _instrument(_ripple_of_index(index, frequency_hz), frequency_hz)
    x = (np.arange(4096) + 0.5) / 4096 - 0.5
    weights = (1.0 + np.cos(2.0 * pi * x)) ** 2
    passed = np.sum(weights * np.cos(2.0 * pi * frequency_hz / BIN_HZ * x)) / weights.sum()
    expected_hz = index * frequency_hz * passed / sqrt(2.0)
    for returns in _both(instrument, shots):
        for segment in (0, 2):
            assert returns.segment_peak_hz[:, 0, segment].std() == pytest.approx(expected_hz, rel=0.05)


@pytest.mark.parametrize("peak", ["parabola", "jacobsen", "hann", "aboutanios_mulgrew"])
@pytest.mark.parametrize("frequency_hz", [1e3, 4e3])
def test_sigma_has_the_scatter_by_ripple(peak: str, frequency_hz: float) -> None:
    shots, index = 1500, 0.2
    keys = SHORT | {"ripple_hz": _ripple_of_index(index, frequency_hz), "ripple_frequency_hz": frequency_hz}
    instrument = plain(keys, peak=peak, combine="least_squares")
    places = np.linspace(RANGE_M - 5.0, RANGE_M + 5.0, shots)[:, None, None]
    returns = receive(build_receiver(instrument), echoes(places, SPEED_MPS, 1e-10), np.arange(shots), 1)
    error = returns.range_m[:, 0] - places[:, 0, 0]
    # A parabola's weights depend on the place in the bin most.
    tolerance = 0.2 if peak == "parabola" else 0.08
    assert error.std() == pytest.approx(np.sqrt(np.mean(returns.sigma_range_m**2)), rel=tolerance)


@pytest.mark.parametrize("peak", ["bin", "parabola", "jacobsen", "hann", "aboutanios_mulgrew"])
def test_estimators_pass_a_modulation_by_their_weights(peak: str) -> None:
    """Peaks of sampled tones with a slight modulation of the frequency, against the transform of the weights."""
    place = (np.arange(4096) + 0.5) / 4096 - 0.5
    window = 0.54 + 0.46 * np.cos(2.0 * pi * place)
    for frequency_bin in (0.2, 0.9, 1.7, 3.3):
        small, moved = 1e-3, []
        for sign in (1.0, -1.0):
            light = np.exp(1j * sign * small / frequency_bin * np.sin(2.0 * pi * frequency_bin * place))
            moved.append(_peak_bin(peak, light, place, window))
        passed = passed_modulation(PEAK_METHODS[peak], WINDOWS["hamming"], frequency_bin)
        assert 0.5 * (moved[0] - moved[1]) / small == pytest.approx(passed, abs=0.01)


def _peak_bin(peak: str, light: np.ndarray, place: np.ndarray, window: np.ndarray) -> float:
    """Place of a tone near bin 0, by the textbook's form of each estimator."""

    def at(k: float, weights: np.ndarray) -> complex:
        return complex(np.mean(light * weights * np.exp(-2j * pi * k * place)))

    whole, hann = np.ones_like(place), 1.0 + np.cos(2.0 * pi * place)
    if peak in ("jacobsen", "hann"):
        before, here, after = (at(k, whole if peak == "jacobsen" else hann) for k in (-1, 0, 1))
        sign, slope = (1.0, 1.0) if peak == "jacobsen" else (-1.0, 1.5)
        return float(((after - before) / (2.0 * here + sign * (before + after))).real) / slope
    if peak == "aboutanios_mulgrew":
        above, below = at(0.5, whole), at(-0.5, whole)
        return 0.5 * float(((above - below) / (above + below)).real)
    step = 1e-3
    before, here, after = (abs(at(k, window)) ** 2 for k in (-step, 0.0, step))
    return step * 0.5 * (before - after) / (before - 2.0 * here + after)


def _range_m(
    index: float, frequency_hz: float, power_w: float, shots: int, share: float = 0.05
) -> np.ndarray:
    instrument = _instrument(_ripple_of_index(index, frequency_hz), frequency_hz)
    beams = echoes(np.full((shots, 1, 1), RANGE_M), SPEED_MPS, power_w)
    returns = receive(build_receiver(instrument, left_out_share=share), beams, np.arange(shots), 1)
    return np.asarray(returns.range_m[:, 0])


@pytest.mark.parametrize("frequency_hz", [2e3, 6e4])
def test_a_ripple_is_left_out_that_scatters_less_than_its_share(frequency_hz: float) -> None:
    """A quarter of the growth of the variance by 5 % of sigma; the range has one chirp's beat."""
    power_w, shots = 1e-10, 400
    snr = build_receiver(_instrument(0.0, 1e4)).snr_per_w * power_w
    noise_bin2 = 3.24 * 6.0 / (4.0 * pi**2 * snr)
    left_out_bin2 = (1.05**2 - 1.0) / 4.0 * noise_bin2
    limit = sqrt(2.0 * left_out_bin2) / min(frequency_hz / BIN_HZ, 0.7)
    without = _range_m(1e-9, frequency_hz, power_w, shots)
    np.testing.assert_array_equal(_range_m(0.99 * limit, frequency_hz, power_w, shots), without)
    for moved in (
        _range_m(1.01 * limit, frequency_hz, power_w, shots) - without,
        _range_m(0.99 * limit, frequency_hz, power_w, shots, share=0.0) - without,
    ):
        bins = moved / _instrument(0.0, 1e4).waveform.range_bin_m
        assert 0.0 < bins.std() < 1.05 * sqrt(left_out_bin2)


def test_a_ripple_with_side_lines_is_computed_however_weak_the_echo() -> None:
    power_w = 1e-15
    without = _range_m(1e-9, 6e4, power_w, 3)
    np.testing.assert_array_equal(_range_m(0.0199, 6e4, power_w, 3), without)
    assert (_range_m(0.0201, 6e4, power_w, 3) != without).all()


def test_the_plan_has_its_line_and_impossible_ripples_are_refused() -> None:
    ripple, frequency = "instrument.waveform.ripple_hz", "instrument.waveform.ripple_frequency_hz"
    plan = build_model(load("descent.yaml", {ripple: "4e4", "duration_s": "0.5"})).plan
    (row,) = (each for each in plan.decisions if each.stage == "ripple of the chirps")
    assert row.computed
    assert "8 rad, 10 kHz" in row.reason
    for keys, key in (
        ({ripple: "6e5"}, "ripple_hz"),
        ({ripple: "1e6", frequency: "1e6"}, "ripple_frequency_hz"),
    ):
        with pytest.raises(InputError, match=key):
            load("descent.yaml", keys)
