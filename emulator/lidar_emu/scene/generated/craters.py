"""Craters: how many there are, how worn each is, and the layer of elevation that they make together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.generated_ground import Craters, Generated
from lidar_emu.scene.generated.crater_profile import REACH_RADII, depth_left, worn_profiles
from lidar_emu.scene.generated.population import Population, scatter, stamps

# Neukum, Ivanov and Hartmann (2001): log10 of the cumulative number per km², a polynomial in log10 of the diameter
# in km without its constant, which cancels; and the number above 1 km that an age in Gyr has made.
_PRODUCTION = (
    0.0, -3.557528, 0.781027, 1.021521, -0.156012, -0.444058,
    0.019977, 0.086850, -0.005874, -0.006809, 8.25e-4, 5.54e-5,
)  # fmt: skip
_SMALLEST_COUNTED_KM = 0.01
_SLOPE_BELOW = float(np.polynomial.polynomial.polyval(-2.0, np.polynomial.polynomial.polyder(_PRODUCTION)))


@dataclass(frozen=True)
class CraterField:
    """The craters of a ground."""

    population: Population
    """Rim-to-rim diameters and centres."""
    wear: FloatArray
    """(craters,) from 0, fresh, to 1, about to be lost."""

    def depth_m(self, part: Craters) -> FloatArray:
        """(craters,) from the height of the rim's circle to the centre."""
        return part.depth_to_diameter * self.population.diameter_m * depth_left(self.wear)


def produced_per_m2(diameter_m: FloatArray, age_gyr: float) -> FloatArray:
    """Craters larger than a diameter that formed in an age, per square metre.

    Below 10 m, where the counts end, the law goes on with the slope that it has there.
    """
    above_1_km = 5.44e-14 * np.expm1(6.93 * age_gyr) + 8.38e-4 * age_gyr
    log_km = np.log10(diameter_m / 1e3)
    counted = np.maximum(log_km, np.log10(_SMALLEST_COUNTED_KM))
    log_number = np.polynomial.polynomial.polyval(counted, _PRODUCTION) + _SLOPE_BELOW * (log_km - counted)
    return np.asarray(above_1_km * 10.0**log_number * 1e-6, dtype=np.float64)


def equilibrium_per_m2(diameter_m: FloatArray, part: Craters) -> FloatArray:
    """Craters larger than a diameter that a surface can show before new ones erase as many, per square metre."""
    return np.asarray(part.equilibrium_density / diameter_m**2, dtype=np.float64)


def visible_per_m2(diameter_m: FloatArray, part: Craters) -> FloatArray:
    """Craters larger than a diameter that are there to be seen, per square metre: the lesser of the two laws."""
    return np.minimum(produced_per_m2(diameter_m, part.age_gyr), equilibrium_per_m2(diameter_m, part))


def scatter_craters(ground: Generated, part: Craters, rng: np.random.Generator) -> CraterField:
    """The craters of a ground.

    A crater lasts as long as production needs to make as many as equilibrium has of its size. Those that are seen have
    any age up to that, or up to the surface's age where that is less: small ones come in all states of wear, those too
    large for equilibrium are fresher the rarer they are.
    """
    population = scatter(ground, "craters", partial(visible_per_m2, part=part), REACH_RADII / 2, rng)
    diameter_m = population.diameter_m
    oldest = produced_per_m2(diameter_m, part.age_gyr) / equilibrium_per_m2(diameter_m, part)
    return CraterField(population, rng.random(len(population)) * np.minimum(oldest, 1.0))


def crater_layer(ground: Generated, part: Craters, field: CraterField) -> FloatArray:
    """(rows from north to south, columns) elevation that the craters add. Where some overlap theirs is the sum."""
    layer = np.zeros((ground.cells + 1, ground.cells + 1))
    radii, profiles, level = worn_profiles(field.wear)
    fresh_depth_m = part.depth_to_diameter * field.population.diameter_m
    reach = np.full(len(field.population), REACH_RADII)
    for k, window, east, north in stamps(field.population, reach, ground):
        height = np.interp(np.sqrt(north**2 + east**2), radii, profiles[level[k]])
        layer[window] += fresh_depth_m[k] * height
    return layer
