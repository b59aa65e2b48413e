"""Errors of the laser's sweep: closed forms, and records of a laser whose frequency has them."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest
from beamlet_samples import measure_echoes
from instruments import echoes, plain

from lidar_emu.receiver.peak_interpolation import FLICKER_SCATTER, PEAK_METHODS
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Returns
from lidar_emu.receiver.skip_limits import MOST_PULL_BINS
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model

RANGE_M, SPEED_MPS = 30.013, 0.2003
SHORT = {"fft_length": 512, "sample_rate_hz": 600e6 / 256}
"""The record of the defaults, with few samples."""
ERRORS = {"slopes": {"slope_scatter": 4e-3}, "1/f noise": {"flicker_hz2": 2e10}}
FINE = {"peak": "hann"}


def _expected(instrument: Instrument) -> tuple[float, float]:
    """Standard deviations of range and closing speed, of the down-chirp less the Doppler line, and of the line."""
    waveform = instrument.waveform
    delay_s = 2.0 * RANGE_M / SPEED_OF_LIGHT_MPS
    flicker_hz = 4.83 * delay_s * sqrt(waveform.flicker_hz2) / waveform.record_time_s
    chirp_hz = np.hypot(waveform.slope_scatter * waveform.chirp_slope_hz_per_s * delay_s, flicker_hz)
    range_hz = float(np.hypot(chirp_hz, flicker_hz))
    per_hz = SPEED_OF_LIGHT_MPS / (2.0 * waveform.chirp_slope_hz_per_s)
    return range_hz * per_hz, flicker_hz * waveform.wavelength_m / 2.0


def _spectral(instrument: Instrument, shots: int, in_turn: bool = False) -> Returns:
    model = build_receiver(instrument, in_turn=in_turn)
    beams = echoes(np.full((shots, 2, 1), RANGE_M), SPEED_MPS, 1e-9)
    return receive(model, beams, np.arange(shots), 1)


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("in_turn", [False, True])
def test_beats_scatter_by_the_closed_form(error: str, in_turn: bool) -> None:
    instrument = plain(SHORT | ERRORS[error], **FINE)
    returns = _spectral(instrument, 2000, in_turn)
    for values, sigma, expected in zip(
        (returns.range_m, returns.closing_speed_mps),
        (returns.sigma_range_m, returns.sigma_speed_mps),
        _expected(instrument),
        strict=True,
    ):
        if expected == 0.0:
            continue
        assert values.std() == pytest.approx(expected, rel=0.06)
        assert np.median(sigma) == pytest.approx(expected, rel=0.03)
        # Beams that fire together share the laser's error.
        assert np.corrcoef(values.T)[0, 1] == pytest.approx(0.0 if in_turn else 1.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("error", ERRORS)
def test_records_of_such_a_laser_scatter_alike(error: str) -> None:
    instrument, shots = plain(SHORT | ERRORS[error], **FINE), 600
    beams = echoes(np.full((shots, 2, 1), RANGE_M), SPEED_MPS, 1e-9)
    returns = measure_echoes(instrument, build_receiver(instrument), beams, np.arange(shots), 3)
    for values, expected in zip(
        (returns.range_m, returns.closing_speed_mps), _expected(instrument), strict=True
    ):
        if expected == 0.0:
            continue
        assert values[:, 0].std() == pytest.approx(expected, rel=0.13)
        assert np.corrcoef(values.T)[0, 1] > 0.95


def test_least_squares_weighs_chirps_by_their_slopes() -> None:
    """The Doppler shift then comes from the constant segment alone."""
    instrument = plain(SHORT | ERRORS["slopes"], peak="hann", combine="least_squares")
    returns = _spectral(instrument, 1000)
    expected_m, _ = _expected(instrument)
    assert returns.range_m.std() == pytest.approx(expected_m / sqrt(2.0), rel=0.08)
    assert returns.closing_speed_mps.std() < 0.01 * SPEED_MPS * ERRORS["slopes"]["slope_scatter"]


@pytest.mark.parametrize("peak", ["hann", "bin"])
def test_small_errors_are_left_out(peak: str) -> None:
    """Just below a quarter of the growth of the variance by 5 % of sigma nothing changes; exact computes it."""
    beam, shots = echoes(np.full((1, 1, 1), RANGE_M), 1.0, 1e-12), np.arange(1)
    snr = build_receiver(plain()).snr_per_w * 1e-12
    variance = 3.24 * 6.0 / (4.0 * pi**2 * snr) if peak == "hann" else 1.0 / 12.0 + 6.0 / (4.0 * pi**2 * snr)
    limit_bin = sqrt((1.05**2 - 1.0) / 4.0 * variance)
    slope = limit_bin * plain().waveform.range_bin_m / RANGE_M

    def range_m(slope_scatter: float, share: float = 0.05) -> float:
        instrument = plain({"slope_scatter": slope_scatter}, peak=peak)
        returns = receive(build_receiver(instrument, left_out_share=share), beam, shots, 1)
        return float(returns.range_m[0, 0])

    without = range_m(1e-12)
    assert range_m(0.99 * slope) == without
    # A quantised range moves by whole bins.
    moved = (
        [range_m(1.01 * slope), range_m(0.99 * slope, share=0.0)]
        if peak == "hann"
        else [range_m(8.0 * slope)]
    )
    for other in moved:
        assert 0.0 < abs(other - without) < 9.0 * max(limit_bin, 1.0 if peak == "bin" else 0.0)


@pytest.mark.parametrize("flicker_hz2", [0.0, 1e3])
def test_the_plan_states_the_share_of_sigma(flicker_hz2: float) -> None:
    for slope_scatter, computed in ((1e-9, False), (1e-3, True)):
        keys = {
            "instrument": "ndl_fine",
            "instrument.waveform.slope_scatter": str(slope_scatter),
            "instrument.waveform.flicker_hz2": str(flicker_hz2),
            "duration_s": "0.5",
        }
        plan = build_model(load("descent.yaml", keys)).plan
        (row,) = (each for each in plan.decisions if each.stage == "laser sweep")
        assert row.computed == computed
        assert row.bound == "1.3 % of sigma"


def _weights(method: str, x: np.ndarray) -> np.ndarray:
    match method:
        case "jacobsen":
            return np.asarray(1.0 + np.cos(2.0 * pi * x))
        case "hann":
            return np.asarray((1.0 + np.cos(2.0 * pi * x)) ** 2)
        case "aboutanios_mulgrew":
            return np.asarray(np.cos(pi * x))
    return np.asarray(-np.cumsum((0.54 + 0.46 * np.cos(2.0 * pi * x)) * x))


@pytest.mark.parametrize("method", PEAK_METHODS)
def test_each_estimator_has_its_scatter_by_flicker(method: str) -> None:
    count, padded = 1024, 2**17
    weights = _weights(method, (np.arange(count) + 0.5) / count - 0.5)
    transform = np.abs(np.fft.rfft(weights / weights.sum(), padded))
    frequency = np.arange(transform.size) * count / padded
    deviation = 2.0 * pi * sqrt(np.sum(frequency * transform**2) * count / padded)
    assert FLICKER_SCATTER[PEAK_METHODS[method]] == pytest.approx(deviation, rel=5e-3)


@pytest.mark.parametrize("method", PEAK_METHODS)
def test_no_weak_tone_pulls_a_peak_farther_than_the_limit(method: str) -> None:
    x = (np.arange(1024) + 0.5) / 1024 - 0.5
    weights = _weights(method, x)
    away = np.linspace(0.0, 12.0, 481)
    passed = np.cos(2.0 * pi * away[:, None] * x) @ weights / weights.sum()
    assert 0.5 * MOST_PULL_BINS < np.abs(away * passed).max() < MOST_PULL_BINS
