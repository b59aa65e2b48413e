"""The closed forms of benchmarks/unmodelled_errors.py agree with records and integrals, and its table is the page's."""

from __future__ import annotations

from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from beamlet_samples import ScattererPatches, measure_waveform
from scipy.integrate import quad

from benchmarks import unmodelled_errors as sizes
from benchmarks.tables import markdown
from lidar_emu.receiver.whole_spectrum import find_targets, transform
from lidar_emu.scenario.instrument import Detection, Waveform

ROOT = Path(__file__).resolve().parents[2]

RECORD_S = 2**17 / 600e6


@pytest.mark.parametrize("frequency_hz", [3e3, 10e3, 25e3])
def test_a_ripple_of_the_chirp_moves_the_fitted_beat(frequency_hz: float) -> None:
    deviation_hz, delay_s = 1e3, 4e-6
    time_s = (np.arange(20_000) + 0.5) / 20_000 * RECORD_S - RECORD_S / 2.0
    errors = []
    for turn in np.arange(16) / 16.0:

        def cycles(t: np.ndarray, turn: float = turn) -> np.ndarray:
            return -deviation_hz / (2 * pi * frequency_hz) * np.cos(2 * pi * (frequency_hz * t + turn))

        errors.append(np.polyfit(time_s, cycles(time_s) - cycles(time_s - delay_s), 1)[0])
    weight = abs(float(sizes.parabola(pi * frequency_hz * RECORD_S)))
    expected_hz = 2.0 * deviation_hz * np.sin(pi * frequency_hz * delay_s) * weight / sqrt(2.0)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(expected_hz, rel=1e-3)


@pytest.mark.parametrize(("delay_s", "tolerance"), [(RECORD_S / 1000, 0.01), (13.3e-6, 0.1)])
def test_flicker_scatters_a_beat_by_three_delays_over_the_record(delay_s: float, tolerance: float) -> None:
    def density(log_f: float) -> float:
        f = np.exp(log_f)
        return float(4.0 * np.sin(pi * f * delay_s) ** 2 * sizes.parabola(pi * f * RECORD_S) ** 2)

    variance, _ = quad(density, np.log(1e1), np.log(1e7), limit=2000)
    assert sqrt(variance) == pytest.approx(3.0 * delay_s / RECORD_S, rel=tolerance)


@pytest.mark.parametrize("apart_bin", [0.2, 0.7, 1.5, 2.6, 4.3])
def test_another_tone_pulls_the_peak(apart_bin: float) -> None:
    count, place, amplitude = 1024, 200, 1e-4
    turns = 2.0 * pi * (np.arange(count) - 0.5 * (count - 1)) / count
    phase = 2.0 * pi * np.arange(32)[:, None] / 32.0
    record = np.cos(place * turns) + amplitude * np.cos((place + apart_bin) * turns + phase)
    bins = transform(record, "rect")
    targets = find_targets(bins, bins, "aboutanios_mulgrew", 1e-9, 0.3)
    offsets = targets.frequency_bin[:, 0] - place
    found = np.max(np.abs(offsets)) / amplitude
    assert found == pytest.approx(float(sizes.pull(np.array(apart_bin))), rel=0.02)


def test_aperture_jitter_is_noise_in_every_bin() -> None:
    rng = np.random.default_rng(1)
    rate_hz, count, place, snr = 600e6, 4096, 777, 1e4
    n, records = np.arange(count), 200
    jitter_s = 20e-12
    late_s = jitter_s * rng.standard_normal((records, count))
    # An amplitude of sqrt(snr) beside noise of the variance N/4 has this ratio in its bin.
    record = sqrt(snr) * np.cos(2 * pi * place * rate_hz / count * (n / rate_hz + late_s))
    power = np.abs(np.fft.rfft(record)) ** 2 * (2.0 / count) ** 2
    elsewhere = np.abs(np.arange(power.shape[1]) - place) > 3
    expected = 2.0 * snr / count * (2 * pi * place * rate_hz / count * jitter_s) ** 2
    assert power[:, elsewhere].mean() == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("changed", "range_factor", "speed_factor"),
    [("sample_rate_hz", 1.0 / 1.001, 1.0 / 1.001), ("wavelength_m", 1.0, 1.0 / 1.001)],
)
def test_a_wrong_clock_or_wavelength_scales_what_is_measured(
    changed: str, range_factor: float, speed_factor: float
) -> None:
    """As a fault of kind `scale` does: the frequencies of a record, read with the nominal keys."""
    nominal = Waveform(linewidth_hz=0.0)
    true = nominal.model_copy(update={changed: 1.001 * getattr(nominal, changed)})
    surface = ScattererPatches(np.array([500.0]), np.array([20.0]), np.array([1e3 + 0j]), range_rate_mps=0.0)
    found = []
    for waveform in (nominal, true):
        targets = measure_waveform(waveform, Detection(peak="hann"), surface).targets
        _, line, down = (float(each.frequency_bin[0, 0]) for each in targets)
        found.append(((down - line) * nominal.range_bin_m, line * nominal.speed_bin_mps))
    assert found[1][0] / found[0][0] == pytest.approx(range_factor, abs=5e-6)
    assert found[1][1] / found[0][1] == pytest.approx(speed_factor, abs=5e-6)


@pytest.mark.slow
def test_the_table_is_the_pages() -> None:
    page = (ROOT / "docs" / "evidence" / "error-sources.md").read_text(encoding="utf-8")
    printed = page.partition("<!-- unmodelled: begin -->\n")[2].partition("\n<!-- unmodelled: end -->")[0]
    assert printed == markdown(sizes.parts()), "run python -m benchmarks.tables unmodelled"
