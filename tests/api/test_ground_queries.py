"""Heights and rays against closed forms on a plane, a slope and a slab, and against the map of a grid."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu import Ground, InputError

SLAB = {"name": "deck", "kind": "slab", "length_m": 100, "width_m": 100, "height_m": 5, "reflectance": 0.7}


def test_heights_of_a_slope() -> None:
    ground = Ground(
        "descent", {"site": {"ground": {"kind": "plane", "slope_deg": 20, "downhill_azimuth_deg": 90}}}
    )
    east_m, north_m = np.meshgrid(np.linspace(-50, 50, 5), [0.0, 7.0, 9.0])
    height_m = ground.height_m(east_m, north_m)
    assert height_m.shape == (3, 5)
    np.testing.assert_allclose(height_m, -np.tan(np.radians(20)) * east_m, atol=1e-12)
    assert ground.height_m(10, 0).shape == ()


def test_rays_on_flat_ground_and_an_object() -> None:
    ground = Ground("descent", {"site": {"ground": {"kind": "plane"}, "objects": [SLAB]}})
    hits = ground.cast([[0, 0, 105], [200, 0, 100], [0, 0, 50]], [[0, 0, -2], [1, 0, -1], [0, 0, 1]])
    np.testing.assert_allclose(hits.range_m, [100, 100 * np.sqrt(2), np.nan], rtol=1e-12)
    np.testing.assert_allclose(hits.point_site_m[:2], [[0, 0, 5], [300, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(hits.incidence_deg[:2], [0, 45], atol=1e-6)
    np.testing.assert_array_equal(hits.object, [1, 0, -1])
    assert hits.reflectance[0] == 0.7
    assert not hits.inside.any()
    one = ground.cast([200, 0, 100], [1, 0, -1])
    assert one.range_m.shape == ()
    np.testing.assert_allclose(one.point_site_m, [300, 0, 0], atol=1e-9)


def test_moving_objects_are_where_they_are() -> None:
    moving = SLAB | {"motion": {"velocity_mps": [10, 0, 0]}}
    ground = Ground("descent", {"site": {"ground": {"kind": "plane"}, "objects": [moving]}})
    for time_s, number in ((0.0, 1), (4.9, 1), (5.1, 0)):
        hits = ground.cast([[0, 0, 100.0]], [[0, 0, -1.0]], time_s)
        assert hits.object[0] == number, time_s


def test_a_ray_straight_down_ends_at_the_height() -> None:
    ground = Ground("descent")
    east_m = np.linspace(-400, 400, 9)
    down = ground.cast(np.stack([east_m, 0 * east_m, 3000 + 0 * east_m], axis=-1), [0, 0, -1])
    np.testing.assert_allclose(3000 - down.range_m, ground.height_m(east_m, 0), atol=1e-6)
    assert "mare" in ground.description or ground.description


@pytest.mark.parametrize("length", [5e-324, 1e-200, 1.0, 1e200, 1e308])
def test_a_direction_may_have_any_length(length: float) -> None:
    ground = Ground("descent", site={"ground": {"kind": "plane"}})
    np.testing.assert_allclose(
        ground.cast([0, 0, 100], [length, 0, -length]).range_m, 100 * np.sqrt(2), rtol=1e-12
    )
    assert ground.cast(np.zeros((0, 3)), [0, 0, -1]).range_m.shape == (0,)


def test_refusals_are_one_line() -> None:
    ground = Ground("descent", site="flat")
    for call, line in (
        (lambda: ground.height_m("here", 0), "height_m: east_m: must be numbers (got 'here')"),
        (
            lambda: ground.height_m([1, 2], [1, 2, 3]),
            "height_m: shape (2,) and shape (3,); pass compatible shapes",
        ),
        (lambda: ground.cast([0, 0], [0, 0]), "cast: shape (2,); pass arrays of shape (..., 3)"),
        (
            lambda: ground.cast([0, 0, 9], [0, 0, 0]),
            "cast: NaN, infinity or a direction of 0; pass finite rays",
        ),
        (lambda: ground.cast([0, 0, 9], [np.nan, 0, -1]), "cast: NaN, infinity or a direction of 0"),
        (lambda: ground.cast([0, np.inf, 9], [0, 0, -1]), "cast: NaN, infinity or a direction of 0"),
        (lambda: Ground("bench"), "bench: a bench pattern has no geometry"),
    ):
        with pytest.raises(InputError) as refused:
            call()
        assert str(refused.value).startswith(line)
