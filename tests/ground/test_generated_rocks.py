"""Rocks against integrals of their laws, and the shape of single ones."""

import numpy as np
import pytest
from scipy.integrate import quad

from lidar_emu.errors import InputError
from lidar_emu.scenario.ground import MarsRocks, PowerLawRocks
from lidar_emu.scene.procedural.generate import generate
from lidar_emu.scene.procedural.populations import (
    Population,
    RockField,
    covered_share,
    rock_layer,
    rocks_per_m2,
)


@pytest.mark.parametrize("abundance", [0.01, 0.05, 0.2, 0.4])
@pytest.mark.parametrize("diameter_m", [0.05, 0.3, 1.0, 3.0])
def test_golombeks_number_follows_from_his_area(abundance, diameter_m):
    part = MarsRocks(kind="golombek", abundance=abundance)
    q = 1.79 + 0.152 / abundance

    def density(d):
        return abundance * q * np.exp(-q * d) / (np.pi * d**2 / 4)

    expected, _ = quad(density, diameter_m, np.inf, epsabs=0, epsrel=1e-11)
    assert rocks_per_m2(np.array([diameter_m]), part)[0] == pytest.approx(expected, rel=1e-8)
    assert covered_share(0.0, np.inf, part) == abundance


@pytest.mark.parametrize("exponent", [1.5, 2.0, 2.6])
def test_power_law_covers_the_integral_of_its_areas(exponent):
    part = PowerLawRocks(kind="power_law", per_m2_over_1_m=1e-3, exponent=exponent)
    expected, _ = quad(lambda d: np.pi / 4 * d**2 * 1e-3 * exponent * d ** (-exponent - 1), 0.5, 8)
    assert covered_share(0.5, 8.0, part) == pytest.approx(expected, rel=1e-10)
    assert rocks_per_m2(np.array([1.0]), part)[0] == 1e-3


def one(diameter_m, east_m, north_m, elongation, azimuth_deg):
    place = Population(np.array([diameter_m]), np.array([east_m]), np.array([north_m]))
    return RockField(place, np.array([elongation]), np.radians([azimuth_deg]))


def test_a_round_rock_is_half_an_ellipsoid(ground):
    asked = ground(rocks={"kind": "golombek", "abundance": 0.1})
    layer = rock_layer(asked, one(20.0, 5.0, 30.0, 1.0, 0.0))
    north, east = 128.0 - np.arange(257)[:, None], np.arange(257) - 128.0
    expected = 10.0 * np.sqrt(np.maximum(1 - ((east - 5) ** 2 + (north - 30) ** 2) / 100, 0))
    np.testing.assert_allclose(layer, expected, atol=1e-12)


def test_a_long_rock_points_where_it_should_and_keeps_its_area(ground):
    asked = ground(size_m=64.0, spacing_m=0.25, rocks={"kind": "golombek", "abundance": 0.1})
    layer = rock_layer(asked, one(16.0, 0.3, -2.1, 1.5, 30.0))
    north, east = 32 - 0.25 * np.arange(257)[:, None], 0.25 * np.arange(257) - 32
    mass = layer.sum()
    assert mass * 0.25**2 == pytest.approx(2 / 3 * np.pi * 8**2 * 8, rel=1e-3)
    assert (layer > 0).sum() * 0.25**2 == pytest.approx(np.pi * 64, rel=5e-3)
    x, y = (layer * east).sum() / mass, (layer * north).sum() / mass
    np.testing.assert_allclose([x, y], [0.3, -2.1], atol=1e-2)
    spread = np.array(
        [[(layer * a * b).sum() / mass for a in (east - x, north - y)] for b in (east - x, north - y)]
    )
    values, vectors = np.linalg.eigh(spread)
    assert (values[1] / values[0]) ** 0.5 == pytest.approx(1.5, rel=5e-3)
    assert np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])) % 180 == pytest.approx(30, abs=0.3)


def test_rocks_do_not_pile_up(ground):
    asked = ground(rocks={"kind": "power_law", "per_m2_over_1_m": 0.1, "exponent": 2.0})
    layers = generate(asked)
    assert (layers.rock_m > 0).mean() > 0.15
    assert layers.rock_m.max() <= 0.5 * layers.rocks.population.diameter_m.max()
    assert layers.rock_m.min() == 0


def test_too_many_are_refused(ground):
    asked = ground(
        size_m=4.0, spacing_m=0.01, rocks={"kind": "power_law", "per_m2_over_1_m": 0.1, "exponent": 6.0}
    )
    with pytest.raises(
        InputError, match=r"rocks from 0\.02 m on; raise smallest_diameter_m for fewer than 1000000"
    ):
        generate(asked)
