"""Plane and sphere against closed forms and 50-digit arithmetic."""

import math

import numpy as np
import pytest
from exact_casting import cast_exact

from lidar_emu.scenario.site import Site
from lidar_emu.scene import build_scene
from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround

MOON_M = 1_737_400.0
LEVEL = PlaneGround(0.0, 0.0, 0.0)
MOON = SphereGround(MOON_M, 0.0)


def downward(rng, count, steepest_deg=90.0):
    """Random unit vectors, at most ``steepest_deg`` from straight down."""
    azimuth = rng.uniform(0, 2 * np.pi, count)
    nadir = np.radians(rng.uniform(0, steepest_deg, count))
    return np.stack([np.sin(nadir) * np.cos(azimuth), np.sin(nadir) * np.sin(azimuth), -np.cos(nadir)], 1)


@pytest.mark.parametrize("ground", [LEVEL, MOON])
def test_where_nothing_is_hit_and_where_a_ray_starts(ground):
    up, level, down = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]
    origin = np.array([[0, 0, 5.0], [0, 0, 5.0], [0, 0, -5.0], [0, 0, -5.0], [0, 0, 0.0], [0, 0, 5.0]])
    direction = np.array([up, level, up, down, down, [np.nan] * 3])
    for hits in (ground.cast(origin, direction), cast_exact(ground, origin, direction)):
        np.testing.assert_array_equal(hits.inside, [False, False, True, True, False, False])
        np.testing.assert_array_equal(hits.range_m, [np.nan, np.nan, np.nan, np.nan, 0.0, np.nan])
        np.testing.assert_array_equal(np.isnan(hits.normal_site).all(axis=1), np.isnan(hits.range_m))


def test_plane_equals_fifty_digits():
    rng = np.random.default_rng(1)
    ground = PlaneGround(math.radians(31), math.radians(200), 0.0)
    origin = rng.uniform([-3000, -3000, -2000], [3000, 3000, 9000], (500, 3))
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    fast, exact = ground.cast(origin, direction), cast_exact(ground, origin, direction)
    np.testing.assert_array_equal(fast.inside, exact.inside)
    # A ray along the plane meets it far away: the error is relative to that range.
    np.testing.assert_allclose(fast.range_m, exact.range_m, rtol=1e-12)
    assert 100 < np.isfinite(fast.range_m).sum() < 400


@pytest.mark.parametrize("altitude_m", [1.0, 30.0, 2e3, 1e5])
def test_sphere_straight_down_is_the_altitude(altitude_m):
    hits = MOON.cast(np.array([[0.0, 0.0, altitude_m]]), np.array([[0.0, 0.0, -1.0]]))
    assert hits.range_m[0] == pytest.approx(altitude_m, rel=4e-16)


@pytest.mark.parametrize("altitude_m", [1.0, 100.0, 1e4, 1e5])
def test_sphere_equals_fifty_digits(altitude_m):
    """Up to 80 degrees from the vertical some rays all but graze: 1.5e-8 m; within 30 degrees 4e-11 m."""
    rng = np.random.default_rng(2)
    count = 400
    origin = np.column_stack([rng.uniform(-5e4, 5e4, (count, 2)), np.zeros(count)])
    origin[:, 2] = MOON.height_m(origin[:, 0], origin[:, 1]) + altitude_m
    direction = downward(rng, count, 80.0)
    fast, exact = MOON.cast(origin, direction), cast_exact(MOON, origin, direction)
    hit = np.isfinite(exact.range_m)
    np.testing.assert_array_equal(np.isfinite(fast.range_m), hit)
    assert hit.mean() > 0.8
    assert np.abs(fast.range_m - exact.range_m)[hit].max() < 1e-7
    np.testing.assert_allclose(fast.normal_site[hit], exact.normal_site[hit], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(fast.normal_site[hit], axis=1), 1, atol=1e-14)


def test_horizon_of_the_sphere():
    """Seen from height h the horizon lies sqrt(h (2 R + h)) away, and beyond it there is nothing."""
    height_m = 1000.0
    distance_m = math.sqrt(height_m * (2 * MOON_M + height_m))
    dip = math.acos(MOON_M / (MOON_M + height_m))
    origin = np.tile([0.0, 0.0, height_m], (2, 1))
    angles = np.array([dip + 1e-9, dip - 1e-9])
    direction = np.stack([np.cos(angles), np.zeros(2), -np.sin(angles)], 1)
    hits = MOON.cast(origin, direction)
    assert hits.range_m[0] == pytest.approx(distance_m, rel=2e-3)
    assert np.isnan(hits.range_m[1])


def test_sphere_below_the_origin():
    ground = build_scene(Site.model_validate({"ground": {"kind": "sphere"}, "origin_altitude_m": 250.0}))
    hits = ground.cast(np.array([[0.0, 0.0, 10.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert ground.origin_altitude_m == 250.0
    assert hits.range_m[0] == pytest.approx(260.0, rel=1e-15)
    height = ground.height_m(np.array([0.0, 1000.0, 2e6]), np.zeros(3))
    np.testing.assert_allclose(height[:2], [-250, -250 - 1000**2 / (2 * MOON_M)], atol=1e-6)
    assert np.isnan(height[2])
    np.testing.assert_array_equal(ground.covers(np.array([0.0, 2e6]), np.zeros(2)), [True, False])


def test_plane_of_a_site():
    part = Site.model_validate({"ground": {"kind": "plane", "slope_deg": 10.0, "downhill_azimuth_deg": 90.0}})
    ground = build_scene(part)
    assert ground.description == "plane, falling 10° toward azimuth 90°"
    assert ground.origin_altitude_m == 0.0
    assert ground.covers(np.array([1e7]), np.array([0.0])).all()
