"""The measurement as a user has it: arrays of shots by beams, and tables."""

from __future__ import annotations

import numpy as np
import pytest

import lidar_emu
from lidar_emu.measurement import Measurement
from lidar_emu.receiver.returns import Reason

FLOATS = (
    "time_s",
    "range_m",
    "closing_speed_mps",
    "snr_db",
    "true_range_m",
    "true_closing_speed_mps",
    "true_incidence_deg",
    "beam_angle_deg",
)


@pytest.fixture(scope="module")
def run() -> Measurement:
    return lidar_emu.simulate(lidar_emu.load("descent.yaml"), seed=1)


@pytest.fixture(scope="module")
def partly_fired() -> Measurement:
    """Four beams, of which one is left from 1 s on."""
    switch = "[{kind: time, at_s: 1, pattern: {kind: ring, count: 1, angle_deg: 0}}]"
    return lidar_emu.simulate(lidar_emu.load("descent", {"scanner.switches": switch, "duration_s": "2"}))


def test_nothing_is_nan_and_no_number_in_its_place(partly_fired: Measurement) -> None:
    silent = ~partly_fired.fired
    expected = np.zeros((40, 4), dtype=bool)
    expected[20:, 1:] = True
    np.testing.assert_array_equal(silent, expected)
    for name in FLOATS:
        values = getattr(partly_fired, name)
        assert np.isnan(values[silent]).all(), name
        assert np.isfinite(values[partly_fired.range_valid]).all(), name
    assert not partly_fired.range_valid[silent].any()
    assert not partly_fired.speed_valid[silent].any()
    assert set(partly_fired.reason[silent]) == {Reason.NOT_FIRED}


def test_the_table_has_a_row_per_shot_and_beam(run: Measurement) -> None:
    table = run.table()
    assert {column.shape for column in table.values()} == {(4 * 1008,)}
    for row in (0, 5, 4031):
        shot, beam = int(table["shot"][row]), int(table["beam"][row])
        assert (shot, beam) == divmod(row, 4)
        for name in (*FLOATS, "reason", "range_valid"):
            np.testing.assert_equal(table[name][row], getattr(run, name)[shot, beam], name)
        point_m = [table[f"point_{axis}_m"][row] for axis in ("east", "north", "up")]
        np.testing.assert_array_equal(point_m, run.point_site_m[shot, beam])
