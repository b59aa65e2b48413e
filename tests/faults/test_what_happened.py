"""Shipped scenarios that replay what happened: the effect that their documentation states."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import lidar_emu
from lidar_emu.api import simulate
from lidar_emu.measurement import Measurement


@cache
def flown(name: str, faults: str | None = None) -> Measurement:
    return simulate(lidar_emu.load(f"{name}.yaml", {} if faults is None else {"faults": faults}))


def test_a_true_step_of_the_ground() -> None:
    reported = flown("terrain_step_2023")
    ahead, down = reported.true_range_m[:, 1], reported.true_range_m[:, 0]
    # A beam ahead falls off the edge from one shot to one soon after, the one straight down in twelve seconds.
    assert np.max(ahead[60:] - ahead[:-60]) > 2900
    assert np.max(down[300:] - down[:-300]) > 2300
    assert np.ptp(reported.position_site_m[:, 2]) < 2500
    assert reported.range_valid.mean(axis=0).min() > 0.6
    np.testing.assert_allclose(
        reported.range_m[reported.range_valid], reported.true_range_m[reported.range_valid], atol=30
    )
    good = np.abs(reported.range_m - reported.true_range_m)[reported.range_valid] < 1
    assert good.mean() > 0.95
    # It is no outlier that passes: the ground stays where it is.
    assert np.nanmin(reported.range_m[900:, 0]) > 3500
    assert not lidar_emu.load("terrain_step_2023.yaml").faults


@pytest.mark.parametrize("seconds", [slice(0, 15), slice(30, 45), slice(50, 60)])
def test_noise_that_never_clears(seconds: slice) -> None:
    shots = slice(20 * seconds.start, 20 * seconds.stop)
    reported, sound = flown("noisy_descent_2025"), flown("noisy_descent_2025", "[]")
    error_m = np.abs(reported.range_m - reported.true_range_m)[shots]
    # Of Gaussian errors of 80 m the median is 54 m; near the ground ranges stop at 0.
    assert 40 < np.nanmedian(error_m) < 60
    assert np.nanmedian(np.abs(sound.range_m - sound.true_range_m)[shots]) < 0.1
    assert reported.range_valid[shots].mean() > 0.7
    assert np.nanmean(sound.snr_db[shots]) - np.nanmean(reported.snr_db[shots]) == pytest.approx(6, abs=1.5)
