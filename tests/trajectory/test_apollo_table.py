"""The powered descent of Apollo 11, as displayed on board: uneven rows, gaps, an attitude of its own."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twins import APOLLO

from lidar_emu.errors import InputError
from lidar_emu.scenario.load import load
from lidar_emu.scenario.trajectory import Table
from lidar_emu.shots.model import build_model, measure_whole
from lidar_emu.trajectory.build import build_trajectory

FROM_S, TO_S = -245.0, -11.0


@pytest.fixture
def file(public_data: Path) -> Path:
    return public_data / APOLLO


def descent(file: Path, **keys: Any) -> Table:
    given = {
        "kind": "table",
        "file": str(file),
        "time": {"column": "t_touchdown_s", "unit": "s"},
        "up": {"column": "alt_m", "unit": "m", "rate_column": "hdot_mps", "rate_unit": "m/s"},
        "pitch": {"column": "pitch_from_vertical_deg", "unit": "deg"},
        "from_time": FROM_S,
        "to_time": TO_S,
        "maximum_gap_s": 40.0,
        **keys,
    }
    return Table.model_validate(given)


def test_states_its_gap_and_refuses_it_where_shorter_ones_are_asked_for(file: Path) -> None:
    longest = build_trajectory(descent(file)).gaps[0]
    assert (longest.start_s, longest.length_s) == (-191 - FROM_S, 32)
    with pytest.raises(InputError, match=r"32 s after -191.*maximum_gap_s above 10"):
        build_trajectory(descent(file, maximum_gap_s=10.0))


def test_flies_as_it_is_and_states_where_it_knows_nothing(file: Path) -> None:
    given = {
        **descent(file, maximum_gap_s=10.0).model_dump(mode="json"), "from_time": None, "to_time": 0, "pitch": None,
        "longer_gaps": "bridge",
    }  # fmt: skip
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
