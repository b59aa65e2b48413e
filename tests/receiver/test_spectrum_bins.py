"""Bins against numpy's FFT of the record, and the noise against its statistics."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import mp, mpf
from scipy import stats
from synthesis import COSINES, fft_bins, laid_intervals, tones_in_time

from lidar_emu.numerics.random_streams import draw_reserved, normals, set_normals
from lidar_emu.numerics.vectors import sin_pi, single_sin_pi
from lidar_emu.receiver.spectrum import (
    BIN,
    NOISE,
    POWER,
    REACH,
    TAPS,
    WINDOWS,
    SpectralWindow,
    add_noise,
    fold,
    mirror_ends,
    reserve_noise,
    set_power,
)
from lidar_emu.receiver.tone_bins import set_tones


def _lay(signed_bin: np.ndarray, weight: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """The product's grid and rectangular bins of these tones, the columns in use."""
    tones = np.empty((4, len(signed_bin)), dtype=np.float32)
    for i, (place, w) in enumerate(zip(signed_bin, weight, strict=True)):
        observed, factor_re, factor_im = fold(place, float(length))
        tones[:, i] = np.rint(observed), observed - np.rint(observed), factor_re * w.real, factor_im * w.imag
    grid, ends = laid_intervals(tones[0], length)
    count, bins = ends[ends[0]], np.zeros((2, grid.shape[1]), dtype=np.float32)
    wide = np.empty((4, grid.shape[1]))
    set_tones(tones, len(signed_bin), float(length), grid, count, bins, wide)
    mirror_ends(float(length), grid, count, bins)
    return grid[:, :count], bins[:, :count]


def _inner(grid: np.ndarray, length: int) -> list[int]:
    """Columns with their neighbours in place, from bin 0 to N/2."""
    k = grid[BIN]
    return [j for j in range(1, len(k) - 1) if k[j + 1] - k[j - 1] == 2 and 0 <= k[j] <= length / 2]


def _worst_error(signed_bin: np.ndarray, weight: np.ndarray, length: int, window: str) -> float:
    """Largest complex error over the bins, relative to the spectrum's peak."""
    grid, bins = _lay(signed_bin, weight, length)
    expected = fft_bins(tones_in_time(signed_bin, weight, length), window)
    taps, turn = WINDOWS[window], np.exp(1j * pi / length)
    complex_bins, worst = bins[0] + 1j * bins[1].astype(float), 0.0
    for j in _inner(grid, length):
        k = int(grid[BIN, j])
        below, here, above = complex_bins[j - 1 : j + 2]
        ours = taps.centre * here + taps.side * (below * turn.conjugate() + above * turn)
        ours *= np.exp(1j * pi * k / length)
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
    assert _worst_error(np.array(places), weight, 8192, window) < 3e-7


@pytest.mark.slow
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
    spectrum = fft_bins(tones_in_time(places, weight, 4096), window)
    if abs(spectrum).max() > expected_peak:
        assert _worst_error(places, weight, 4096, window) < 3e-6


def test_bins_of_the_full_length() -> None:
    places = np.array([26042.123456, 26043.9, 19732.4999, 65535.75])
    assert _worst_error(places, np.exp(1j * np.arange(4)), 2**17, "hamming") < 3e-7


@pytest.mark.parametrize("x", [1e-18, -1e-9, 0.1, 0.25, -0.3, 0.499, 0.5, -0.5 - 1e-5])
def test_sine_keeps_its_relative_error(x: float) -> None:
    with mp.workdps(40):
        exact = mp.sin(mp.pi * mpf(x))
        assert abs(mpf(sin_pi(x)) / exact - 1) < 5e-16
        single = np.float32(x)
        if abs(single) <= 0.5:
            exact = mp.sin(mp.pi * mpf(float(single)))
            assert abs(mpf(float(single_sin_pi(single))) / exact - 1) < 3e-7


@settings(max_examples=200, deadline=None)
@given(places=st.lists(st.integers(0, 128), min_size=1, max_size=40))
def test_bins_laid_are_the_union_around_the_tones(places: list[int]) -> None:
    grid, ends = laid_intervals(np.array(places, dtype=float), 256)
    laid = grid[BIN, : ends[ends[0]]]
    # Tones no farther apart than 48 bins share one interval, whatever lies between them.
    middles = range(min(places), max(places) + 1) if max(places) - min(places) <= 48 else places
    around = {k for n in middles for k in range(n - REACH, n + REACH + 1)}
    expected = sorted(k for k in around if -TAPS <= k <= 128 + TAPS)
    assert laid.tolist() == expected
    starts = np.concatenate([[0], 1 + np.flatnonzero(np.diff(laid) > 1)])
    assert [0, *ends[1 : ends[0]]] == starts.tolist()


def _add_noise(
    shot: int, first_index: int, length: float, laid: tuple[np.ndarray, np.ndarray], bins: np.ndarray
) -> None:
    grid, ends = laid
    drawn = normals(4 * grid.shape[1] + 2 * len(ends))
    count = reserve_noise(5, first_index, grid, ends, 0, drawn)
    draw_reserved(np.uint64(3), shot, count, drawn.counters, drawn.words)
    set_normals(count, drawn)
    add_noise(length, grid, NOISE, ends, bins, 0, drawn)
    mirror_ends(length, grid, ends[ends[0]], bins)


def _noise_spectra(
    window: SpectralWindow, first: int, count: int, length: float, shots: int, looks: int = 1
) -> np.ndarray:
    """(shots, count) power of windowed noise."""
    laid = laid_intervals(np.arange(first + REACH, first + count - REACH, 1.0), int(length))
    grid, ends = laid
    powers = np.empty((shots, count))
    for shot in range(shots):
        bins = np.zeros((looks, 2, grid.shape[1]), dtype=np.float32)
        for look in range(looks):
            _add_noise(shot, look * 2**24, length, laid, bins[look])
        set_power(window, length, 0.0, grid, ends, bins)
        powers[shot] = grid[POWER, :count]
    return powers


@pytest.mark.slow
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


@pytest.mark.slow
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


def test_looks_are_averaged() -> None:
    """The mean of M exponential powers: M times it, doubled, is chi-squared with 2M degrees of freedom."""
    powers = _noise_spectra(WINDOWS["rect"], 100, 40, 1024.0, 2000, looks=4)[:, TAPS:-TAPS]
    assert stats.kstest(8 * powers.ravel(), stats.chi2(8).cdf).pvalue > 1e-3


def test_noise_has_the_level_of_its_bin() -> None:
    laid = laid_intervals(np.array([500.0]), 1024)
    grid, ends = laid
    grid[NOISE] = 1.0 + np.arange(grid.shape[1])
    power = np.zeros(grid.shape[1])
    shots = 4000
    for shot in range(shots):
        bins = np.zeros((2, grid.shape[1]), dtype=np.float32)
        _add_noise(shot, 0, 1024.0, laid, bins)
        power += (bins**2).sum(axis=0) / shots
    count = ends[ends[0]]
    np.testing.assert_allclose(power[:count], grid[NOISE, :count], rtol=5 / np.sqrt(shots))


def test_noise_of_a_bin_does_not_depend_on_its_interval() -> None:
    drawn = []
    for tones in ([490.0, 500.0, 505.0], [504.0], [511.0], [100.0, 505.0]):
        laid = laid_intervals(np.array(tones), 1024)
        grid, ends = laid
        bins = np.zeros((2, grid.shape[1]), dtype=np.float32)
        _add_noise(1, 1000, 1024.0, laid, bins)
        count = ends[ends[0]]
        drawn.append({k: tuple(b) for k, b in zip(grid[BIN, :count], bins.T[:count], strict=True)})
    for other in drawn[1:]:
        shared = drawn[0].keys() & other.keys()
        assert len(shared) > REACH
        assert all(other[k] == drawn[0][k] for k in shared)
