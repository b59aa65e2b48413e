"""The spectral path's bins against transforms of sampled records.

With the physics in the samples, bins agree to 1e-6 of the peak where the beat stays put. What limits the chirps is the
migration of the target during the record, 4 S v / c: the tone's phase at the record's ends is off by π S v T²/c,
1.0e-3 rad per m/s. In the constant segment without acceleration the beat is constant to rounding, of single precision.
"""

from __future__ import annotations

import numpy as np
import pytest
from beamlet_samples import Beamlets, analytic_record

from lidar_emu.receiver.spectrum import (
    BIN,
    REACH,
    ROWS,
    WINDOWS,
    fold,
    grid_capacity,
    lay_bins,
)
from lidar_emu.receiver.tone_bins import set_tones
from lidar_emu.receiver.whole_spectrum import transform
from lidar_emu.reference.laser_sweep import Segment, frequency_plan
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Waveform

WINDOW_NAMES = ["rect", "hann", "hamming"]
ROUNDING = 4e-7
"""Of sums of tones in single precision, over the peak."""

SHORT = Waveform(fft_length=4096, sample_rate_hz=600e6 / 32)
"""The record of the defaults with fewer samples: tones fold many times over."""


def _spectral(signed_bin: np.ndarray, weight: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the bins that the spectral path lays around these tones, and the rectangular bins."""
    tones = np.empty((4, len(signed_bin)), dtype=np.float32)
    for i, (place, w) in enumerate(zip(signed_bin, weight, strict=True)):
        observed, factor_re, factor_im = fold(place, float(length))
        tones[:, i] = np.rint(observed), observed - np.rint(observed), factor_re * w.real, factor_im * w.imag
    capacity = grid_capacity(len(signed_bin), REACH, length)
    grid, bins = (np.zeros((rows, capacity), dtype=np.float32) for rows in (ROWS, 2))
    scratch, ends = np.empty_like(tones[0]), np.zeros(len(signed_bin) + 1, dtype=np.int64)
    count = lay_bins(tones[0], float(REACH), float(length), scratch, grid, ends)
    set_tones(tones, len(signed_bin), float(length), grid, count, bins, np.empty((4, capacity)))
    kept = (grid[BIN, :count] >= 0) & (grid[BIN, :count] <= length / 2)
    return grid[BIN, :count][kept].astype(int), (bins[0] + 1j * bins[1])[:count][kept]


def _error(signed_bin: np.ndarray, weight: np.ndarray, samples: np.ndarray, window: str) -> float:
    """Largest complex error of windowed bins with both neighbours, over the peak of the samples' spectrum."""
    length = len(samples)
    numbers, rect = _spectral(signed_bin, weight, length)
    expected = transform(samples, window)
    # Bins of the spectral path are the transform's times exp(-jπk/N).
    turned = rect * np.exp(1j * np.pi * numbers / length)
    inner = np.flatnonzero((numbers[2:] - numbers[:-2]) == 2) + 1
    taps = WINDOWS[window]
    windowed = taps.centre * turned[inner] + taps.side * (turned[inner - 1] + turned[inner + 1])
    assert inner.size >= REACH - 2
    worst = abs(windowed - expected[numbers[inner]]).max()
    return float(worst / abs(expected).max())


def _signed_bins(waveform: Waveform, segment: Segment, beamlets: Beamlets) -> np.ndarray:
    """Beats at the record's centre, in bins."""
    optical_hz = segment.start_frequency_hz + segment.slope_hz_per_s * segment.start_to_centre_s
    beat_hz = abs(segment.slope_hz_per_s) * 2 * beamlets.range_m / SPEED_OF_LIGHT_MPS
    sign = -segment.beat_sign
    shift_hz = (optical_hz + sign * beat_hz) * 2 * beamlets.closing_speed_mps / SPEED_OF_LIGHT_MPS
    return (beat_hz + sign * shift_hz) / waveform.bin_width_hz


def _footprint(kind: str, count: int, speed_mps: float) -> Beamlets:
    """`count` patches of a beam some 1e-4 rad wide, closing at `speed_mps`, with a share of it across."""
    rng = np.random.default_rng(count)
    along, across = rng.uniform(-3e-5, 3e-5, (2, count))
    range_m = {
        "flat": 2164.784 * (1 + np.tan(np.radians(22.5)) * along),
        "slope of 30 degrees": 2164.784 * (1 + np.tan(np.radians(52.5)) * along),
        "cliff": 541.196 + np.where(across > 0, 120.0, 0.0),
        "two targets": np.where(np.arange(count) % 4 == 0, 504.314, 541.196),
    }[kind]
    closing_mps = speed_mps * (1 + 0.5 * along)
    weight = (rng.standard_normal(count) + 1j * rng.standard_normal(count)) * np.exp(-((across / 3e-5) ** 2))
    return Beamlets(range_m, closing_mps, 0.0, weight)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 7, 64, 1024])
@pytest.mark.parametrize("kind", ["flat", "slope of 30 degrees", "cliff", "two targets"])
def test_footprint_at_rest(kind: str, count: int) -> None:
    beamlets = _footprint(kind, count, 2e-4)
    for segment in frequency_plan(SHORT):
        samples = analytic_record(SHORT, segment, beamlets).real
        signed_bin = _signed_bins(SHORT, segment, beamlets)
        for window in WINDOW_NAMES:
            assert _error(signed_bin, beamlets.weight, samples, window) < 1e-6


@pytest.mark.parametrize("speed_mps", [92.388, -30.0])
@pytest.mark.parametrize("kind", ["flat", "cliff"])
def test_constant_segment_in_motion(kind: str, speed_mps: float) -> None:
    segment = frequency_plan(SHORT)[1]
    beamlets = _footprint(kind, 64, speed_mps)
    samples = analytic_record(SHORT, segment, beamlets).real
    for window in WINDOW_NAMES:
        assert _error(_signed_bins(SHORT, segment, beamlets), beamlets.weight, samples, window) < ROUNDING


@pytest.mark.parametrize("speed_mps", [1e-2, 1e-1, -1.0])
@pytest.mark.parametrize("index", [0, 2], ids=["up", "down"])
def test_what_limits_the_chirps_is_migration(index: int, speed_mps: float) -> None:
    segment = frequency_plan(SHORT)[index]
    beamlets = _footprint("flat", 1, speed_mps)
    signed_bin = _signed_bins(SHORT, segment, beamlets)
    error = _error(signed_bin, beamlets.weight, analytic_record(SHORT, segment, beamlets).real, "hann")
    # To first order a phase of π rate x², in the bins around the tone.
    x = (np.arange(4096) - 4095 / 2) / SHORT.sample_rate_hz
    turn = np.pi * 4 * SHORT.chirp_slope_hz_per_s * speed_mps / SPEED_OF_LIGHT_MPS * x**2
    from_bin = signed_bin - np.rint(signed_bin) - np.arange(-REACH, REACH + 1)[:, None]
    window = 0.5 + 0.5 * np.cos(2 * np.pi * x / SHORT.record_time_s)
    line = window * np.exp(2j * np.pi * from_bin * x / SHORT.record_time_s)
    expected = abs((line * turn).sum(axis=1)).max() / abs(line.sum(axis=1)).max()
    assert error == pytest.approx(expected, rel=1e-2, abs=ROUNDING)


@pytest.mark.parametrize("kind", ["flat", "two targets"])
def test_full_length_in_motion(kind: str) -> None:
    """Chirps of the real instrument at 1 m/s: within what migration allows."""
    waveform = Waveform()
    beamlets = _footprint(kind, 19, 1.0)
    for segment, limit in zip(frequency_plan(waveform), (1e-3, ROUNDING, 1e-3), strict=True):
        samples = analytic_record(waveform, segment, beamlets).real
        signed_bin = _signed_bins(waveform, segment, beamlets)
        assert _error(signed_bin, beamlets.weight, samples, "hamming") < limit


def _plain_record(signed_bin: np.ndarray, weight: np.ndarray, length: int) -> np.ndarray:
    n = np.arange(length) - (length - 1) / 2
    samples = np.zeros(length)
    for place, w in zip(signed_bin, weight, strict=True):
        cycles = place / length * n
        samples += (w * np.exp(2j * np.pi * (cycles - np.rint(cycles)))).real
    return samples


@pytest.mark.parametrize("count", [1, 2, 64, 1024])
@pytest.mark.parametrize(
    ("centre", "spread"),
    [
        pytest.param(1000.0, 0.0, id="all on a bin"),
        pytest.param(0.5, 0.0, id="all half a bin from DC"),
        pytest.param(2047.5, 0.0, id="all half a bin from Nyquist"),
        pytest.param(700.3, 3.0, id="one surface"),
        pytest.param(0.4, 3.0, id="through DC"),
        pytest.param(2047.8, 3.0, id="through Nyquist"),
        pytest.param(-1500.2, 40.0, id="steep, folded at DC"),
        pytest.param(3000.7, 40.0, id="steep, folded at Nyquist"),
        pytest.param(-9000.9, 3.0, id="folded twice"),
        pytest.param(0.0, 3000.0, id="everywhere"),
    ],
)
def test_plain_tones(centre: float, spread: float, count: int) -> None:
    rng = np.random.default_rng(count)
    signed_bin = centre + spread * rng.uniform(-1, 1, count)
    weight = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    samples = _plain_record(signed_bin, weight, 4096)
    for window in WINDOW_NAMES:
        assert _error(signed_bin, weight, samples, window) < ROUNDING


@pytest.mark.parametrize("window", WINDOW_NAMES)
def test_surfaces_far_apart(window: str) -> None:
    rng = np.random.default_rng(8)
    signed_bin = np.concatenate(
        [300 + 2 * rng.uniform(-1, 1, 40), -1200 + 15 * rng.uniform(-1, 1, 40), [4000.5]]
    )
    weight = np.concatenate([rng.standard_normal(40), 0.01j * rng.standard_normal(40), [1e-3]])
    assert _error(signed_bin, weight, _plain_record(signed_bin, weight, 4096), window) < ROUNDING
