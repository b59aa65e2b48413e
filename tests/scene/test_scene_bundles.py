"""Rays cast as bundles against the same rays cast one by one: whatever they are, the same bits."""

import numpy as np
import pytest

from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.ray_hits import Hits

BEYOND = {"none": None, "plane": PlaneGround(0.0, 0.0, 0.0), "sphere": SphereGround(5000.0, 0.0)}


def terrain(rng, interpolation="bilinear", beyond="none", pixel_m=4.0, roughness_m=0.2, holes=0.0):
    """Hills 18 m high around the origin, 400 m wide."""
    cells = round(400 / pixel_m)
    north, east = np.mgrid[: cells + 1, : cells + 1] * pixel_m
    height = 9 * np.sin(east / 31) * np.cos(north / 23) + rng.normal(0, roughness_m, north.shape)
    height[rng.random(height.shape) < holes] = np.nan
    samples = Samples(height, -200.0, -200.0, pixel_m, pixel_m, interpolation)
    return GridGround(samples, BEYOND[beyond], "", 0.0)


def beams(rng, count, beamlets, tilt_rad, radius_m=0.05, divergence=5e-5, reach_m=150.0, altitude_m=None):
    """Axes through random points, each amid its beamlets."""
    azimuth = rng.uniform(0, 2 * np.pi, count)
    tilt = np.full(count, tilt_rad)
    axis = np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)], 1)
    target = np.column_stack([rng.uniform(-reach_m, reach_m, (count, 2)), np.zeros(count)])
    distance = rng.uniform(30, 2000, count) if altitude_m is None else altitude_m / np.cos(tilt)
    origin = np.repeat(target - distance[:, None] * axis, beamlets, axis=0)
    axis = np.repeat(axis, beamlets, axis=0)
    aside = np.cross(axis, rng.normal(size=axis.shape))
    aside /= np.maximum(1.0, np.linalg.norm(aside, axis=1))[:, None]
    aside[::beamlets] = 0.0
    direction = axis + divergence * aside
    return origin + radius_m * aside, direction / np.linalg.norm(direction, axis=1)[:, None]


def assert_the_same_bits(scene, origin, direction, bundle):
    alone = scene.cast(origin, direction)
    together = scene.cast(origin, direction, bundle=bundle)
    for name in ("range_m", "normal_site", "inside", "reflectance", "object_id"):
        np.testing.assert_array_equal(getattr(together, name), getattr(alone, name), err_msg=name)
    return alone


@pytest.mark.parametrize("interpolation", ["bilinear", "triangles"])
@pytest.mark.parametrize("beyond", BEYOND)
@pytest.mark.parametrize("tilt_deg", [0.0, 7.5, 22.5, 60.0, 80.0, 89.0])
def test_beams(interpolation, beyond, tilt_deg):
    rng = np.random.default_rng(1)
    scene = terrain(rng, interpolation, beyond)
    origin, direction = beams(rng, 300, 61, np.radians(tilt_deg))
    hits = assert_the_same_bits(scene, origin, direction, 61)
    assert np.isfinite(hits.range_m).mean() > 0.2


@pytest.mark.parametrize("interpolation", ["bilinear", "triangles"])
@pytest.mark.parametrize("beyond", BEYOND)
def test_holes_and_faces_and_rims(interpolation, beyond):
    """From below the highest ground too, so that some beams start inside it."""
    rng = np.random.default_rng(2)
    scene = terrain(rng, interpolation, beyond, holes=0.03)
    for tilt_deg, altitude_m in ((10.0, 6.0), (45.0, 50.0), (75.0, 20.0)):
        rays = beams(rng, 400, 19, np.radians(tilt_deg), 0.3, 1e-3, 230.0, altitude_m)
        assert_the_same_bits(scene, *rays, 19)


@pytest.mark.parametrize("radius_m", [1e-6, 1.0, 3.0, 30.0, 1000.0])
def test_spots_narrower_and_wider_than_cells(radius_m):
    rng = np.random.default_rng(3)
    scene = terrain(rng, "triangles", "plane")
    origin, direction = beams(rng, 200, 19, np.radians(20.0), radius_m, radius_m / 500)
    assert_the_same_bits(scene, origin, direction, 19)


def test_unrelated_rays_and_nonsense():
    """A bundle may be anything, and its last may be shorter; rays that are no rays hit nothing, the others do."""
    rng = np.random.default_rng(4)
    scene = terrain(rng, beyond="sphere")
    origin = rng.uniform([-250, -250, -20], [250, 250, 200], (1000, 3))
    direction = rng.normal(size=(1000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    assert_the_same_bits(scene, origin, direction, 64)
    origin, direction = beams(rng, 100, 37, 0.3)
    origin[5::37], direction[6::37], direction[7::37], direction[8::37, 2] = np.nan, np.nan, 0.0, np.inf
    direction[9::37] *= -1.0
    origin[10::37, 1] = -np.inf
    hits = assert_the_same_bits(scene, origin, direction, 37)
    for place in (5, 6, 7, 8, 10):
        assert np.isnan(hits.range_m[place::37]).all()
    assert np.isfinite(hits.range_m[::37]).mean() > 0.9
    empty = scene.cast(np.empty((0, 3)), np.empty((0, 3)), bundle=61)
    assert len(empty.range_m) == 0


def test_hits_given_are_filled():
    rng = np.random.default_rng(6)
    scene = terrain(rng)
    origin, direction = beams(rng, 10, 7, 0.2)
    hits = Hits.none(70)
    assert scene.cast(origin, direction, hits, 7) is hits
    np.testing.assert_array_equal(hits.range_m, scene.cast(origin, direction).range_m)
