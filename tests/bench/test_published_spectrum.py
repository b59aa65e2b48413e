"""The published way to a spectrum against the FFT of the whole record, and its convergence."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.published_spectrum import build_published_spectrum, published_bins
from benchmarks.spectra import SpectrumMethod, compare_spectra, ratio_to_published
from lidar_emu.beams.flight import Flight
from lidar_emu.receiver.spectrum import WINDOWS
from lidar_emu.scenario.load import load

N = 4096
FIRST = 900
SHORT = {
    "duration_s": "1.5",
    "instrument.waveform.fft_length": "4096",
    "instrument.optics.laser_power_w": "40",
}


def some_tones(seed: int, count: int = 61) -> np.ndarray:
    rng = np.random.default_rng(seed)
    place = FIRST + rng.uniform(100, 150, count)
    weight = rng.normal(size=(2, count))
    return np.array([np.rint(place), place - np.rint(place), *weight])[None]


def bins_of_the_record(tones: np.ndarray, window: str, count: int) -> np.ndarray:
    """Windowed transform of the complex record; the real one's image, far away, is in neither."""
    n, rest, re, im = tones[0]
    t = np.arange(N) - (N - 1) / 2
    record = ((re + 1j * im) * np.exp(2j * np.pi * t[:, None] * (n + rest) / N)).sum(axis=1)
    a = 2 * WINDOWS[window].side
    spectrum = np.fft.fft(record * (WINDOWS[window].centre + a * np.cos(2 * np.pi * np.arange(N) / N))) / N
    k = np.arange(FIRST, FIRST + count)
    return spectrum[k] * np.exp(-1j * np.pi * k / N)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize(("deposit", "order"), [("nearest", 1), ("cubic", 4)])
def test_error_falls_with_the_oversampling(window, deposit, order):
    tones = some_tones(1)
    exact = bins_of_the_record(tones, window, 256)
    errors = []
    for oversample in (8, 16, 32, 64):
        spectrum = build_published_spectrum(WINDOWS[window], N, 256 * oversample, oversample, deposit)
        error = np.abs(published_bins(spectrum, tones, np.array([float(FIRST)]))[0] - exact)[60:190]
        errors.append(error.max() / np.abs(exact).max())
    assert errors[0] > (1e-6 if deposit == "cubic" else 1e-2)
    slope = -np.polyfit(np.log2([8, 16, 32, 64]), np.log2(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.5)


def test_tones_on_the_grid_are_exact():
    tones = some_tones(2)
    place = np.rint((tones[0, 0] + tones[0, 1]) * 8) / 8
    tones[0, 0], tones[0, 1] = np.rint(place), place - np.rint(place)
    for deposit in ("nearest", "cubic"):
        spectrum = build_published_spectrum(WINDOWS["hann"], N, 2048, 8, deposit)
        got = published_bins(spectrum, tones, np.array([float(FIRST)]))[0]
        exact = bins_of_the_record(tones, "hann", 256)
        np.testing.assert_allclose(got[60:190], exact[60:190], atol=1e-11)


def test_spectra_are_compared_with_the_fastest_that_was_published() -> None:
    methods = [
        SpectrumMethod("samples and FFT", 1.0, 0.0),
        SpectrumMethod("published, nearest, 2048 points", 3e-5, 1e-3),
        SpectrumMethod("published, cubic, 2048 points", 2e-5, 1e-3),
        SpectrumMethod("bin by bin", 1e-6, 1e-9),
    ]
    assert ratio_to_published(methods) == pytest.approx(20.0)
    assert ratio_to_published([methods[0], methods[-1]]) is None


@pytest.mark.slow
def test_bins_agree_with_the_samples_and_the_published_method_with_its_order() -> None:
    scenario = load("descent.yaml", SHORT)
    errors = {method.name: method.error for method in compare_spectra(scenario, Flight(scenario), rounds=1)}
    assert [name.split(",")[0] for name in errors] == ["samples and FFT", *["published"] * 4, "bin by bin"]
    assert errors["bin by bin"] < 4e-7  # in single precision
    assert errors["published, nearest, 2048 points"] > 1e-3 > errors["published, cubic, 2048 points"]
