"""Bins beside a tone at the statistical level, against the transform of numpy's windows."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.fmcw.receiver_constants import build_receiver
from lidar_emu.fmcw.statistical_model import window_gain
from lidar_emu.numerics.records import as_record
from lidar_emu.scenario.instrument import Detection, Instrument

LENGTH = 4096
WINDOWS = {
    "rect": np.ones(LENGTH),
    "hann": np.hanning(LENGTH + 1)[:-1],
    "hamming": np.hamming(LENGTH + 1)[:-1],
}


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("offset", [0.1, -0.25, 0.5, -0.5])
def test_gain_between_bins_is_that_of_the_window(window: str, offset: float) -> None:
    model = as_record(build_receiver(Instrument(detection=Detection(window=window))))[0]
    tone = np.exp(2j * np.pi * offset * np.arange(LENGTH) / LENGTH)
    expected = abs(np.sum(WINDOWS[window] * tone)) / np.sum(WINDOWS[window])
    assert window_gain(model, offset) / window_gain(model, 0.0) == pytest.approx(expected, rel=1e-4)
