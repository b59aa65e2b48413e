"""Craters against published counts, a slow blur, and craters found again on the grid."""

import numpy as np
import pytest
from parts_of_ground import CRATERS
from scipy.ndimage import gaussian_filter, label
from scipy.optimize import brentq

from lidar_emu.scenario.ground import Craters
from lidar_emu.scene.procedural.compare import depths_on_the_grid
from lidar_emu.scene.procedural.generate import generate
from lidar_emu.scene.procedural.populations import (
    CraterField,
    Population,
    degraded_profiles,
    depth_left,
    equilibrium_per_m2,
    fresh_profile,
    produced_per_m2,
    scatter_craters,
    visible_per_m2,
)


def at(diameter_m, age_gyr):
    return produced_per_m2(np.array([float(diameter_m)]), age_gyr)[0] * 1e6


def test_production_is_the_published_one():
    # Neukum, Ivanov and Hartmann (2001): the constant of the polynomial is log10 N(1 km) after 1 Gyr.
    assert np.log10(at(1000, 1.0)) == pytest.approx(-3.0768, abs=1e-3)
    # Mare Imbrium and the oldest highlands by their chronology.
    assert at(1000, 3.5) == pytest.approx(4.8e-3, rel=0.01)
    assert at(1000, 4.4) == pytest.approx(0.956, rel=0.01)
    # Hartmann's rule of thumb for the steep branch: between 300 m and 1 km about as D to the -3.8.
    assert np.log(at(300, 1.0) / at(1000, 1.0)) / np.log(1000 / 300) == pytest.approx(3.8, abs=0.2)
    # Below the counts the law goes on without a step or a kink.
    inside, below = at(10.001, 1.0) / at(10.1, 1.0), at(9.9, 1.0) / at(9.999, 1.0)
    assert inside == pytest.approx(below, rel=1e-3)


def test_a_mare_is_in_equilibrium_up_to_some_hundred_metres():
    part = Craters(age_gyr=3.5)
    crossing_m = brentq(
        lambda d: produced_per_m2(np.array([d]), 3.5)[0] / equilibrium_per_m2(np.array([d]))[0] - 1,
        10,
        900,
    )
    assert 100 < crossing_m < 300
    np.testing.assert_allclose(visible_per_m2(np.array([50.0]), part), 0.079 / 2500)
    np.testing.assert_allclose(
        visible_per_m2(np.array([800.0]), part), produced_per_m2(np.array([800.0]), 3.5)
    )


def test_a_worn_profile_is_a_blurred_crater():
    """The integral over rings against scipy's filter on a fine grid of the plane."""
    step = 1 / 32
    x = np.arange(-5, 5 + step / 2, step)
    fresh = fresh_profile(np.hypot(x[:, None], x))
    for degradation in (0.125, 0.5, 1.0):
        radii, heights, level = degraded_profiles(np.array([degradation]))
        blurred = gaussian_filter(fresh, 0.62 * degradation**0.5 / step)
        middle = len(x) // 2
        near = radii <= 3.0
        expected = np.interp(radii[near], x[middle:], blurred[middle, middle:])
        np.testing.assert_allclose(heights[level[0]][near], expected, atol=2e-3)
        assert heights[level[0]][-1] == 0


def test_craters_grow_shallow():
    assert depth_left(np.zeros(1))[0] == pytest.approx(1.0)
    left = depth_left(np.linspace(0, 1, 33))
    assert (np.diff(left) < 0).all()
    assert left[-1] == pytest.approx(0.2, abs=0.03)
    np.testing.assert_allclose(fresh_profile(np.array([0.0, 1.0, 3.0, 4.0])), [-0.82, 0.18, 0, 0], atol=1e-15)


def test_rare_craters_are_fresh_and_common_ones_of_any_wear(ground):
    asked = ground(size_m=4000.0, spacing_m=4.0, craters={"age_gyr": 1.0})
    field = scatter_craters(asked, asked.craters, np.random.default_rng(1))
    diameter_m = field.population.diameter_m
    small = diameter_m < 30
    assert small.sum() > 1000
    assert np.mean(field.degradation[small]) == pytest.approx(0.5, abs=0.03)
    assert field.degradation.max() <= 1
    share = produced_per_m2(diameter_m, 1.0) / equilibrium_per_m2(diameter_m)
    assert share.min() < 0.7
    assert (field.degradation <= share + 1e-12)[share < 1].all()


def test_craters_are_found_again_on_the_grid(ground):
    """Hollows counted and measured on the elevations, which know nothing of the list that they were made from."""
    craters = {"age_gyr": 0.002, "smallest_diameter_m": 20.0, "largest_diameter_m": 60.0}
    asked = ground(size_m=2000.0, craters=craters, seed=3)
    layers = generate(asked)
    hollows, count = label(layers.crater_m < 0)
    population = layers.craters.population
    half_m = 1000 - population.diameter_m / 2
    inside = np.maximum(np.abs(population.east_m), np.abs(population.north_m)) < half_m
    assert (layers.craters.degradation < 0.1).all()
    own = [
        hollows[round(1000 - north), round(1000 + east)]
        for east, north in zip(population.east_m[inside], population.north_m[inside], strict=True)
    ]
    assert 0 not in own
    assert inside.sum() - 2 <= len(set(own)) <= count <= len(population)
    # The bowl crosses the level of the plain at 0.906 of the rim's radius, by its parabola.
    area_m2 = np.bincount(hollows.ravel())[own]
    found_m = np.sqrt(4 * area_m2 / np.pi) / 0.82**0.5
    assert np.median(found_m / population.diameter_m[inside]) == pytest.approx(1, abs=0.03)
    depth_m = [-layers.crater_m[hollows == k].min() for k in own]
    assert np.median(depth_m / population.diameter_m[inside]) == pytest.approx(0.82 * 0.2, rel=0.1)


def test_craters_reach_in_from_outside(ground):
    """As many per area, and as deep, at the rim of the square as in its middle."""
    rim, middle = [], []
    for seed in range(30):
        layer = generate(ground(craters={"age_gyr": 3.5}, seed=seed)).crater_m
        rim.append(np.mean(layer[:16] ** 2))
        middle.append(np.mean(layer[120:136] ** 2))
    assert 0.4 < np.mean(rim) / np.mean(middle) < 2.5


def test_depth_is_the_height_of_the_rim_above_the_centre(ground):
    """Paraboloids, of which the circle of the rim is higher than the centre by the square of its radius."""
    generated = ground(craters=CRATERS, size_m=64.0, spacing_m=0.25)
    north_m, east_m = np.meshgrid(
        *[np.arange(32.0, -32.01, -0.25), np.arange(-32.0, 32.01, 0.25)], indexing="ij"
    )
    height_m = (east_m - 5.0) ** 2 + (north_m + 3.0) ** 2
    population = Population(np.array([20.0, 20.0, 0.5]), np.array([5.0, 25.0, 5.0]), np.full(3, -3.0))
    depth_m = depths_on_the_grid(generated, height_m, CraterField(population, np.zeros(3)))
    assert depth_m[0] == pytest.approx(100.0, abs=0.02)
    assert np.isnan(depth_m[1:]).all(), "near the edge, and small"
