"""Grids within grids against the slow path, brute force along each ray, and cases known by hand."""

import numpy as np
import pytest
from exact_casting import cast_exact

from lidar_emu.errors import InputError
from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene
from lidar_emu.scene.analytic_grounds import PlaneGround
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.mosaic import nested as seam
from lidar_emu.scene.mosaic.nested import extent


def hills_m(east_m, north_m):
    return 9 * np.sin(east_m / 31) * np.cos(north_m / 23) + 0.8 * np.sin(east_m / 4) * np.sin(north_m / 5)


def samples(west_m, south_m, pixel_m, columns, rows, offset_m=0.0, rng=None):
    east, north = west_m + pixel_m * np.arange(columns), south_m + pixel_m * np.arange(rows)
    height = hills_m(*np.meshgrid(east, north)) + offset_m
    if rng is not None:
        height += rng.normal(0, 0.2, height.shape)
    return Samples(height, west_m, south_m, pixel_m, pixel_m)


def nest(samples, outer, feather_m, name):
    return seam.nest(samples, extent(samples), outer, feather_m, lambda s: GridGround(s, None, name, 0.0))


def three_deep(rng):
    """Pixels of 8, 2.5 and 0.7 m, whose edges fall together nowhere; the middle one has holes, and lies too high."""
    widest = GridGround(samples(-160, -160, 8.0, 41, 41), PlaneGround(0.0, 0.0, 0.0), "widest", 0.0)
    middle = samples(-71.3, -63.1, 2.5, 50, 47, 1.5, rng)
    middle.height_m[10:14, 20:23] = np.nan
    middle.height_m[:9, :5] = np.nan
    wide = nest(middle, widest, 20.0, "middle")
    return nest(samples(-20.7, -11.9, 0.7, 70, 61, 0.3, rng), wide, 5.0, "finest")


def rays(rng, count, reach_m=200.0):
    origin = rng.uniform([-reach_m, -reach_m, -15], [reach_m, reach_m, 120], (count, 3))
    direction = rng.normal(size=(count, 3)) * [1, 1, 0.5]
    direction[:, 2] = np.where(rng.random(count) < 0.8, -np.abs(direction[:, 2]), direction[:, 2])
    for axis in range(3):
        direction[rng.random(count) < 0.05, axis] = 0.0
    direction[np.all(direction == 0, axis=1)] = [0, 0, -1]
    return origin, direction / np.linalg.norm(direction, axis=1)[:, None]


def same(found, expected, atol=1e-9):
    np.testing.assert_array_equal(found.inside, expected.inside)
    np.testing.assert_allclose(found.range_m, expected.range_m, rtol=0, atol=atol)


@pytest.mark.slow
def test_equals_the_slow_path():
    rng = np.random.default_rng(1)
    ground = three_deep(rng)
    origin, direction = rays(rng, 400)
    exact = cast_exact(ground, origin, direction)
    same(ground.cast(origin, direction), exact)
    assert exact.inside.sum() > 20
    assert np.isfinite(exact.range_m).sum() > 150


@pytest.mark.parametrize("aim", ["at the seam", "along the seam", "through a corner"])
def test_no_ray_to_a_seam_is_lost(aim):
    rng = np.random.default_rng(3)
    ground = three_deep(rng)
    west, east, south, north = ground.rectangle
    count = 20_000
    x, y = rng.uniform(west, east, count), rng.uniform(south, north, count)
    side = rng.integers(0, 4, count)
    x = np.select([side == 0, side == 1], [west, east], x)
    y = np.select([side == 2, side == 3], [south, north], y)
    if aim == "through a corner":
        x, y = rng.choice([west, east], count), rng.choice([south, north], count)
    target = np.stack([x, y, ground.height_m(x, y)], 1)
    back = rng.normal(size=(count, 3)) * [1, 1, 0] + [0, 0, 3]
    if aim == "along the seam":
        back[side < 2, 0] = 0.0
        back[side >= 2, 1] = 0.0
    back /= np.linalg.norm(back, axis=1)[:, None]
    distance = rng.uniform(40, 400, count)
    found = ground.cast(target + distance[:, None] * back, -back)
    # The steepest rays only: elsewhere a hill may stand before the target.
    np.testing.assert_array_equal(np.isfinite(found.range_m), True)
    plain = back[:, 2] > 0.95
    assert plain.sum() > 1000
    # The target is a point of the inner ground; the outer one's, at most the step above it, may be met first.
    assert np.abs(found.range_m - distance)[plain].max() < 1e-9 + 1.1 * ground._lift_m


def test_datum_offset_is_reported_and_no_cliff_is_left():
    ground = three_deep(np.random.default_rng(4))
    seam = ground.outer.seam
    assert seam.offset_m == pytest.approx(1.5, abs=0.2)
    assert 0 < seam.step_m < 0.15
    # Across the seam of the middle grid the height changes no more than at the reported step.
    middle = ground.outer
    north = np.linspace(middle.rectangle.south_m, middle.rectangle.north_m, 3001)
    for edge in middle.rectangle[:2]:
        before, after = (middle.height_m(np.full(3001, edge + d), north) for d in (-1e-7, 1e-7))
        assert np.abs(before - after).max() <= seam.step_m + 1e-6


def test_holes_are_filled_by_the_ground_around():
    wide = GridGround(samples(-40, -40, 4.0, 21, 21), None, "wide", 0.0)
    fine = samples(-10, -10, 1.0, 21, 21, 5.0)
    fine.height_m[8:13, 8:13] = np.nan
    ground = nest(fine, wide, 3.0, "fine")
    at = np.array([0.0])
    assert ground.height_m(at, at)[0] == wide.height_m(at, at)[0]
    assert ground.height_m(at + 6, at)[0] == pytest.approx(hills_m(6.0, 0.0) + 5.0)


def test_finer_ground_may_reach_past_the_wider_one():
    wide = GridGround(samples(-40, -40, 4.0, 21, 21), None, "wide", 0.0)
    ground = nest(samples(20, -10, 1.0, 41, 21), wide, 3.0, "fine")
    east, north = np.array([30.0, 50.0, 70.0]), np.zeros(3)
    assert np.isfinite(ground.height_m(east, north)).tolist() == [True, True, False]
    np.testing.assert_array_equal(ground.covers(east, north), [True, True, False])
    down = np.tile([0.0, 0.0, -1.0], (3, 1))
    hits = ground.cast(np.stack([east, north, np.full(3, 60.0)], 1), down)
    assert np.isfinite(hits.range_m).tolist() == [True, True, False]
    assert not hits.inside.any()


def test_absent_beams_hit_nothing():
    ground = three_deep(np.random.default_rng(5))
    origin, direction = np.array([[0.0, 0, 80], [0, 0, 80]]), np.array([[0.0, 0, -1], [np.nan] * 3])
    hits = ground.cast(origin, direction)
    assert np.isfinite(hits.range_m).tolist() == [True, False]
    assert np.isnan(ground.cast(origin[1:], direction[1:]).normal_site).all()


def test_a_map_that_does_not_reach_the_site_is_refused(tmp_path):
    rasterio = pytest.importorskip("rasterio", reason="the extra geo is not installed")
    moon = "+proj=ortho +lat_0=27 +lon_0=-52 +R=1737400 +units=m +no_defs"
    for name, east_m, pixel_m in (("fine.tif", 0.0, 5.0), ("wide.tif", 90_000.0, 50.0)):
        place = rasterio.Affine(pixel_m, 0, east_m - 50 * pixel_m, 0, -pixel_m, 50 * pixel_m)
        shape = {"height": 100, "width": 100, "count": 1, "dtype": "float32", "transform": place}
        with rasterio.open(tmp_path / name, "w", driver="GTiff", crs=moon, **shape) as file:
            file.write(np.zeros((100, 100), dtype=np.float32), 1)
    grids = [{"kind": "grid", "file": str(tmp_path / name)} for name in ("fine.tif", "wide.tif")]
    with pytest.raises(
        InputError, match=r"wide\.tif: ground.origin: latitude 27, longitude -52, off the grid"
    ):
        build_scene(Site.model_validate({"ground": {"kind": "nested", "grids": grids}}))
