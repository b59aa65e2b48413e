"""The uncertainty sheet is that of the receiver's shots: a short form of the tables of docs/evidence/uncertainty.md."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.uncertainty import CASES, shots_again, without_false_locks
from lidar_emu.plan.uncertainty import COVERAGE

SHOTS, TOLERANCE = 20_000, 0.05
"""The half-width of 95 % of so many shots, where it is widest, has a standard error of 1.4 %."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["near: `descent`, `ndl_fine`", "far: `descent`"])
def test_half_widths_are_those_of_shots(name: str) -> None:
    sheet, errors, valid = shots_again(CASES[name], SHOTS)
    assert sheet.detected == pytest.approx(valid, abs=0.01)
    for error, stated in zip(errors, (sheet.range_error_m, sheet.speed_error_mps), strict=True):
        right = without_false_locks(error, stated)
        assert right.size > 0.999 * error.size
        found = np.quantile(np.abs(right), COVERAGE)
        assert (stated.half_width_68, stated.half_width_95) == pytest.approx(tuple(found), rel=TOLERANCE)
        assert abs(right.mean()) < 0.2 * stated.half_width_68
