"""The bench pattern reports its settings."""

from __future__ import annotations

import numpy as np

from lidar_emu.api import simulate
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.load import load


def test_constants_ramps_and_an_invalid_beam():
    run = simulate(load("bench.yaml"))
    time_s = 0.1 * np.arange(200)
    assert run.range_m.shape == (200, 4)
    np.testing.assert_array_equal(run.range_m[:, 0], 1000)
    np.testing.assert_allclose(run.range_m[:, 1], 200 * np.mod(time_s + 1e-12, 10), atol=1e-6)
    np.testing.assert_allclose(run.closing_speed_mps[:, 1], -100 + 20 * np.mod(time_s + 1e-12, 10), atol=1e-6)
    np.testing.assert_array_equal(run.closing_speed_mps[:, 2], -7.8901)
    assert np.isnan(run.range_m[:, 3]).all()
    assert (run.reason[:, 3] == Reason.NO_SURFACE).all()
    assert not run.range_valid[:, 3].any()
    assert run.range_valid[:, :3].all()


def test_a_ramp_starts_anew_with_the_shot_that_its_period_starts_with():
    scenario = load("bench.yaml", {
        "timing.rate_hz": "20",
        "bench_pattern.beams.0.range_m": "{start: 0, stop: 100, period_s: 0.1}",
    })  # fmt: skip
    run = simulate(scenario)
    np.testing.assert_array_equal(run.range_m[:, 0], np.tile([0.0, 50.0], 200))
