"""The measurement as a user has it: arrays of shots by beams, and tables."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import pytest

import lidar_emu
from lidar_emu.fmcw.returns import Reason
from lidar_emu.measurement import Measurement

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
TABLE = {
    "shot", "beam", "time_s", "fired", "beam_angle_deg", "range_m", "closing_speed_mps", "range_valid", "speed_valid",
    "sign_resolved", "reason", "segments", "snr_db", "residual_mps", "sigma_range_m", "sigma_speed_mps", "returns",
    "second_range_m", "true_range_m", "true_closing_speed_mps", "true_incidence_deg",
    "true_in_gap", "true_peak_source", "true_object", "point_east_m", "point_north_m", "point_up_m",
    "true_point_east_m", "true_point_north_m", "true_point_up_m",
    "true_sensor_east_m", "true_sensor_north_m", "true_sensor_up_m",
    "position_east_m", "position_north_m", "position_up_m",
    "velocity_east_mps", "velocity_north_mps", "velocity_up_mps",
    "acceleration_east_mps2", "acceleration_north_mps2", "acceleration_up_mps2",
    "site_from_body_w", "site_from_body_x", "site_from_body_y", "site_from_body_z",
    "body_rate_x_radps", "body_rate_y_radps", "body_rate_z_radps",
}  # fmt: skip


@pytest.fixture(scope="module")
def run() -> Measurement:
    return lidar_emu.simulate(lidar_emu.load("descent.yaml"), seed=1)


@pytest.fixture(scope="module")
def partly_fired() -> Measurement:
    """Four beams, of which one is left from 1 s on."""
    switch = "[{kind: time, at_s: 1, pattern: {kind: ring, count: 1, angle_deg: 0}}]"
    return lidar_emu.simulate(lidar_emu.load("descent", {"scanner.switches": switch, "duration_s": "2"}))


def test_arrays_are_shots_by_beams(run: Measurement) -> None:
    for name in FLOATS:
        values = getattr(run, name)
        assert (values.shape, values.dtype) == ((1008, 4), np.float64), name
    for name in ("range_valid", "speed_valid", "fired", "sign_resolved"):
        values = getattr(run, name)
        assert (values.shape, values.dtype) == ((1008, 4), np.bool_), name
    assert run.reason.shape == (1008, 4)
    assert issubclass(Reason, IntEnum)
    # Echoes fade.
    assert {Reason(code) for code in run.reason.ravel().tolist()} == {Reason.VALID, Reason.BELOW_THRESHOLD}
    np.testing.assert_array_equal(run.reason == Reason.VALID, run.range_valid)
    assert run.range_valid.mean() > 0.95
    np.testing.assert_array_equal(run.shot, np.arange(1008))
    assert len(run) == 1008


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
    assert set(table) == TABLE
    assert {column.shape for column in table.values()} == {(4 * 1008,)}
    for row in (0, 5, 4031):
        shot, beam = int(table["shot"][row]), int(table["beam"][row])
        assert (shot, beam) == divmod(row, 4)
        for name in (*FLOATS, "reason", "range_valid"):
            np.testing.assert_equal(table[name][row], getattr(run, name)[shot, beam], name)
        point_m = [table[f"point_{axis}_m"][row] for axis in ("east", "north", "up")]
        np.testing.assert_array_equal(point_m, run.point_site_m[shot, beam])


def test_the_seed_decides_and_nothing_else(run: Measurement) -> None:
    scenario = lidar_emu.load("descent.yaml")
    again = lidar_emu.simulate(scenario, seed=1)
    np.testing.assert_array_equal(again.range_m, run.range_m)
    np.testing.assert_array_equal(again.snr_db, run.snr_db)
    np.testing.assert_array_equal(lidar_emu.simulate(scenario).snr_db, run.snr_db)  # seed: 1 in the file
    other = lidar_emu.simulate(scenario, seed=2)
    assert (other.snr_db != run.snr_db).mean() > 0.99
    np.testing.assert_array_equal(other.true_range_m, run.true_range_m)
