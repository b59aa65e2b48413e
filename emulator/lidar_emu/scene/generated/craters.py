"""Craters: their number, the degradation of each, and the elevation layer that they form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.generated_ground import Craters, Generated
from lidar_emu.scene.generated.crater_profile import REACH_RADII, degraded_profiles, depth_left
from lidar_emu.scene.generated.population import Population, scatter, stamps

# Neukum, Ivanov and Hartmann (2001): log10 of the cumulative number per km², a polynomial in log10 of the diameter in
# km without its constant, which cancels; and the number above 1 km that forms in an age in Gyr.
_PRODUCTION = (
    0.0, -3.557528, 0.781027, 1.021521, -0.156012, -0.444058,
    0.019977, 0.086850, -0.005874, -0.006809, 8.25e-4, 5.54e-5,
)  # fmt: skip
_SMALLEST_COUNTED_KM = 0.01
_EQUILIBRIUM_DENSITY = 0.079  # times 1 / D²: craters per unit area that are larger than D (Trask 1966)
_SLOPE_BELOW = float(np.polynomial.polynomial.polyval(-2.0, np.polynomial.polynomial.polyder(_PRODUCTION)))


@dataclass(frozen=True)
class CraterField:
    """The craters of a ground."""

    population: Population
    """Rim-to-rim diameters and positions."""
    degradation: FloatArray
    """Degradation (craters,) from 0, fresh, to 1, about to be erased."""

    def depth_m(self, part: Craters) -> FloatArray:
        """Depths (craters,) from the rim's circle to the centre."""
        return part.depth_to_diameter * self.population.diameter_m * depth_left(self.degradation)


def produced_per_m2(diameter_m: FloatArray, age_gyr: float) -> FloatArray:
    """Craters larger than a diameter that formed in an age, per square metre.

    Below 10 m, where the counts end, the law continues with its slope at 10 m.
    """
    above_1_km = 5.44e-14 * np.expm1(6.93 * age_gyr) + 8.38e-4 * age_gyr
    log_km = np.log10(diameter_m / 1e3)
    counted = np.maximum(log_km, np.log10(_SMALLEST_COUNTED_KM))
    log_number = np.polynomial.polynomial.polyval(counted, _PRODUCTION) + _SLOPE_BELOW * (log_km - counted)
    return np.asarray(above_1_km * 10.0**log_number * 1e-6, dtype=np.float64)


def equilibrium_per_m2(diameter_m: FloatArray) -> FloatArray:
    """Craters larger than a diameter, per square metre, in equilibrium: new craters erase as many as they add."""
    return np.asarray(_EQUILIBRIUM_DENSITY / diameter_m**2, dtype=np.float64)


def visible_per_m2(diameter_m: FloatArray, part: Craters) -> FloatArray:
    """Visible craters larger than a diameter, per square metre: the smaller of production and equilibrium."""
    return np.minimum(produced_per_m2(diameter_m, part.age_gyr), equilibrium_per_m2(diameter_m))


def scatter_craters(ground: Generated, part: Craters, rng: np.random.Generator) -> CraterField:
    """Draw the craters of a ground.

    A crater lasts as long as production takes to form as many of its size as equilibrium has. Visible craters have any
    age up to that, or up to the age of the surface if that is less: small ones occur in all states of degradation, and
    of those too large for equilibrium the rarer ones are fresher.
    """
    population = scatter(ground, "craters", partial(visible_per_m2, part=part), REACH_RADII / 2, rng)
    diameter_m = population.diameter_m
    oldest = produced_per_m2(diameter_m, part.age_gyr) / equilibrium_per_m2(diameter_m)
    return CraterField(population, rng.random(len(population)) * np.minimum(oldest, 1.0))


def crater_layer(ground: Generated, part: Craters, field: CraterField) -> FloatArray:
    """Elevation (rows from north to south, columns) that the craters add; overlapping craters add up."""
    layer = np.zeros((ground.cells + 1, ground.cells + 1))
    radii, profiles, level = degraded_profiles(field.degradation)
    fresh_depth_m = part.depth_to_diameter * field.population.diameter_m
    reach = np.full(len(field.population), REACH_RADII)
    for k, window, east, north in stamps(field.population, reach, ground):
        height = np.interp(np.sqrt(north**2 + east**2), radii, profiles[level[k]])
        layer[window] += fresh_depth_m[k] * height
    return layer
