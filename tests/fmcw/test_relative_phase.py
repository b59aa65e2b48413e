"""Phases between the echoes of two beamlets, from the optical frequency of the light that returns."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.fmcw.beat_tones import relative_turn
from lidar_emu.fmcw.receiver_constants import build_receiver
from lidar_emu.numerics.arrays import as_record
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument


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
