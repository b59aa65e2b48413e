"""Measurements from samples against published cases, probabilities and slow readings of definitions."""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest
from beamlet_samples import ScattererPatches, measure_waveform
from hypothesis import example, given, settings
from hypothesis import strategies as st
from instruments import targets

from lidar_emu.receiver import range_speed_estimation
from lidar_emu.receiver.exhaustive_estimation import chirp_minus_doppler, least_squares
from lidar_emu.receiver.whole_spectrum import TARGETS, find_peaks, find_targets, transform
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Waveform

FINE = Detection(peak="hann", combine="least_squares")
SMALL = Waveform(fft_length=256, sample_rate_hz=600e6 / 512)


def _point(range_m: float, speed_mps: float, amplitude: complex = 1e3, **motion: float) -> ScattererPatches:
    return ScattererPatches(np.array([range_m]), np.array([speed_mps]), np.array([amplitude]), **motion)


@pytest.mark.parametrize(
    ("range_m", "speed_mps", "bins"),
    [
        (2164.784, 92.3880, (19732, 26042, 32352)),
        (541.196, 29.5641, (6756, 8333, 9911)),
        (504.314, 29.7433, (6914, 8384, 9854)),
        (2164.784, 46.1940, (6711, 13021, 19331)),
    ],
)
def test_published_descents(range_m: float, speed_mps: float, bins: tuple[int, ...]) -> None:
    waveform = Waveform()
    fixed = _point(range_m, speed_mps, range_rate_mps=0.0)
    measured = measure_waveform(waveform, Detection(), fixed, rng=np.random.default_rng(1))
    peaks = [int(target.frequency_bin[0, 0]) for target in measured.targets]
    assert np.abs(np.subtract(peaks, bins)).max() <= 1
    assert abs(measured.range_m[0] - range_m) < 0.343085 * 1.01
    assert abs(measured.closing_speed_mps[0] - speed_mps) < 3.547668e-3
    fine = measure_waveform(waveform, FINE, fixed)
    # Light that left a delay ago had another frequency: S T v / f_c and the like, 3e-6 of both.
    assert fine.range_m[0] == pytest.approx(range_m, abs=0.01)
    assert fine.closing_speed_mps[0] == pytest.approx(speed_mps, abs=5e-4)


def test_acceleration_shifts_the_range_by_what_is_known() -> None:
    waveform = Waveform()
    acceleration_mps2 = 2.0
    still, pushed = (
        measure_waveform(waveform, FINE, _point(1000.0, 60.0, closing_acceleration_mps2=a)).range_m[0]
        for a in (0.0, acceleration_mps2)
    )
    bias_m = SPEED_OF_LIGHT_MPS * waveform.segment_time_s * acceleration_mps2
    bias_m /= waveform.wavelength_m * waveform.chirp_slope_hz_per_s
    assert pushed - still == pytest.approx(bias_m, rel=0.02)


def test_footprint_slides_from_segment_to_segment() -> None:
    waveform, rate_mps = Waveform(), 20_000.0
    slid, fixed = (
        measure_waveform(waveform, FINE, _point(1000.0, 60.0, range_rate_mps=r)) for r in (rate_mps, 0.0)
    )
    shift_bin = 2 * waveform.chirp_slope_hz_per_s * rate_mps * waveform.segment_time_s / SPEED_OF_LIGHT_MPS
    shift_bin /= waveform.bin_width_hz
    # Before validity the surface is nearer: at 60 m/s the up-chirp's tone is folded at 0, and rises.
    for s, expected in enumerate((shift_bin, 0.0, shift_bin)):
        moved = slid.targets[s].frequency_bin[0, 0] - fixed.targets[s].frequency_bin[0, 0]
        assert moved == pytest.approx(expected, abs=0.01)
    resting = measure_waveform(waveform, FINE, _point(1000.0, 60.0))
    same = measure_waveform(waveform, FINE, _point(1000.0, 60.0, range_rate_mps=-60.0))
    assert resting.targets[2].frequency_bin[0, 0] == same.targets[2].frequency_bin[0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("window", ["rect", "hann", "hamming"])
def test_noise_alone_crosses_the_threshold_as_often_as_asked(window: str) -> None:
    records, probability = 10_000, 0.05
    detection = Detection(window=window, false_alarm_probability=probability)
    dark = ScattererPatches(np.array([100.0]), np.array([1.0]), np.broadcast_to(0j, (records, 3, 1)))
    measured = measure_waveform(SMALL, detection, dark, rng=np.random.default_rng(7))
    for target in measured.targets:
        rate = np.isfinite(target.frequency_bin[:, 0]).mean()
        # 127 bins at the probability meant for 128; crossings of neighbours under a window come together.
        expected = 1 - (1 - probability / 128) ** 127
        assert rate < expected + 5 * np.sqrt(expected / records)
        assert rate > (1.0 if window == "rect" else 0.7) * expected - 5 * np.sqrt(expected / records)


@pytest.mark.parametrize("rest", [-0.5, -0.3, 0.0, 1e-9, 0.2, 0.499])
def test_three_bins_find_a_clean_tone(rest: float) -> None:
    n = np.arange(4096) - 4095 / 2
    samples = 10 * np.cos(2 * np.pi * (1000 + rest) / 4096 * n + 0.7)[None]
    targets = find_targets(transform(samples, "hamming"), transform(samples, "hann"), "hann", 1.0, 0.3)
    assert targets.frequency_bin[0, 0] == pytest.approx(1000 + rest, abs=1e-6)
    assert abs(targets.peak_bin[0, 0] - 1000 - rest) <= 0.5 + 1e-9


@pytest.mark.parametrize("rest", [0.0, 0.2, -0.45])
@pytest.mark.parametrize("level", [1.0, 3.0])
def test_three_bins_know_their_variance(rest: float, level: float) -> None:
    rng, n = np.random.default_rng(4), np.arange(512) - 511 / 2
    samples = 40 * np.cos(2 * np.pi * (100 + rest) / 512 * n + 0.7)
    samples = samples + np.sqrt(level * 512 / 4) * rng.standard_normal((20_000, 512))
    targets = find_targets(*2 * [transform(samples, "hann")], "hann", 1.0, 0.3, level)
    scatter = targets.frequency_bin[:, 0].var()
    assert np.mean(targets.variance_bin2[:, 0]) == pytest.approx(scatter, rel=0.05)


def _slow_peaks(inner: list[float], threshold: float, fraction: float) -> list[int]:
    floor = fraction**2 * max(inner)
    runs = [list(run) for above, run in groupby(range(len(inner)), lambda j: inner[j] > floor) if above]
    highest = [max(run, key=lambda j: inner[j]) for run in runs]
    found = sorted((j for j in highest if inner[j] > threshold), key=lambda j: -inner[j])[:TARGETS]
    return found + [-1] * (TARGETS - len(found))


@settings(deadline=None)
@given(
    power=st.lists(
        st.lists(st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 8.5, 30.0]), min_size=17, max_size=17),
        min_size=1,
        max_size=4,
    ),
    threshold=st.sampled_from([0.7, 2.0, 7.0, 40.0]),
    fraction=st.sampled_from([0.1, 0.3, 0.6]),
)
def test_peaks_against_a_slow_reading(power: list[list[float]], threshold: float, fraction: float) -> None:
    ours = find_peaks(np.array(power), threshold, fraction)
    assert ours.tolist() == [_slow_peaks([0.0, *row[1:-1], 0.0], threshold, fraction) for row in power]


@settings(deadline=None)
@given(
    beat=st.floats(20.0, 15_000.0),
    doppler=st.floats(-50_000.0, 50_000.0),
    variance=st.tuples(*[st.floats(1e-4, 1.0)] * 3),
)
def test_consistent_frequencies_are_solved(beat: float, doppler: float, variance: tuple[float, ...]) -> None:
    length = 2**17
    signed = np.array([beat - doppler, doppler, beat + doppler])
    observed = abs(signed - length * np.rint(signed / length))
    solved = least_squares(observed[None], np.array([variance]), length, 20_000.0)
    # A solution reached by folds may have a rival without: then only the residual can tell.
    if abs(signed).max() < length / 2:
        assert solved.range_bin[0] == pytest.approx(beat, abs=1e-6)
        assert solved.doppler_bin[0] == pytest.approx(doppler, abs=1e-6)
        simple = chirp_minus_doppler(observed[None], np.array([variance]), length, 20_000.0)
        assert simple.range_bin[0] == pytest.approx(beat, abs=1e-6)
        assert simple.doppler_bin[0] == pytest.approx(doppler, abs=1e-6)


def test_weights_of_least_squares_are_those_of_a_general_solver() -> None:
    observed, variance = np.array([[200.3, 400.1, 1000.9]]), np.array([[0.2, 0.01, 0.5]])
    solved = least_squares(observed, variance, 2**17, 20_000.0)
    root = 1 / np.sqrt(variance[0])
    design = np.array([[1, -1], [0, 1], [1, 1.0]]) * root[:, None]
    expected = np.linalg.lstsq(design, observed[0] * root)[0]
    np.testing.assert_allclose([solved.range_bin[0], solved.doppler_bin[0]], expected, rtol=1e-12)


@pytest.mark.parametrize(("variance", "range_bin"), [(1 / 12, 312.0), (1.0, 310.0)])
def test_a_fold_must_be_worth_three_standard_deviations(variance: float, range_bin: float) -> None:
    """Of 1024 bins, 510 may be 514: then the residual of 4 is 0, worth 16 / 6 variances."""
    solved = least_squares(np.array([[110.0, 202.0, 510.0]]), np.full((1, 3), variance), 1024, 400.0)
    assert solved.range_bin[0] == pytest.approx(range_bin)


@pytest.mark.slow
@settings(deadline=None)
@given(
    # At N/2 itself a frequency and its alias are one, and either may be named.
    observed=st.tuples(*[st.floats(0.0, 511.0)] * 3),
    variance=st.tuples(*[st.floats(1e-3, 1.0)] * 3),
    # Within Nyquist, beyond it, and beyond the sample rate.
    farthest=st.sampled_from([400.0, 700.0, 3000.0]),
)
# Ties: of range and direction, of direction alone, of range alone, and of the sign of the shorter chirp.
@example(observed=(2.0, 1e-5, 2.0), variance=(1.0, 1.0, 1.0), farthest=400.0)
@example(observed=(2.0, 1e-5, 2.0), variance=(0.5, 1.0, 0.5), farthest=400.0)
@example(observed=(1.0, 0.0, 1.1), variance=(1.0, 1.0, 1.0), farthest=400.0)
@example(observed=(0.1, 1.0, 2.0), variance=(1.0, 1.0, 1.0), farthest=400.0)
def test_everything_combined_is_that_of_the_spectral_level(
    observed: tuple[float, ...], variance: tuple[float, ...], farthest: float
) -> None:
    """Two programs for one definition: whatever comes, they conclude the same."""
    ours = (
        chirp_minus_doppler(np.array([observed]), np.array([variance]), 1024, farthest),
        least_squares(np.array([observed]), np.array([variance]), 1024, farthest),
    )
    theirs = (
        range_speed_estimation.chirp_minus_doppler(targets(observed, variance), 1024.0, farthest),
        range_speed_estimation.least_squares(
            range_speed_estimation.ALL, targets(observed, variance), 1024.0, farthest
        ),
    )
    for slow, fast in zip(ours, theirs, strict=True):
        assert np.isfinite(slow.range_bin[0]) == fast.found
        if fast.found:
            for name in ("range_bin", "doppler_bin", "range_variance", "doppler_variance", "residual_bin"):
                assert getattr(slow, name)[0] == pytest.approx(getattr(fast, name), rel=1e-9, abs=1e-9)
            assert slow.sign_resolved[0] == fast.sign_resolved
