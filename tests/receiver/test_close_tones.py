"""The quick way to the bins of tones that lie close together, against numpy's FFT and against the general way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthesis import laid_grid

from lidar_emu.numerics.arrays import as_record
from lidar_emu.receiver.beat_tones import relative_turn
from lidar_emu.receiver.close_tones import TONES_PER_DIVISION, are_close, set_close_tones
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.spectrum import BIN, set_tones
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument


def _tones(place: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(4, tones), filled up with tones of no weight."""
    missing = -len(place) % TONES_PER_DIVISION
    place, weight = np.append(place, np.full(missing, place[0])), np.append(weight, np.zeros(missing))
    return np.array([np.rint(place), place - np.rint(place), weight.real, weight.imag])


def _both(place: np.ndarray, weight: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bin numbers, and complex bins by the quick way and by the general one."""
    tones = _tones(place, weight)
    grid = laid_grid(tones[0], length)
    columns = grid.shape[1]
    assert are_close(float(length), grid, columns)
    quick, general = np.empty((2, columns)), np.empty((2, columns))
    set_close_tones(tones, float(length), grid, columns, quick, np.empty((2, tones.shape[1])))
    set_tones(tones, float(length), grid, columns, general)
    return grid[BIN].astype(int), quick[0] + 1j * quick[1], general[0] + 1j * general[1]


@settings(max_examples=150, deadline=None)
@given(
    count=st.integers(1, 128),
    centre=st.floats(3000, 62_000),
    spread=st.sampled_from([0.0, 1e-12, 0.01, 1.0, 6.0]),
    whole=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_quick_and_general_way_agree(
    count: int, centre: float, spread: float, whole: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    place = centre + spread * rng.uniform(-1, 1, count)
    weight = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    _, quick, general = _both(np.rint(place) if whole else place, weight, 2**17)
    # Tones may cancel: rounding is relative to their own sizes.
    assert abs(quick - general).max() < 1e-11 * max(abs(general).max(), 0.1 * np.sqrt(count))


@pytest.mark.parametrize(
    ("places", "length"),
    [
        pytest.param([100.0], 2**17, id="near DC"),
        pytest.param([65536 - 100.0], 2**17, id="near Nyquist"),
        pytest.param([0.0], 2**17, id="on DC"),
        pytest.param([65536.0], 2**17, id="on Nyquist"),
        pytest.param([64.0], 256, id="small N"),
        pytest.param([20_000.0, 30_000.0], 2**17, id="far apart"),
    ],
)
def test_what_is_not_close(places: list[float], length: int) -> None:
    tones = _tones(np.array(places), np.ones(len(places)))
    grid = laid_grid(tones[0], length)
    assert not are_close(float(length), grid, grid.shape[1])


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
