"""Bins against numpy's FFT of the record, and the noise against its statistics."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpf

from lidar_emu.fmcw.sine import sin_pi
from lidar_emu.fmcw.spectrum import (
    BIN,
    BINS_PER_TONE,
    IM,
    POWER,
    RE,
    REACH,
    ROWS,
    TAPS,
    WINDOWS,
    Window,
    add_noise,
    fold,
    lay_bins,
    mirror_ends,
    set_power,
    set_tones,
    windowed_bin,
)

COSINES = {"rect": (1.0, 0.0), "hann": (0.5, 0.5), "hamming": (0.54, 0.46)}


def _record(signed_bin: np.ndarray, weight: np.ndarray, length: int) -> np.ndarray:
    """Real samples of tones that have the phase of `weight` at the record's centre."""
    n = np.arange(length)
    samples = np.zeros(length)
    for place, w in zip(signed_bin, weight, strict=True):
        phase = 2 * pi * place / length * (n - (length - 1) / 2) + np.angle(w)
        samples += abs(w) * np.cos(phase)
    return samples


def _windowed_fft(samples: np.ndarray, window: str) -> np.ndarray:
    """Bins 0 to N/2, scaled so that a tone of unit amplitude on its bin gives `centre`."""
    length = len(samples)
    a, b = COSINES[window]
    weights = a - b * np.cos(2 * pi * np.arange(length) / length)
    return np.fft.rfft(samples * weights) / (length / 2)


def _lay(signed_bin: np.ndarray, weight: np.ndarray, length: int) -> tuple[np.ndarray, int]:
    """The product's rectangular bins of these tones."""
    tones = np.empty((4, len(signed_bin)))
    for i, (place, w) in enumerate(zip(signed_bin, weight, strict=True)):
        observed, factor_re, factor_im = fold(place, float(length))
        tones[:, i] = np.rint(observed), observed - np.rint(observed), factor_re * w.real, factor_im * w.imag
    spectrum = np.zeros((ROWS, len(signed_bin) * BINS_PER_TONE))
    count = lay_bins(tones[0], float(length), np.empty(len(signed_bin)), spectrum)
    set_tones(tones, float(length), spectrum, count)
    mirror_ends(float(length), spectrum, count)
    return spectrum, count


def _inner(spectrum: np.ndarray, count: int, length: int) -> list[int]:
    """Columns with their neighbours in place, from bin 0 to N/2."""
    bins = spectrum[BIN, :count]
    return [j for j in range(1, count - 1) if bins[j + 1] - bins[j - 1] == 2 and 0 <= bins[j] <= length / 2]


def _worst_error(signed_bin: np.ndarray, weight: np.ndarray, length: int, window: str) -> float:
    """Largest complex error over the bins, relative to the spectrum's peak."""
    spectrum, count = _lay(signed_bin, weight, length)
    expected = _windowed_fft(_record(signed_bin, weight, length), window)
    taps = (*WINDOWS[window], cos(pi / length), sin(pi / length))
    worst = 0.0
    for j in _inner(spectrum, count, length):
        k = int(spectrum[BIN, j])
        ours = complex(*windowed_bin(spectrum, j, *taps)) * np.exp(1j * pi * k / length)
        worst = max(worst, abs(ours - expected[k]))
    return worst / float(abs(expected).max())


@pytest.mark.parametrize("window", ["rect", "hann", "hamming"])
@pytest.mark.parametrize(
    "places",
    [
        pytest.param([1000.0], id="on a bin"),
        pytest.param([1000.5], id="between bins"),
        pytest.param([1000.0 + 1e-9], id="nearly on a bin"),
        pytest.param([0.5], id="half a bin from DC"),
        pytest.param([0.0], id="on DC"),
        pytest.param([1e-3, 1.0, 2.0], id="close to DC"),
        pytest.param([-0.3, -7.25, -2000.125], id="folded at DC"),
        pytest.param([4095.5], id="half a bin from Nyquist"),
        pytest.param([4096.0], id="on Nyquist"),
        pytest.param([4094.999, 4093.0], id="close to Nyquist"),
        pytest.param([4100.7, 6000.25, 8191.5], id="folded at Nyquist"),
        pytest.param([-4100.7, -9000.3, 12345.6], id="folded twice"),
        pytest.param([3.3, 4090.1, 2048.0], id="from end to end"),
    ],
)
def test_bins_are_those_of_the_fft(places: list[float], window: str) -> None:
    weight = np.exp(1j * (0.7 + np.arange(len(places)))) * (1 + np.arange(len(places)))
    assert _worst_error(np.array(places), weight, 8192, window) < 1e-9


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(1, 127),
    centre=st.floats(-9000, 9000),
    spread=st.sampled_from([0.01, 1.0, 40.0, 3000.0]),
    window=st.sampled_from(["rect", "hann", "hamming"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_bins_of_any_set_of_tones(count: int, centre: float, spread: float, window: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = centre + spread * rng.standard_normal(count)
    weight = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    expected_peak = 1e-3 * abs(weight).max()
    spectrum = _windowed_fft(_record(places, weight, 4096), window)
    if abs(spectrum).max() > expected_peak:
        assert _worst_error(places, weight, 4096, window) < 1e-9


def test_bins_of_the_full_length() -> None:
    places = np.array([26042.123456, 26043.9, 19732.4999, 65535.75])
    assert _worst_error(places, np.exp(1j * np.arange(4)), 2**17, "hamming") < 1e-9


@pytest.mark.parametrize("x", [1e-18, -1e-9, 0.1, 0.25, -0.3, 0.499, 0.5, -0.5 - 1e-5])
def test_sine_keeps_its_relative_error(x: float) -> None:
    with mp.workdps(40):
        exact = mp.sin(mp.pi * mpf(x))
        assert abs(mpf(sin_pi(x)) / exact - 1) < 5e-16


@settings(max_examples=200, deadline=None)
@given(
    places=st.lists(st.integers(0, 128), min_size=1, max_size=40),
)
def test_bins_laid_are_the_union_around_the_tones(places: list[int]) -> None:
    tone_bin = np.array(places, dtype=float)
    spectrum = np.zeros((ROWS, len(places) * BINS_PER_TONE))
    count = lay_bins(tone_bin, 256.0, np.empty(len(places)), spectrum)
    expected = sorted(
        {k for n in places for k in range(n - REACH, n + REACH + 1) if -TAPS <= k <= 128 + TAPS}
    )
    assert spectrum[BIN, :count].tolist() == expected


def _noise_spectra(window: Window, first: int, bins: int, length: float, shots: int) -> np.ndarray:
    """(shots, bins) power of windowed noise."""
    spectrum = np.zeros((ROWS, 400))
    powers = np.empty((shots, bins))
    middle = np.arange(first + REACH, first + bins - REACH, 1.0)
    count = lay_bins(middle, length, np.empty(len(middle)), spectrum)
    taps = (*window, cos(pi / length), sin(pi / length))
    for shot in range(shots):
        spectrum[RE : IM + 1] = 0.0
        add_noise(np.uint64(3), shot, 0, 2, 0, length, spectrum, count)
        mirror_ends(length, spectrum, count)
        set_power(*taps, length, spectrum, count)
        powers[shot] = spectrum[POWER, :bins]
    return powers


@pytest.mark.parametrize("window", ["rect", "hann", "hamming"])
def test_noise_has_the_power_and_the_tail_of_each_window(window: str) -> None:
    powers = _noise_spectra(WINDOWS[window], 100, 40, 1024.0, 20_000)[:, TAPS:-TAPS]
    relative = powers / WINDOWS[window].noise_power
    assert abs(relative.mean() - 1) < 0.006
    # P_fa of one bin is an exponential tail. Neighbours are correlated under a window: a generous bound.
    for threshold in (2.0, 5.0):
        rate = (relative > threshold).mean()
        expected = np.exp(-threshold)
        assert abs(rate - expected) < 8 * np.sqrt(expected / relative.size)


@pytest.mark.parametrize("window", ["rect", "hann", "hamming"])
def test_noise_beside_dc_is_that_of_real_samples(window: str) -> None:
    powers = _noise_spectra(WINDOWS[window], -TAPS, 20, 64.0, 20_000)
    ours = powers[:, TAPS : TAPS + 6].mean(axis=0)
    samples = np.random.default_rng(5).standard_normal((20_000, 64))
    a, b = COSINES[window]
    weighted = samples * (a - b * np.cos(2 * pi * np.arange(64) / 64))
    expected = np.mean(abs(np.fft.rfft(weighted)[:, :6] / 8) ** 2, axis=0)
    assert ours[0] == 0  # no target is looked for at DC
    np.testing.assert_allclose(ours[1:], expected[1:], rtol=0.06)


def test_noise_of_a_bin_does_not_depend_on_its_interval() -> None:
    wide, narrow = np.zeros((ROWS, 200)), np.zeros((ROWS, 200))
    for spectrum, tones in ((wide, [490.0, 500.0, 505.0]), (narrow, [505.0])):
        count = lay_bins(np.array(tones), 1024.0, np.empty(len(tones)), spectrum)
        add_noise(np.uint64(3), 1, 2, 2, 1000, 1024.0, spectrum, count)
        mirror_ends(1024.0, spectrum, count)
    columns = {k: j for j, k in enumerate(wide[BIN, :100])}
    for j in range(BINS_PER_TONE - 1):
        k = narrow[BIN, j]
        if k > 0:
            assert (narrow[RE, j], narrow[IM, j]) == (wide[RE, columns[k]], wide[IM, columns[k]])
