"""Over the shipped ground the statistical level loses as much, and errs as much, as the spectral one.

Both fly the same draws with the same seeds, each with receivers' chance of its own. For every band of altitude and of
incidence with a thousand beams, dropouts and quantiles of the errors of the two are compared with the intervals that
each level's own runs give; about a hundred comparisons at 4.4 sigma are wrong once in a thousand times.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_campaign import Here

from lidar_emu.campaign.read import prepare
from lidar_emu.campaign.run import fly_campaign
from lidar_emu.campaign.statistics import ERRORS, campaign_statistics
from lidar_emu.scenario.parts import ChangedKey

RUNS = 50
LEAST_BEAMS = 1000
SIGMA = 4.4


def apart(one, other):
    """How far two estimates are apart, in standard errors; of 95 % intervals with Student's 49 degrees of freedom."""
    width = np.hypot(one.high - one.low, other.high - other.low) / (2 * 2.01)
    return abs(one.value - other.value) / width


@pytest.mark.slow
def test_dropouts_and_errors_agree(tmp_path):
    bands = {}
    for level in ("statistical", "spectral"):
        prepared = prepare(Path("dispersed_descent.yaml"), [ChangedKey("level", level, "test")], RUNS)
        fly_campaign(prepared, 4032, tmp_path / level, Here, lambda _: None)
        reported = campaign_statistics(tmp_path / level)
        bands[level] = {(band.axis, band.low): band for band in reported if band.expected >= LEAST_BEAMS}
    assert bands["statistical"].keys() == bands["spectral"].keys()
    assert len(bands["spectral"]) >= 15
    for key, spectral in bands["spectral"].items():
        statistical = bands["statistical"][key]
        assert apart(statistical.dropout, spectral.dropout) < SIGMA, key
        for error in ERRORS:
            for one, other in zip(
                statistical.quantiles[error.name], spectral.quantiles[error.name], strict=True
            ):
                assert apart(one, other) < SIGMA, (key, error.name, one, other)
