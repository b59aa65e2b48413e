"""The instrument with a flight unit's imperfections, beside the figures that NASA states: 2 m and 2 cm/s."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_whole

BEAMS_MRAD = "[[0.02, 0.0], [-0.02, 0.01], [0.0, -0.02], [0.01, 0.02]]"
"""Drifts of 23 µrad, as by 1 K across an aluminium mount as long as deep."""


@pytest.mark.parametrize("seed", ["1", "2"])
def test_the_descent_is_within_nasa_s_figures(seed: str) -> None:
    keys = {"instrument": "ndl_as_flown", "seed": seed, "scanner.misalignment_mrad": BEAMS_MRAD}
    run = measure_whole(build_model(load("descent", keys)))
    valid = run.range_valid
    assert valid.mean() > 0.9
    assert np.mean(np.abs(run.range_m - run.true_range_m)[valid] < 2.0) > 0.98
    assert np.mean(np.abs(run.closing_speed_mps - run.true_closing_speed_mps)[valid] < 0.02) > 0.999


def test_its_ranges_scatter_more_than_those_of_ndl_fine() -> None:
    spread = []
    for instrument in ("ndl_fine", "ndl_as_flown"):
        run = measure_whole(build_model(load("descent", {"instrument": instrument})))
        error_m = run.range_m - run.true_range_m
        spread.append(np.nanmedian(np.abs(error_m - np.nanmedian(error_m))))
    assert spread[1] > 1.5 * spread[0]
