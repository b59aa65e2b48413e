"""Stated variances against errors in a Gaussian process, in a Wiener process of the laser's phase, and in flight."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest
from exchanged_speckle import Peaks, peaks, robust, solve
from hypothesis import given, settings
from hypothesis import strategies as st

import lidar_emu
from lidar_emu.numerics.kernels import interpreted, with_fields
from lidar_emu.receiver.laser_phase_noise import _line_powers
from lidar_emu.receiver.peak_interpolation import PEAK_METHODS, peak
from lidar_emu.receiver.peak_shape import peak_shape, width_bin2
from lidar_emu.receiver.range_speed_estimation import ALL
from lidar_emu.receiver.speckle_variance import centre_wander, record_correlation
from lidar_emu.receiver.spectrum import BIN, NOISE, POWER, ROWS, WINDOWS
from lidar_emu.receiver.stated_variance import (
    VarianceLaw,
    build_variance_law,
    inconsistency,
    line_bin2,
    line_noise,
    state_variances,
    sweep_scatter,
)
from lidar_emu.receiver.whole_spectrum import estimator_window, find_targets, transform
from lidar_emu.receiver.workspace import TARGET
from lidar_emu.scenario.instrument import Detection, Waveform
from lidar_emu.scenario.load import load

NO_LASER = VarianceLaw(False, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), 1.0, 1.37, 0.0, 0.0, False)
TONE_WIDTH_BIN2 = 0.25


def _scores(found: Peaks, law: VarianceLaw = NO_LASER) -> np.ndarray:
    """Errors of range and Doppler shift over their stated deviations, (shots, 2)."""
    variance, common = np.empty_like(found.variance_bin2), np.empty(len(found.variance_bin2))
    for row in range(len(variance)):
        targets = np.zeros(3, dtype=TARGET)
        targets["variance_bin2"] = targets["quadrature_variance_bin2"] = found.variance_bin2[row]
        targets["quadrature_bin"] = np.clip(found.quadrature_bin[row], -0.5, 0.5)
        targets["quadrature_bin2"] = np.minimum(found.quadrature_bin2[row], 0.25)
        targets["width_bin2"] = TONE_WIDTH_BIN2
        common[row] = state_variances(law, ALL, with_fields(targets)).doppler_bin2
        variance[row] = targets["variance_bin2"]
    error, stated = solve(found.error_bin, variance)
    stated = stated.copy()
    stated[:, 1] += common
    return np.asarray(error / np.sqrt(stated))


@pytest.mark.slow
@pytest.mark.parametrize("speed_mps", [0.0, 4.0, 10.0, 20.0, 40.0, 80.0])
@pytest.mark.parametrize("snr_db", [30.0, 42.0])
def test_sigma_of_speckle_within_a_record(speed_mps: float, snr_db: float) -> None:
    score = _scores(peaks(speed_mps, 10 ** (0.1 * snr_db), 1500))
    assert 0.8 < robust(score[:, 0]) < 1.25
    assert 0.8 < robust(score[:, 1]) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("speed_mps", [0.0, 10.0, 20.0, 40.0])
@pytest.mark.parametrize("looks", [4, 16])
def test_sigma_of_several_looks(speed_mps: float, looks: int) -> None:
    """The mean over looks wanders less than one, with errors that are correlated from record to record."""
    found = peaks(speed_mps, 10**4.2, 600, looks)
    score = _scores(found, NO_LASER._replace(looks=float(looks)))
    assert 0.75 < robust(score[:, 0]) < 1.2
    assert 0.75 < robust(score[:, 1]) < 1.2


@pytest.mark.slow
def test_noise_alone_is_seldom_taken_for_speckle() -> None:
    """The same fade in all records leaves noise, which three quadratures exceed by chance."""
    score = _scores(peaks(0.0, 10**4.2, 4000))
    assert 0.92 < robust(score[:, 0]) < 1.08
    assert 0.92 < robust(score[:, 1]) < 1.08


@pytest.mark.slow
def test_quadrature_is_distributed_like_the_error() -> None:
    for speed_mps, snr in ((0.0, 1e3), (20.0, 1e4), (40.0, 1e2)):
        found = peaks(speed_mps, snr, 4000)
        assert robust(found.quadrature_bin[:, 1]) == pytest.approx(robust(found.error_bin[:, 1]), rel=0.08)
        signs = np.sign(found.quadrature_bin[:, 1] * found.error_bin[:, 1])
        assert abs(signs.mean()) < 4.0 / sqrt(4000)


@pytest.mark.parametrize("drift", [1e-4, 0.03, 0.5, 2.0])
def test_line_noise_is_the_pedestal_at_the_line(drift: float) -> None:
    rate = 2.0 * pi * 3.0
    power, pseudo = interpreted(_line_powers)(rate, drift, np.exp(-drift), (0.0, 1.0, 0.0), drift / rate)
    out_of_phase, in_phase = interpreted(line_noise)(rate, drift)
    assert out_of_phase == pytest.approx((power - pseudo) * np.exp(drift), rel=1e-3)
    # The series of the pedestal at a small drift ends at the second order.
    assert in_phase == pytest.approx((power + pseudo) * np.exp(drift), rel=1e-3, abs=1.1 * drift**3 / rate)


@pytest.mark.slow
@pytest.mark.parametrize("drift", [0.05, 0.4, 1.2])
def test_line_scatters_as_stated(drift: float) -> None:
    """Three Hann bins of exp(jΔφ), Δφ the change of a Wiener process within the delay."""
    rng, parts, linewidth = np.random.default_rng(8), 4096, 4.0
    delay = round(drift / (2.0 * pi * linewidth) * parts)
    steps = rng.standard_normal((1500, parts + delay)) * sqrt(2.0 * pi * linewidth / parts)
    phase = np.cumsum(steps, axis=1)
    light = np.exp(1j * (phase[:, delay:] - phase[:, :-delay]))
    beside = rng.uniform(-0.5, 0.5, (len(light), 1))
    place = (np.arange(parts) + 0.5) / parts
    light *= np.exp(2j * pi * beside * place) * (0.5 - 0.5 * np.cos(2.0 * pi * place))
    before, here, after = (light @ np.exp(-2j * pi * k * place) for k in (-1, 0, 1))
    q = ((before - after) / (2.0 * here + before + after)).real
    error = 4.0 * q / (3.0 + np.sqrt(9.0 + 16.0 * q * q)) - beside[:, 0]
    law = NO_LASER._replace(line_rate=2.0 * pi * linewidth, line_bin2=3.24 * 0.3898**2)
    drift = law.line_rate * delay / parts
    assert robust(error) == pytest.approx(
        sqrt(interpreted(line_bin2)(law, *interpreted(line_noise)(law.line_rate, drift))), rel=0.12
    )


def test_without_a_line_nothing_is_added() -> None:
    assert interpreted(line_noise)(0.0, 0.0) == (0.0, 0.0)


def test_sweep_moves_a_beat_in_proportion_to_the_range() -> None:
    waveform = Waveform(slope_scatter=1e-3, flicker_hz2=1e8)
    range_share, speed_mps_per_m = sweep_scatter(waveform, Detection())
    chirp, constant, _ = build_variance_law(waveform, Detection()).sweep_share
    assert chirp == pytest.approx(range_share)
    assert constant * waveform.speed_bin_mps == pytest.approx(speed_mps_per_m * waveform.range_bin_m)


@pytest.mark.parametrize("method", ["hann", "aboutanios_mulgrew"])
@pytest.mark.parametrize("place", [7.3, 200.3])
def test_kernel_and_samples_see_the_same_shape(method: str, place: float) -> None:
    rng, length = np.random.default_rng(3), 1024
    n = np.arange(length)
    for level in (1.0, 30.0):
        fading = 1.0 + 0.6 * (n / length - 0.5)
        record = 12.0 * fading * np.cos(2.0 * pi * place * n / length + 0.4)
        record += sqrt(level * length / 4.0) * 0.05 * rng.standard_normal(length)
        estimator_bins = transform(record[None], estimator_window(method))
        targets = find_targets(transform(record[None], "hamming"), estimator_bins, method, 1e-9, 0.3, 1e-4)
        k = np.arange(int(place) - 20, int(place) + 21)
        bins = np.fft.fft(record)[k] * (2.0 / length) * np.exp(-1j * pi * k / length)
        grid = np.zeros((ROWS, len(k)))
        grid[BIN], grid[NOISE] = k, 1e-4
        grid[POWER] = np.abs(transform(record[None], "hamming")[0, abs(k)]) ** 2
        j = len(k) // 2
        stack = np.array([[bins.real, bins.imag]])
        hann = interpreted(peak_shape)(grid, stack, j, float(length))
        arguments = PEAK_METHODS[method], grid, stack, j, WINDOWS["hamming"], float(length), hann
        offset, variance, shape = interpreted(peak)(*arguments)
        assert k[j] + offset == pytest.approx(targets.frequency_bin[0, 0], abs=1e-4)
        assert variance == pytest.approx(targets.variance_bin2[0, 0], rel=0.01)
        assert abs(shape.quadrature_bin) > 0.01
        assert shape.quadrature_bin == pytest.approx(targets.quadrature_bin[0, 0], rel=0.02)
        assert shape.quadrature_bin2 == pytest.approx(shape.quadrature_bin**2)
        assert shape.quadrature_variance_bin2 == pytest.approx(
            targets.quadrature_variance_bin2[0, 0], rel=0.02
        )
        assert shape.drift_bin == 0.0
        assert interpreted(width_bin2)(grid, j, len(k), 1.0) == pytest.approx(targets.width_bin2[0, 0])


def test_contradictory_frequencies_are_less_certain() -> None:
    assert interpreted(inconsistency)(np.nan, 1.0) == 1.0
    assert interpreted(inconsistency)(-1.5, 1e-4) > 1000.0
    assert interpreted(inconsistency)(3.9, 1.0) == 1.0
    for variance in (1e-6, 1.0, 1e3):
        edge = 1.0 + 3.0 * sqrt(variance)
        assert interpreted(inconsistency)(edge * (1.0 + 1e-9), variance) == pytest.approx(1.0, abs=1e-4)


@settings(deadline=None, max_examples=100)
@given(
    mask=st.sampled_from([3, 5, 6, 7]),
    frequency=st.lists(st.sampled_from([1.0, 10.0, 7e3, 65e3]), min_size=3, max_size=3),
    quadrature=st.lists(st.sampled_from([-0.5, 0.0, 1e-3, 0.5]), min_size=3, max_size=3),
    variance=st.sampled_from([1e-12, 1e-3, 1.0 / 3.0]),
    width=st.sampled_from([0.0, 0.3, 60.0]),
    linewidth_hz=st.sampled_from([0.0, 1.0, 3e3, 1e6]),
)
def test_whatever_the_peaks_hold(
    mask: int,
    frequency: list[float],
    quadrature: list[float],
    variance: float,
    width: float,
    linewidth_hz: float,
) -> None:
    law = build_variance_law(Waveform(linewidth_hz=linewidth_hz), Detection(peak="hann"))
    targets = np.zeros(3, dtype=TARGET)
    targets["frequency_bin"], targets["quadrature_bin"], targets["width_bin2"] = frequency, quadrature, width
    targets["variance_bin2"] = targets["quadrature_variance_bin2"] = variance
    speckle = state_variances(law, mask, with_fields(targets))
    there = [bool(mask & 1 << segment) for segment in range(3)]
    assert all(0.0 <= part < 1e13 for part in speckle)
    assert np.isfinite(targets["variance_bin2"]).all()
    assert (targets["variance_bin2"][there] >= 0.5 * variance).all()
    assert (targets["variance_bin2"][np.logical_not(there)] == variance).all()


def _scored(peak: str, level: dict[str, str], shots: int, looks: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Errors over sigma of a beam 300 m above level ground at 20 m/s sideways."""
    rate_hz = 500 / looks
    combine = "chirp_minus_doppler" if peak == "bin" else "least_squares"
    half_m = 0.505 * 2.0 * shots / rate_hz
    waypoints = ", ".join(
        f"{{altitude_m: {300 + side * half_m}, speed_mps: {20.1 + 0.05 * side}}}" for side in (1, -1)
    )
    keys = {
        "timing.rate_hz": str(rate_hz),
        "duration_s": str(shots / rate_hz),
        "instrument": f"{{base: ndl_fine, detection: {{peak: {peak}, combine: {combine}, looks: {looks}}}}}",
        "site": "{base: flat, surface: {reflectance: 0.18, lommel_seeliger_share: 1}}",
        "scanner": "{pattern: {kind: directions, beams: [[7.5, 0]]}}",
        "trajectory": f"{{kind: profile, path_angle_deg: 5.71, waypoints: [{waypoints}]}}",
    }
    run = lidar_emu.simulate(load("descent", keys | level), seed=1)
    good = run.range_valid & (np.abs(run.range_m - run.true_range_m) < 5.0)
    errors = run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps
    sigmas = run.sigma_range_m, run.sigma_speed_mps
    scores = [(e[good] - np.median(e[good])) / s[good] for e, s in zip(errors, sigmas, strict=True)]
    return scores[0], scores[1]


def test_sigma_of_quantised_peaks_is_their_root_mean_square() -> None:
    for score in _scored("bin", {}, 2000):
        assert 0.92 < score.std() < 1.08


@pytest.mark.parametrize("peak", ["hann", "aboutanios_mulgrew"])
def test_sigma_of_interpolated_peaks_is_their_robust_deviation(peak: str) -> None:
    for score in _scored(peak, {}, 2000):
        assert 0.85 < robust(score) < 1.15


@pytest.mark.slow
@pytest.mark.parametrize("peak", ["hann", "aboutanios_mulgrew"])
@pytest.mark.parametrize("looks", [4, 16])
def test_sigma_of_several_looks_is_their_robust_deviation(looks: int, peak: str) -> None:
    for score in _scored(peak, {}, 1000, looks):
        assert 0.7 < robust(score) < 1.2


def test_looks_correlate_as_in_a_gaussian_process() -> None:
    """Rates of the phase of a process with the correlation exp(-t²/2), in records of three segments and six looks."""
    rng, looks, step, shots = np.random.default_rng(4), 6, 0.3, 20000
    apart = step * np.subtract.outer(np.arange(3 * looks), np.arange(3 * looks))
    same = np.exp(-0.5 * apart**2)
    # The process and its rate: r, -r' and -r''.
    both = np.block([[same, apart * same], [-apart * same, (1.0 - apart**2) * same]])
    power, modes = np.linalg.eigh(both)
    field = rng.standard_normal((shots, len(both), 2)).view(complex)[..., 0]
    field = field @ (modes * np.sqrt(np.maximum(power, 0.0))).T
    light, rate = field[:, : 3 * looks], field[:, 3 * looks :]
    turning = (rate * light.conj()).imag.reshape(shots, looks, 3).mean(axis=1)
    fading = (rate * light.conj()).real.reshape(shots, looks, 3)
    one = fading.var()
    centre = np.arange(looks) - 0.5 * (looks - 1)
    strength = np.abs(light.reshape(shots, looks, 3)) ** 2
    wander = (strength * centre[:, None]).mean(axis=1) / strength.mean()
    for segments in range(3):
        expected = interpreted(record_correlation)(float(looks), step**2, float(segments))
        found = looks * np.mean(turning[:, 0] * turning[:, segments]) / one
        assert found == pytest.approx(expected, rel=0.05)
        moved = interpreted(centre_wander)(float(looks), step**2, float(segments))
        assert np.mean(wander[:, 0] * wander[:, segments]) == pytest.approx(moved, rel=0.06)
    # The rate of the power adds up to far less.
    assert looks * fading.mean(axis=1).var() < 0.5 * interpreted(record_correlation)(6.0, step**2, 0.0) * one


@pytest.mark.slow
@pytest.mark.parametrize("peak", ["hann", "aboutanios_mulgrew"])
def test_sigma_of_the_reference(peak: str) -> None:
    reference = {"level": "reference"}
    for score in _scored(peak, reference, 250):
        assert 0.8 < robust(score) < 1.25
        # Heavy tails: a normal distribution has 0.003.
        assert 0.005 < np.mean(np.abs(score) > 3.0) < 0.1
