"""Peaks of noise drawn at once, against the peaks of whole spectra of simulated noise."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import beam_record, plain
from scipy import special, stats
from synthesis import COSINES

from lidar_emu.receiver.false_alarms import noise_peak
from lidar_emu.receiver.probability import exceedance, gamma_tail
from lidar_emu.receiver.receiver_constants import build_receiver

LENGTH = 256
SHOTS = 6000


def _simulated(looks: int, window: str, shots: int, seed: int) -> np.ndarray:
    """(shots, N/2 - 3) powers over their mean of bins 2 to N/2 - 2, averaged over looks."""
    rng = np.random.default_rng(seed)
    a, b = COSINES[window]
    weights = a - b * np.cos(2 * np.pi * np.arange(LENGTH) / LENGTH)
    power = np.zeros((shots, LENGTH // 2 - 3))
    for _ in range(looks):
        spectra = np.fft.rfft(weights * rng.standard_normal((shots, LENGTH)))[:, 2:-2]
        power += abs(spectra) ** 2 / (looks * np.sum(weights**2))
    return power


def _drawn(looks: int, bins: int) -> np.ndarray:
    """(shots, 3, 2) three successive peaks of each shot: power and place."""
    peaks = np.empty((SHOTS, 3, 2))
    for shot in range(SHOTS):
        below = np.inf
        for i in range(3):
            below, place = noise_peak(looks, below, float(bins - i), beam_record(shot, 1, seed=5), i)
            peaks[shot, i] = below, place
    return peaks


@pytest.mark.parametrize("looks", [1, 4])
def test_peaks_are_those_of_whole_spectra(looks: int) -> None:
    whole = np.sort(_simulated(looks, "rect", SHOTS, 3), axis=1)[:, ::-1]
    drawn = _drawn(looks, whole.shape[1])
    assert (np.diff(drawn[:, :, 0], axis=1) < 0).all()
    for i in range(3):
        assert stats.ks_2samp(drawn[:, i, 0], whole[:, i]).pvalue > 1e-3
    # Not only each: their differences too.
    assert stats.ks_2samp(-np.diff(drawn[:, :, 0]).ravel(), -np.diff(whole[:, :3]).ravel()).pvalue > 1e-3
    assert stats.kstest(drawn[:, :, 1].ravel(), "uniform").pvalue > 1e-3


@pytest.mark.parametrize("looks", [1, 4, 64])
@pytest.mark.parametrize("probability", [1e-12, 1e-3, 0.5])
def test_threshold_of_any_number_of_looks(looks: int, probability: float) -> None:
    model = build_receiver(plain(looks=looks, false_alarm_probability=probability))
    expected = stats.gamma(looks, scale=1 / looks).isf(probability / 2**16)
    assert model.threshold == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("window", ["rect", "hann", "hamming"])
def test_bins_above_the_threshold_come_in_runs_under_a_window(window: str) -> None:
    """The share of bins above the threshold with which a run ends."""
    model = build_receiver(plain({"fft_length": LENGTH}, window=window, false_alarm_probability=0.5))
    above = np.concatenate([_simulated(1, window, 40_000, seed) for seed in range(3)]) > model.threshold
    ends = np.mean(~above[:, 1:][above[:, :-1]])
    standard_error = np.sqrt(ends * (1 - ends) / above[:, :-1].sum())
    # Without a window a neighbour is above by chance alone, which is left out.
    chance = np.exp(-model.threshold) if window == "rect" else 0.0
    assert model.independent_share == pytest.approx(ends + chance, abs=4 * standard_error)
    if window != "rect":
        assert model.independent_share < 0.97


@pytest.mark.parametrize("looks", [1, 8, 64])
@pytest.mark.parametrize("threshold", [1e-6, 0.3, 5.0, 20.0, 300.0, 690.0])
def test_exceedance_about_a_mean_is_the_noncentral_chi_squared_distributions(
    threshold: float, looks: int
) -> None:
    mean = np.array([1e-6, 0.5, 7.0, 36.0, 300.0, 700.0, 1200.0])
    expected = stats.ncx2.sf(2 * threshold, 2 * looks, 2 * mean)
    np.testing.assert_allclose(exceedance(mean, threshold, looks), expected, rtol=1e-9, atol=1e-11)
    tail = special.gammaincc(looks, np.append(mean, threshold))
    np.testing.assert_allclose(gamma_tail(looks, np.append(mean, threshold)), tail, rtol=0, atol=1e-14)
