"""What stands out of a cloud of points, against scenes that were built to order and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.errors import InputError
from lidar_emu.report.hazards import LEAST_POINTS, OUTER_M, SIGMAS, Cloud, cloud_of
from lidar_emu.scenario.load import load, require_flight
from lidar_emu.shots.flight_model import FlightModel

pytestmark = pytest.mark.slow

FLAT = {"site": "flat", "instrument": "ndl_as_published"}
RANGE_BIN_M = 0.343085
TRACK = np.sqrt(0.5)


def cloud(**overrides: str) -> Cloud:
    return cloud_of(FlightModel(require_flight(load("hazards", {**FLAT, **overrides}))))


def test_level_ground_has_nothing_that_stands_out() -> None:
    seen = cloud()
    assert not seen.stands_out.any()
    # Two bins, along a beam at 22.5 degrees; a plane through at least LEAST_POINTS others adds a little.
    own_m = RANGE_BIN_M / np.sqrt(6) * np.cos(np.radians(22.5))
    assert (seen.sigma_m > own_m * (1 - 1e-5)).all()
    assert np.median(seen.sigma_m) < own_m * np.sqrt(1 + 1 / LEAST_POINTS)


@pytest.mark.parametrize(("height_m", "reported"), [(1.2, True), (0.2, False)])
def test_slab_in_a_track_stands_out_if_it_is_high_enough(height_m: float, reported: bool) -> None:
    # Two metres of the track of the first beam, which runs to the north-east, 60 m out: 145 m up.
    place = 60 * TRACK
    slab = f"{{kind: slab, name: block, east_m: {place}, north_m: {place}, yaw_deg: 45, length_m: 2, width_m: 2, "
    seen = cloud(**{"site.objects": f"[{slab}height_m: {height_m}}}]"})
    from_middle_m = seen.seen_m[seen.own, :2] - place
    aside_m = np.abs(TRACK * (from_middle_m @ np.array([[1, -1], [1, 1]]))).max(axis=1)
    on_top = aside_m < 0.8  # 0.2 m from its edges: no point on a side, and none that noise moves there
    assert on_top.sum() >= 3
    assert (np.abs(seen.off_m - height_m) < 0.35 * height_m + SIGMAS * seen.sigma_m)[on_top].all()
    assert seen.stands_out[on_top].all() == reported
    assert not seen.stands_out[aside_m > 1 + OUTER_M].any()  # without the slab in their rings


def test_errors_of_a_point_and_its_plane_are_as_large_as_foretold() -> None:
    seen = cloud(**{"timing.rate_hz": "97"})
    error = seen.off_m / seen.sigma_m  # of level ground
    assert np.abs(error).max() < SIGMAS
    assert error.std() == pytest.approx(1.0, rel=0.1)


def test_flight_without_surroundings_is_refused() -> None:
    with pytest.raises(InputError, match="without neighbouring points"):
        cloud(**{"timing.rate_hz": "0.1"})
