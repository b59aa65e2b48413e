"""The powered descent of Apollo 11, as displayed on board: uneven rows and gaps."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
from twins import APOLLO

from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_whole


def test_flies_as_it_is_and_states_where_it_knows_nothing(public_data: Path) -> None:
    file = public_data / APOLLO
    given = {
        "kind": "table",
        "file": str(file),
        "time": {"column": "t_touchdown_s", "unit": "s"},
        "up": {"column": "alt_m", "unit": "m", "rate_column": "hdot_mps", "rate_unit": "m/s"},
        "to_time": 0,
        "longer_gaps": "bridge",
    }
    scenario = load(
        "descent.yaml", {"trajectory": json.dumps(given), "timing.rate_hz": "1", "level": "geometric"}
    )
    model = build_model(scenario)
    run = measure_whole(model)
    with file.open() as stream:
        time = np.array([float(row["t_touchdown_s"]) for row in csv.DictReader(stream)])
    before = np.searchsorted(time, run.time_s[:, 0] + time[0], side="right") - 1
    expected = np.diff(time)[before] > 10
    np.testing.assert_array_equal(run.true_in_gap[:, 0], expected)
    assert len(run) == 755
    assert run.true_in_gap[:, 0].sum() == 322
    reported = [d for d in model.plan.decisions if d.stage == "gap"]
    assert [d.how for d in reported][-1] == "bridged from 564.0 s to 596.0 s"
    assert len(reported) == np.count_nonzero(np.diff(time) > 10) == 9
    assert run.table()["true_in_gap"].sum() == 4 * expected.sum()
