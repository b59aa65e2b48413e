"""Ground that is left out is ground that no ray needs: the same hits, bit by bit, and none lost when one strays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.mosaic import grids
from lidar_emu.scene.mosaic.grids import Layer, join_grids
from lidar_emu.scene.ray_reach import CroppedGround, Reach, Rectangle, Span, strays

BEYOND = [None, PlaneGround(0.0, 0.0, 0.0), SphereGround(1.7e6, 0.0)]
SLACK_RAD, SPREAD_M = 2e-3, 0.05


@pytest.fixture(autouse=True)
def cut_small_grids_too(monkeypatch):
    monkeypatch.setattr(grids, "CUT_FROM_SAMPLES", 0)


def layer(rng, west_m, south_m, pixel_m, columns, rows, holes=0.0):
    north, east = np.mgrid[:rows, :columns] * pixel_m
    height = 25 * np.sin((east + west_m) / 90) * np.cos((north + south_m) / 70)
    height += rng.normal(0, 0.3 * pixel_m, height.shape)
    height[rng.random(height.shape) < holes] = np.nan
    samples = Samples(height, west_m, south_m, pixel_m, pixel_m * 1.1, rng.choice(["bilinear", "triangles"]))
    return Layer(samples, lambda s, beyond, name: GridGround(s, beyond, name, 0.0), "", "")


def beams(rng, count=60):
    """A vehicle on its way, and beams around its axis; some look up, and some not at all."""
    path = np.linspace(0, 1, count)[:, None]
    start, end = rng.uniform([-500, -500, 120], [500, 500, 900], (2, 3))
    origin = start + path * (end - start)
    axis = rng.normal(size=3) * [0.6, 0.6, 0] + [0, 0, rng.choice([-1.0, -0.2, 0.4], p=[0.8, 0.15, 0.05])]
    direction = axis + rng.normal(0, 0.25, (count, 3))
    direction[rng.random(count) < 0.05] = np.nan
    return origin, direction / np.linalg.norm(direction, axis=1)[:, None]


def beamlets(rng, origin, direction, count=20):
    """Rays that start and point a little otherwise, by no more than is allowed for."""
    away = rng.normal(size=(count, *origin.shape))
    away *= SPREAD_M * rng.random((count, len(origin), 1)) / np.linalg.norm(away, axis=-1, keepdims=True)
    turn = rng.normal(size=(count, *origin.shape))
    turn -= (turn * direction).sum(axis=-1, keepdims=True) * direction
    turn *= 0.999 * SLACK_RAD / np.linalg.norm(turn, axis=-1, keepdims=True)
    turned = direction + turn * rng.random((count, len(origin), 1))
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    of_beams = (origin + away).swapaxes(0, 1), turned.swapaxes(0, 1)
    return of_beams[0].reshape(-1, 3), of_beams[1].reshape(-1, 3)


@pytest.mark.slow
@given(st.integers(0, 10**9))
@settings(max_examples=150, deadline=None)
def test_hits_before_equal_hits_after(seed):
    rng = np.random.default_rng(seed)
    beyond = BEYOND[rng.integers(3)]
    layers = [layer(rng, -800.3, -700.9, 10.1, 160, 150, rng.choice([0, 0.01]))]
    if rng.random() < 0.5:
        layers.insert(0, layer(rng, *rng.uniform(-300, 0, 2), 2.3, 120, 130, rng.choice([0, 0.01])))
    axes = beams(rng)
    reach = Reach(lambda: iter([axes]), SLACK_RAD, SPREAD_M)

    def forbidden():
        if reads:
            raise AssertionError("a ray strayed that the reach had foreseen")
        reads.append(True)
        return layers, beyond

    reads = []
    cut = join_grids(forbidden, reach)
    whole = join_grids(lambda: (layers, beyond), reach, cut=False)
    assert isinstance(cut, CroppedGround)
    origin, direction = beamlets(rng, *axes)
    before = whole.cast(origin, direction)
    for bundle in (1, 20):
        after = cut.cast(origin, direction, None, bundle)
        for one, other in zip(before, after, strict=True):
            np.testing.assert_array_equal(other, one)
    place = origin[:, :2].T
    np.testing.assert_array_equal(cut.height_m(*place), whole.height_m(*place))
    anywhere = rng.uniform(-1200, 1200, (2, 200))
    np.testing.assert_array_equal(cut.covers(*anywhere), whole.covers(*anywhere))


def test_only_rays_that_need_more_are_strays():
    span = Span(Rectangle(-100, 100, -100, 100), -10.0, 10.0)
    kept = Rectangle(-20, 20, -20, 20)
    rays = [
        ([0, 0, 50], [0, 0, -1], False),
        ([0, 0, 50], [0.6, 0, -0.8], True),  # 30 to 45 m east between ceiling and floor
        ([0, 0, 20], [0.6, 0, -0.8], True),  # leaves what is kept above the floor
        ([0, 0, 18], [0.5, 0, -np.sqrt(0.75)], False),
        ([0, 0, 50], [1, 0, 0], False),  # level, above everything
        ([0, 0, 5], [1, 0, 0], True),
        ([0, 0, 5], [0, 0, 1], False),
        ([0, 0, 500], [0.6, 0, -0.8], False),  # comes down beside the grid
        ([200, 0, 5], [1, 0, 0], False),
        ([200, 0, 5], [-1, 0, 0], True),
        ([0, 0, 50], [np.nan] * 3, False),
    ]
    origin, direction, expected = (np.array(column, dtype=float) for column in zip(*rays, strict=True))
    found = strays(origin, direction, [(span, kept)])
    np.testing.assert_array_equal(
        np.zeros(len(origin), bool) if found is None else found, expected.astype(bool)
    )


def extreme_beamlets(rng, origin, direction, slack_rad, spread_m, count=4000):
    """Rays at the very limits: turned by the whole slack, and started the whole spread away."""
    away = rng.normal(size=(count, 3))
    away *= spread_m / np.linalg.norm(away, axis=1, keepdims=True)
    turn = rng.normal(size=(count, 3))
    turn -= (turn @ direction)[:, None] * direction
    turn *= 1 / np.linalg.norm(turn, axis=1, keepdims=True)
    return origin + away, np.cos(slack_rad) * direction + np.sin(slack_rad) * turn


@pytest.mark.parametrize("seed", range(40))
def test_what_a_ray_needs_holds_all_its_beamlets_and_little_else(seed):
    """The margin around a ray, without the rows and columns that a cut grid keeps besides."""
    rng = np.random.default_rng(seed)
    slack_rad, spread_m = rng.uniform(2e-3, 2e-2), rng.uniform(0.1, 5.0)
    tilt, azimuth = rng.uniform(0, 0.9), rng.uniform(0, 2 * np.pi)
    direction = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)])
    floor_m, ceiling_m = -20.0, rng.uniform(-20.0, 20.0)
    origin = np.array([*rng.uniform(-50, 50, 2), ceiling_m + rng.uniform(-0.9 * (ceiling_m + 20.0), 300.0)])
    area = Rectangle(-1e4, 1e4, -1e4, 1e4)

    starts, ways = extreme_beamlets(rng, origin, direction, slack_rad, spread_m)
    t_first = np.maximum((starts[:, 2] - ceiling_m) / -ways[:, 2], 0.0)
    t_last = (starts[:, 2] - floor_m) / -ways[:, 2]
    over = t_last > t_first
    ends = [starts[over] + t[over, None] * ways[over] for t in (t_first, t_last)]
    place_m = np.concatenate([*(end[:, :2] for end in ends), origin[None, :2]])

    lines = lambda: iter([(origin[None], direction[None])])  # noqa: E731
    needed = Reach(lines, slack_rad, spread_m).over(Span(area, floor_m, ceiling_m))
    low_m, high_m = place_m.min(axis=0), place_m.max(axis=0)
    assert needed.west_m <= low_m[0]
    assert needed.south_m <= low_m[1]
    assert needed.east_m >= high_m[0]
    assert needed.north_m >= high_m[1]
    # The rest is what slack and spread may add where they add to each other: their share of a slanted way down.
    margin_m = (spread_m + t_last.max() * slack_rad) / np.cos(tilt + slack_rad)
    assert needed.west_m >= low_m[0] - margin_m
    assert needed.south_m >= low_m[1] - margin_m
    assert needed.east_m <= high_m[0] + margin_m
    assert needed.north_m <= high_m[1] + margin_m
