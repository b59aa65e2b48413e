"""A measurement of which only some beams fire: blank where none fires, unchanged elsewhere, and the truth untouched."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from lidar_emu.measurement import Measurement
from lidar_emu.receiver.returns import Reason

SHOTS, BEAMS = 5, 4
KEPT = {
    *("shot", "due_ns", "position_site_m", "velocity_site_mps", "acceleration_site_mps2", "site_from_body"),
    *("body_rate_radps", "time_ns", "pattern"),
}
"""Columns of the shot, and times, which a beam has whether or not it fires."""


@pytest.fixture
def measured() -> Measurement:
    """Every value different from what stands for none."""
    shape = (SHOTS, BEAMS)
    blank = Measurement.with_columns(
        np.zeros(SHOTS, dtype=np.int64), np.zeros(shape, dtype=np.int64), np.zeros(SHOTS, dtype=np.int64)
    )
    columns = {}
    for field in fields(Measurement):
        like = getattr(blank, field.name)
        values = np.arange(like.size).reshape(like.shape) % 100 + 3
        columns[field.name] = np.ones_like(like) if like.dtype == np.bool_ else values.astype(like.dtype)
    columns["reason"][:] = Reason.VALID
    return Measurement(**columns)


@pytest.mark.parametrize("one_for_all", [False, True])
def test_beams_that_do_not_fire_measure_nothing(measured: Measurement, one_for_all: bool) -> None:
    fires = np.random.default_rng(1).random((1 if one_for_all else SHOTS, BEAMS)) < 0.5
    assert fires.any()
    assert not fires.all()
    left = measured.firing_only(fires)
    where = np.broadcast_to(fires, (SHOTS, BEAMS))
    for field in fields(Measurement):
        before, after = getattr(measured, field.name), getattr(left, field.name)
        assert (after.dtype, after.shape) == (before.dtype, before.shape), field.name
        if field.name in KEPT or field.name.startswith("true_"):
            np.testing.assert_array_equal(after, before, field.name)
            continue
        np.testing.assert_array_equal(after[where], before[where], field.name)
        none = (
            Reason.NOT_FIRED if field.name.endswith("reason") else np.nan if after.dtype == np.float64 else 0
        )
        np.testing.assert_array_equal(after[~where], np.full_like(after[~where], none), field.name)


def test_the_table_has_no_point_of_a_beam_that_does_not_fire(measured: Measurement) -> None:
    table = measured.firing_only(np.array([[True, False, True, False]])).table()
    for name in ("point_east_m", "point_north_m", "point_up_m", "range_m", "time_s"):
        np.testing.assert_array_equal(np.isnan(table[name]), np.tile([False, True], SHOTS * 2), name)
