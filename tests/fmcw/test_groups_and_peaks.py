"""Groups against a slow reading of their definition, and the three-bin peak against its closed form."""

from __future__ import annotations

from itertools import groupby
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.fmcw.detect import MAX_GROUPS, find_groups, hann_peak
from lidar_emu.fmcw.spectrum import BINS_PER_TONE, REACH, ROWS, lay_bins, mirror_ends, set_tones


def _slow_groups(power: list[float], threshold: float, share: float) -> list[int]:
    floor = share * max(power)
    runs = [list(run) for above, run in groupby(range(len(power)), lambda j: power[j] > floor) if above]
    peaks = [max(run, key=lambda j: power[j]) for run in runs]
    strong = [j for j in peaks if power[j] > threshold]
    return sorted(strong, key=lambda j: -power[j])[:MAX_GROUPS]


@settings(deadline=None)
@given(
    power=st.lists(st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 8.5, 30.0]), max_size=40),
    threshold=st.sampled_from([0.7, 2.0, 7.0, 40.0]),
    share=st.sampled_from([0.01, 0.09, 0.3]),
)
def test_groups(power: list[float], threshold: float, share: float) -> None:
    power = [*power, 0.0]
    peaks = np.zeros(MAX_GROUPS, dtype=np.int64)
    count = find_groups(np.array(power), threshold, share, peaks)
    assert peaks[:count].tolist() == _slow_groups(power, threshold, share)


@pytest.mark.parametrize("rest", [-0.5, -0.3, -1e-9, 0.0, 0.2, 0.499, 0.5])
@pytest.mark.parametrize("phase", [0.0, 1.0, 4.0])
def test_three_bins_find_a_clean_tone(rest: float, phase: float) -> None:
    length = 2.0**17
    spectrum = np.zeros((ROWS, BINS_PER_TONE))
    tones = np.array([[26042.0], [rest], [10 * cos(phase)], [10 * sin(phase)]])
    count = lay_bins(tones[0], length, np.empty(1), spectrum)
    set_tones(tones, length, spectrum, count)
    mirror_ends(length, spectrum, count)
    offset, variance = hann_peak(spectrum, REACH, cos(pi / length), sin(pi / length))
    assert offset == pytest.approx(rest, abs=1e-8)
    assert variance == pytest.approx(0.49 / 100, rel=1e-6)
