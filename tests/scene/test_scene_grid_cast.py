"""The caster of elevation grids against the slow path, scipy's interpolation, and cases known by hand."""

import numpy as np
import pytest
from exact_casting import cast_exact
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround

BEYOND = {"none": None, "plane": PlaneGround(0.0, 0.0, 0.0), "sphere": SphereGround(5000.0, 0.0)}
INTERPOLATIONS = ("bilinear", "triangles")
DOWN = np.array([0.0, 0.0, -1.0])


def ground(
    height_m,
    pixel_m=1.0,
    beyond="none",
    west_m=0.0,
    south_m=0.0,
    pixel_north_m=None,
    interpolation="bilinear",
):
    pixels_m = pixel_m, pixel_north_m or pixel_m
    samples = Samples(np.asarray(height_m, dtype=float), west_m, south_m, *pixels_m, interpolation)
    return GridGround(samples, BEYOND[beyond], "", 0.0)


def hills(rng, rows=40, columns=53, pixel_m=4.0, beyond="none", roughness_m=1.5, interpolation="bilinear"):
    """Rough ground around the origin, as steep as 60 degrees in places."""
    north, east = np.mgrid[:rows, :columns] * pixel_m
    height = 9 * np.sin(east / 31) * np.cos(north / 23) + rng.normal(0, roughness_m, (rows, columns))
    west_m, south_m = -columns / 2 * pixel_m, -rows / 2 * pixel_m
    return ground(height, pixel_m, beyond, west_m, south_m, interpolation=interpolation)


def random_rays(rng, count, reach_m, low_m, high_m):
    origin = rng.uniform([-reach_m, -reach_m, low_m], [reach_m, reach_m, high_m], (count, 3))
    direction = rng.normal(size=(count, 3))
    direction[:, 2] = np.where(rng.random(count) < 0.8, -np.abs(direction[:, 2]), direction[:, 2])
    # Some along the axes and some level: components that are exactly zero.
    direction[rng.random(count) < 0.1, 0] = 0.0
    direction[rng.random(count) < 0.1, 1] = 0.0
    direction[rng.random(count) < 0.1, 2] = 0.0
    direction[np.all(direction == 0, axis=1)] = DOWN
    return origin, direction / np.linalg.norm(direction, axis=1)[:, None]


def aimed(target, origin):
    way = target - origin
    return way / np.linalg.norm(way, axis=1)[:, None]


def assert_same(fast, exact, atol=1e-9):
    np.testing.assert_array_equal(fast.inside, exact.inside)
    np.testing.assert_allclose(fast.range_m, exact.range_m, rtol=0, atol=atol)
    np.testing.assert_allclose(fast.normal_site, exact.normal_site, rtol=0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("beyond", BEYOND)
@pytest.mark.parametrize("missing", [0.0, 0.05])
def test_equals_the_slow_path(beyond, interpolation, missing):
    rng = np.random.default_rng(4)
    scene = hills(rng, beyond=beyond, interpolation=interpolation)
    height_m = scene.samples.height_m
    height_m[rng.random(height_m.shape) < missing] = np.nan
    scene = GridGround(scene.samples, BEYOND[beyond], "", 0.0)
    origin, direction = random_rays(rng, 400, 140.0, -25.0, 120.0)
    exact = cast_exact(scene, origin, direction)
    assert_same(scene.cast(origin, direction), exact)
    assert exact.inside.sum() > 10
    assert np.isfinite(exact.range_m).sum() > 50
    assert np.isnan(exact.range_m[~exact.inside]).sum() > 20


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_no_ray_aimed_at_a_vertex_or_an_edge_is_lost(interpolation):
    rng = np.random.default_rng(7)
    scene = hills(rng, 100, 100, roughness_m=0.3, interpolation=interpolation)
    samples, count = scene.samples, 100_000
    i, j = rng.integers(1, 98, count), rng.integers(1, 98, count)
    place = np.stack([i, j], 1).astype(float)
    # At vertices, and along the three kinds of edge: to the east, to the north and diagonal.
    quarter = count // 4
    place[quarter : 2 * quarter, 0] += rng.random(quarter)
    place[2 * quarter : 3 * quarter, 1] += rng.random(quarter)
    place[3 * quarter :] += rng.random((quarter, 1))
    east, north = samples.west_m + 4.0 * place[:, 0], samples.south_m + 4.0 * place[:, 1]
    target = np.stack([east, north, scene.height_m(east, north)], 1)
    # Steeper than the ground anywhere, so that each ray meets it once, at its target.
    origin = target + rng.uniform([-20, -20, 60], [20, 20, 2000], (count, 3))
    # A third lie in the vertical plane of a grid line, and some are vertical.
    origin[::3, 0] = target[::3, 0]
    origin[::7, 1] = target[::7, 1]
    direction = aimed(target, origin)
    distance = np.linalg.norm(target - origin, axis=1)
    for bundle in (1, 10):
        hits = scene.cast(origin, direction, bundle=bundle)
        np.testing.assert_allclose(hits.range_m, distance, rtol=0, atol=1e-10)


def test_rays_along_grid_lines():
    """Along the ridge of a roof, and along the rows of flat ground from its very edge."""
    roof = ground(np.tile([0.0, 1.0, 2.0, 1.0, 0.0], (9, 1)))
    origin = np.array([[2.0, -1.0, 4.0], [2.0, 8.0, 6.0], [0.0, 0.0, 3.0], [4.0, 8.0, 3.0], [2.0, 0.0, 2.0]])
    direction = aimed(
        np.array([[2.0, 5.0, 2.0], [2.0, 1.0, 2.0], [0, 3.0, 0.0], [4, 8.0, 0.0], [2, 1.0, 2.0]]), origin
    )
    hits = roof.cast(origin, direction)
    np.testing.assert_allclose(hits.range_m, [40**0.5, 65**0.5, 18**0.5, 3.0, 0.0], rtol=1e-15)


def test_cliff_of_a_hundred_metres():
    height = np.zeros((20, 20))
    height[:, 10:] = 100.0
    scene = ground(height, 2.0)
    # The face runs from (18, 0) up to (20, 100): at 50 m it lies at 19 m east.
    level = scene.cast(np.array([[5.0, 11.3, 50.0]]), np.array([[1.0, 0.0, 0.0]]))
    assert level.range_m[0] == pytest.approx(14.0, rel=1e-14)
    np.testing.assert_allclose(level.normal_site[0], np.array([-50, 0, 1]) / 2501**0.5, atol=1e-15)
    origin = np.array([[34.0, 7.0, 112.0], [19.5, 7.0, 200.0], [17.0, 7.0, 60.0]])
    above = scene.cast(origin, np.array([[-0.6, 0.0, -0.8], DOWN, DOWN]))
    np.testing.assert_allclose(above.range_m, [15.0, 125.0, 60.0], rtol=1e-14)
    below = scene.cast(np.array([[25.0, 7.0, 60.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert below.inside[0]
    assert np.isnan(below.range_m[0])


def test_ray_that_dips_into_a_cell_and_out_of_it_again():
    """Along its diagonal the cell is an arch of 1 m height: a level ray pierces it and comes out again."""
    saddle = ground([[0.0, 2.0], [2.0, 0.0]])
    # Along the diagonal the surface is 4 a (1 - a).
    origin, way = np.array([[-0.5, -0.5, 0.75]]), np.array([[1.0, 1.0, 0.0]]) / 2**0.5
    hits = saddle.cast(origin, way)
    # It is 0.75 m at a = 1/4 and 3/4.
    assert hits.range_m[0] == pytest.approx(0.75 * 2**0.5, rel=1e-14)
    over = saddle.cast(np.array([[-0.5, -0.5, 1.0 + 1e-9]]), way)
    assert np.isnan(over.range_m[0])


def test_order_along_the_ray():
    """A table of 10 m height in a level plane: outside before it, over it, on it, and beyond it."""
    table = ground(np.full((11, 11), 10.0), 10.0, "plane")
    cases = [
        # origin, target, normal
        ([-100, 50, 20], [-50, 50, 0], [0, 0, 1]),  # the plane in front of the table
        ([-100, 50, 20], [0, 50, 4], [-1, 0, 0]),  # the upright side
        ([50, -100, 20], [50, 0, 4], [0, -1, 0]),
        ([-100, 50, 40], [30, 50, 10], [0, 0, 1]),  # the table
        ([-100, 50, 40], [180, 50, 0], [0, 0, 1]),  # over the table onto the plane behind
        ([300, -250, 90], [210, 310, 0], [0, 0, 1]),  # never over the table
    ]
    origin = np.array([case[0] for case in cases], dtype=float)
    target = np.array([case[1] for case in cases], dtype=float)
    for hits in (table.cast(origin, aimed(target, origin)), cast_exact(table, origin, aimed(target, origin))):
        np.testing.assert_allclose(hits.range_m, np.linalg.norm(target - origin, axis=1), rtol=1e-13)
        np.testing.assert_array_equal(hits.normal_site, [case[2] for case in cases])


def test_pit_below_the_plane_beyond():
    pit = ground(np.full((11, 11), -10.0), 10.0, "plane")
    origin = np.array([[50.0, 50.0, -5.0], [50.0, 50.0, -5.0], [50.0, 50.0, -12.0]])
    direction = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, -1.0]])
    hits = pit.cast(origin, direction)
    np.testing.assert_array_equal(hits.range_m, [50.0, 5.0, np.nan])
    np.testing.assert_array_equal(hits.normal_site[0], [0, -1, 0])
    np.testing.assert_array_equal(hits.inside, [False, False, True])
    np.testing.assert_array_equal(pit.height_m(np.array([50.0, 500.0]), np.array([50.0, 50.0])), [-10.0, 0.0])


def test_with_nothing_beyond():
    scene = ground(np.full((11, 11), 10.0), 10.0)
    origin = np.tile([-100.0, 50.0, 20.0], (3, 1))
    hits = scene.cast(origin, aimed(np.array([[0.0, 50, 4], [-50, 50, 0], [40, 50, 10]]), origin))
    # Through the cut side, past the grid, and onto it.
    np.testing.assert_array_equal(np.isnan(hits.range_m), [True, True, False])
    assert not hits.inside.any()
    east, north = np.array([-0.1, 0.0, 100.0, 50.0]), np.array([50.0, 0.0, 100.0, 100.1])
    np.testing.assert_array_equal(scene.height_m(east, north), [np.nan, 10.0, 10.0, np.nan])
    np.testing.assert_array_equal(scene.covers(east, north), [False, True, True, False])


def test_a_missing_sample_takes_its_four_cells():
    height = np.ones((5, 5))
    height[2, 2] = np.nan
    east, north = np.array([0.5, 1.5, 2.5, 2.5, 3.5]), np.array([0.5, 1.5, 1.5, 2.5, 3.5])
    down = np.tile(DOWN, (5, 1))
    origin = np.stack([east, north, np.full(5, 9.0)], 1)
    expected = {"none": [8, np.nan, np.nan, np.nan, 8], "plane": [8, 9, 9, 9, 8]}
    for beyond, range_m in expected.items():
        scene = ground(height, beyond=beyond)
        np.testing.assert_array_equal(scene.cast(origin, down).range_m, range_m)
        np.testing.assert_allclose(scene.height_m(east, north), 9.0 - np.array(range_m))
        assert scene.covers(east, north).all()


def test_nonsense_rays_hit_nothing():
    scene = ground(np.zeros((4, 4)), beyond="plane")
    origin = np.array([[1.0, 1, 1], [np.nan, 1, 1], [1, 1, 1], [np.inf, 1, 1], [1, 1, 1]])
    direction = np.array([[np.nan] * 3, DOWN, [0, 0, 0], DOWN, [0, 0, -np.inf]])
    hits = scene.cast(origin, direction)
    assert np.isnan(hits.range_m).all()
    assert not hits.inside.any()
    direction[2], direction[4] = np.nan, DOWN
    np.testing.assert_array_equal(cast_exact(scene, origin, direction).range_m, [np.nan] * 4 + [1.0])


def test_far_away_and_close_by():
    """From 100 km the range is good to the last digits of that distance; on the ground it is zero."""
    rng = np.random.default_rng(8)
    scene = hills(rng)
    target = np.stack([rng.uniform(-60, 60, 200), rng.uniform(-60, 60, 200)], 1)
    height = scene.height_m(target[:, 0], target[:, 1])
    for altitude_m, atol in ((1e5, 3e-11), (1.0, 1e-14), (0.0, 0.0)):
        origin = np.column_stack([target, height + altitude_m])
        hits = scene.cast(origin, np.tile(DOWN, (200, 1)))
        np.testing.assert_allclose(hits.range_m, origin[:, 2] - height, rtol=0, atol=atol)


heights = st.integers(-3, 3).map(float) | st.floats(-20, 20).map(lambda x: round(x, 2))


@st.composite
def small_grids(draw, holes):
    interpolation = draw(st.sampled_from(INTERPOLATIONS))
    rows, columns = draw(st.integers(2, 7)), draw(st.integers(2, 7))
    values = heights | st.just(np.nan) if holes else heights
    nodes = draw(st.lists(values, min_size=rows * columns, max_size=rows * columns))
    nodes = np.array(nodes).reshape(rows, columns)
    nodes[:2, :2] = np.nan_to_num(nodes[:2, :2])
    pixel_m, beyond = draw(st.sampled_from([1.0, 3.5])), draw(st.sampled_from(list(BEYOND)))
    return ground(nodes, pixel_m, beyond, interpolation=interpolation)


shares = st.sampled_from([0.0, 0.25, 1 / 3, 0.5, 1.0]) | st.floats(0, 1)


@pytest.mark.slow
@settings(max_examples=300)
@given(
    small_grids(holes=False), st.tuples(shares, shares, shares, shares), st.floats(0, 50), st.floats(0, 50)
)
def test_ray_from_above_the_surface_to_below_it_meets_it(scene, place, height_m, depth_m):
    """Wherever it runs: through vertices, along edges, along the rim, straight down."""
    far = np.array([scene.samples.east_m[-1], scene.samples.north_m[-1]] * 2)
    x0, y0, x1, y1 = place * far
    z0, z1 = scene.height_m(np.array([x0, x1]), np.array([y0, y1])) + np.array([height_m, -depth_m])
    origin, target = np.array([[x0, y0, z0]]), np.array([[x1, y1, z1]])
    distance = np.linalg.norm(target - origin)
    if distance < 1e-3:
        return
    hits = scene.cast(origin, aimed(target, origin))
    assert not hits.inside[0]
    # Where the target is on the surface, rounding may take the ray a little past it, or past a peak.
    assert hits.range_m[0] <= distance * (1 + 1e-12) or depth_m < 1e-9
    if hits.range_m[0] <= distance:
        x, y, z = (origin + hits.range_m[0] * (target - origin) / distance)[0]
        height = scene.height_m(np.clip([x], 0, far[0]), np.clip([y], 0, far[1]))[0]
        assert height == pytest.approx(z, abs=1e-9)


points = st.tuples(st.floats(-5, 30), st.floats(-5, 30), st.floats(-25, 40))


@pytest.mark.slow
@settings(max_examples=300)
@given(small_grids(holes=True), points, points)
def test_small_grids_equal_the_slow_path(scene, start, end):
    """Rays in general position: where one runs along the edge of a hole, rounding decides what it meets."""
    origin = np.array([start]) + np.array([0.0123456789, 0.0314159265, 0.0271828182])
    target = np.array([end]) + np.array([0.0141421356, 0.0173205081, 0.0223606798])
    direction = aimed(target, origin)
    assert_same(scene.cast(origin, direction), cast_exact(scene, origin, direction), atol=1e-8)
