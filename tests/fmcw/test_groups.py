"""Groups against a slow reading of their definition."""

from __future__ import annotations

from itertools import groupby

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.fmcw.detection import find_groups
from lidar_emu.fmcw.workspace import MAX_TARGETS


def _slow_groups(power: list[float], noise: list[float], threshold: float, floor: float) -> list[int]:
    runs = [list(run) for above, run in groupby(range(len(power)), lambda j: power[j] > floor) if above]
    peaks = [max(run, key=lambda j: power[j]) for run in runs]
    strong = [j for j in peaks if power[j] / noise[j] > threshold]
    return sorted(strong, key=lambda j: -power[j])[:MAX_TARGETS]


@settings(deadline=None)
@given(
    bins=st.lists(
        st.tuples(
            st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 8.5, 30.0]),
            st.sampled_from([0.5, 1.0, 1.0, 2.0]),
        ),
        max_size=40,
    ),
    threshold=st.sampled_from([0.7, 2.0, 7.0, 40.0]),
    floor=st.sampled_from([0.1, 0.9, 2.5, 7.9]),
)
def test_groups(bins: list[tuple[float, float]], threshold: float, floor: float) -> None:
    power, noise = (list(row) for row in zip(*bins, (0.0, 1.0), strict=True))
    peaks = np.zeros(MAX_TARGETS, dtype=np.int64)
    count = find_groups(np.array(power), np.array(noise), threshold, floor, peaks)
    assert peaks[:count].tolist() == _slow_groups(power, noise, threshold, floor)
