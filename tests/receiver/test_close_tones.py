"""The quick way to the bins of tones that lie close together, against the general way, which is held to numpy's FFT."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis import laid_intervals

from lidar_emu.numerics.arrays import as_record
from lidar_emu.receiver.beat_tones import relative_turn
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.spectrum import LANES
from lidar_emu.receiver.tone_bins import set_close_tones, set_tones, tones_are_close
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument


def _tones(place: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(4, tones), filled up with tones of no weight."""
    missing = -len(place) % LANES
    place, weight = np.append(place, np.full(missing, place[0])), np.append(weight, np.zeros(missing))
    return np.array([np.rint(place), place - np.rint(place), weight.real, weight.imag], dtype=np.float32)


def _both(place: np.ndarray, weight: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """Complex bins by the quick way and by the general one, and whether the quick one is good enough."""
    tones = _tones(place, weight)
    grid, ends = laid_intervals(tones[0], length)
    columns, count, snr = tones.shape[1], ends[ends[0]], float(np.sum(np.abs(weight) ** 2))
    close = tones_are_close(float(length), grid, count, snr)
    quick, general = np.zeros((2, 2, grid.shape[1]), dtype=np.float32)
    set_tones(tones, columns, float(length), grid, count, general, np.empty((4, grid.shape[1])))
    set_close_tones(tones, columns, float(length), grid, count, quick, np.empty_like(tones[:2]))
    return (quick[0] + 1j * quick[1])[:count], (general[0] + 1j * general[1])[:count], close


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(
    count=st.integers(1, 128),
    centre=st.floats(20, 65_500),
    spread=st.sampled_from([0.0, 1e-12, 0.01, 1.0, 6.0, 3000.0]),
    whole=st.booleans(),
    snr_db=st.floats(0, 100),
    seed=st.integers(0, 2**32 - 1),
)
def test_quick_and_general_way_agree_to_a_share_of_the_noise(
    count: int, centre: float, spread: float, whole: bool, snr_db: float, seed: int
) -> None:
    """To a hundredth of its amplitude wherever the quick way is chosen, and to rounding."""
    rng = np.random.default_rng(seed)
    place = np.clip(centre + spread * rng.uniform(-1, 1, count), 1.0, 65_535.0)
    weight = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    weight *= np.sqrt(10 ** (snr_db / 10) / np.sum(np.abs(weight) ** 2))
    quick, general, close = _both(np.rint(place) if whole else place, weight, 2**17)
    rounding = 4e-7 * np.sum(np.abs(weight)) + 1.1e-6 * np.sqrt(count) * np.abs(weight).max()
    if close:
        assert abs(quick - general).max() < 0.01 + rounding


def test_the_quick_way_is_the_usual_one() -> None:
    """At 35 dB from 100 m on at 10 m/s, and at 60 dB from 1000 bins on."""
    for place, snr_db in ((2800.0, 35.0), (40_000.0, 35.0), (3000.0, 60.0)):
        assert _both(np.array([place]), np.array([10 ** (snr_db / 20)]), 2**17)[2]


@pytest.mark.parametrize(
    ("places", "length"),
    [
        pytest.param([20.0], 2**17, id="near DC"),
        pytest.param([65536 - 20.0], 2**17, id="near Nyquist"),
        pytest.param([0.0], 2**17, id="on DC"),
        pytest.param([65536.0], 2**17, id="on Nyquist"),
        pytest.param([64.0], 256, id="small N"),
        pytest.param([2_000.0, 60_000.0], 2**17, id="far apart"),
    ],
)
def test_what_is_not_close(places: list[float], length: int) -> None:
    assert not _both(np.array(places), 100.0 * np.ones(len(places)), length)[2]


@pytest.mark.parametrize(("segment", "slope_sign"), [(0, 1.0), (1, 0.0), (2, -1.0)])
def test_phase_follows_the_frequency_at_which_the_light_left(segment: int, slope_sign: float) -> None:
    """A delay later than another echo, an up-chirp's light left at a lower frequency: fewer turns in the same way."""
    waveform = Instrument().waveform
    model = as_record(build_receiver(Instrument()))[0]
    ahead_m, ranges_m = 7.0, np.array([500.0, 4000.0])
    turns = [relative_turn(model, segment, 0.3, range_m, ahead_m, 0.02) for range_m in ranges_m]
    slope = slope_sign * waveform.chirp_slope_hz_per_s
    frequency_change_hz = -slope * 2.0 * (ranges_m[1] - ranges_m[0]) / SPEED_OF_LIGHT_MPS
    expected = -2.0 * ahead_m * frequency_change_hz / SPEED_OF_LIGHT_MPS
    assert turns[1] - turns[0] == pytest.approx(expected, rel=1e-9, abs=1e-12)
