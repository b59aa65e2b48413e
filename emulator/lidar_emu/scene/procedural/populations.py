"""Craters and rocks: their numbers, positions and sizes, and the elevations that they add.

A fresh crater has a parabolic bowl, a rim, and ejecta whose thickness falls with the cube of the distance (McGetchin et
al. 1973); the rim's height is 0.18 of the depth (Pike 1977: 0.036 of the diameter with a depth of 0.196). Degradation
is diffusion, as countless small impacts cause it (Soderblom 1970; Fassett and Thomson 2014). Diffusion over an age t is
a convolution with a Gaussian of variance 2 κ t per axis, so that the state of a crater is one number, κ t over its
radius squared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.scenario.ground import Craters, Generated, MarsRocks, Rocks, diameter_range_m

Law = Callable[[FloatArray], FloatArray]
"""Cumulative number of craters or rocks per square metre that are larger than a diameter in metres."""

_BINS_PER_DECADE = 100
_MOST = 1_000_000


@dataclass(frozen=True)
class Population:
    """Diameters and positions, the largest first; some lie outside the square and extend into it."""

    diameter_m: FloatArray
    """(n,)"""
    east_m: FloatArray
    """(n,) East of the centre of the square."""
    north_m: FloatArray
    """(n,) North of the centre of the square."""

    def __len__(self) -> int:
        return len(self.diameter_m)

    def within(self, size_m: float) -> BoolArray:
        """Whether each centre lies in the square, (n,)."""
        inside = np.maximum(np.abs(self.east_m), np.abs(self.north_m)) <= size_m / 2
        return np.asarray(inside, dtype=np.bool_)


def scatter(ground: Generated, name: str, law: Law, reach: float, rng: np.random.Generator) -> Population:
    """Draw objects as a Poisson process: numbers and positions are independent.

    Args:
        ground: parameters of the ground.
        name: `craters` or `rocks`.
        law: cumulative number per square metre.
        reach: distance from its centre up to which an object changes the ground, in diameters.
        rng: random generator.
    """
    smallest_m, largest_m = diameter_range_m(ground, name)
    count = int(np.ceil(_BINS_PER_DECADE * np.log10(largest_m / smallest_m))) + 1
    edge_m = np.geomspace(smallest_m, largest_m, count + 1)
    larger = law(edge_m)
    # The square, widened by the distance from which the largest object of the bin extends into it.
    width_m = ground.size_m + 2 * reach * edge_m[1:]
    expected = (larger[:-1] - larger[1:]) * width_m**2
    if not expected.sum() <= _MOST:
        found = Finding(f"{expected.sum():.3g} {name} from {smallest_m:g} m on")
        remedy = f"raise smallest_diameter_m for fewer than {_MOST}"
        raise InputError("site.ground", name, found, remedy)
    drawn = rng.poisson(expected)[::-1]
    share = rng.random(int(drawn.sum()))
    low_m, high_m, wide_m = (np.repeat(values[::-1], drawn) for values in (edge_m[:-1], edge_m[1:], width_m))
    diameter_m = low_m * (high_m / low_m) ** share
    place_m = (rng.random((2, len(share))) - 0.5) * wide_m
    return Population(diameter_m, place_m[0], place_m[1])


Stamp = tuple[int, tuple[slice, slice], FloatArray, FloatArray]


def stamps(population: Population, reach_radii: FloatArray, ground: Generated) -> Iterator[Stamp]:
    """Yield for each object its index, the rows and columns of the grid that it changes, and their positions.

    Args:
        population: objects of a ground.
        reach_radii: (n,) distance from the centre up to which an object changes the ground, in its radii.
        ground: parameters of the ground.

    Yields:
        Index; rows and columns; east (columns,) and north (rows, 1) of the object's centre, in its radii.
    """
    side, spacing_m, half_m = ground.cells + 1, ground.spacing_m, ground.size_m / 2
    radius_m = population.diameter_m / 2
    column, row = (population.east_m + half_m) / spacing_m, (half_m - population.north_m) / spacing_m
    reach = reach_radii * radius_m / spacing_m
    edges = [
        np.clip(edge, 0, side).astype(np.int64)
        for place in (row, column)
        for edge in (np.ceil(place - reach), np.floor(place + reach) + 1)
    ]
    index = np.arange(side)
    for k, (top, bottom, left, right) in enumerate(np.stack(edges, axis=1).tolist()):
        if top < bottom and left < right:
            scale = spacing_m / radius_m[k]
            east = (index[left:right] - column[k]) * scale
            north = (row[k] - index[top:bottom, None]) * scale
            yield k, (slice(top, bottom), slice(left, right)), east, north


REACH_RADII = 4.0
"""Distance from the centre at which a crater's layer ends, in radii."""
RIM_SHARE = 0.18
"""Height of a fresh rim, as a fraction of the depth."""

_LAST_BLUR_RADII = 0.62
"""Standard deviation of the Gaussian at degradation 1, in radii: a fifth of the depth is left, and the crater is no
longer visible."""
_LEVELS = 32
_STEP = 1 / 32
_EJECTA_END = 3.0


def fresh_profile(radii: FloatArray) -> FloatArray:
    """Height over rim-to-floor depth at distances from the centre in units of the rim's radius."""
    outward = np.maximum(radii, 1.0)
    fade = np.clip((outward - 1.0) / (_EJECTA_END - 1.0), 0.0, 1.0)
    ejecta = RIM_SHARE / outward**3 * (1.0 - fade**2 * (3.0 - 2.0 * fade))
    return np.where(radii < 1.0, radii**2 - (1.0 - RIM_SHARE), ejecta)


def degraded_profiles(degradation: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Profiles of craters with given degradation.

    Args:
        degradation: (craters,) from 0 to 1, the share of a crater's life that is over.

    Returns:
        Distances (radii,) in units of the rim's radius, heights (levels, radii) over the fresh depth, and for each
        crater (craters,) which of the levels is its own.
    """
    radii, heights = _table()
    return radii, heights, np.rint(degradation * _LEVELS).astype(np.int64)


def depth_left(degradation: FloatArray) -> FloatArray:
    """Height of the rim's circle above the centre, as a fraction of the fresh depth."""
    radii, heights, level = degraded_profiles(degradation)
    rim = int(np.argmin(np.abs(radii - 1.0)))
    return np.asarray(heights[level, rim] - heights[level, 0], dtype=np.float64)


@cache
def _table() -> tuple[FloatArray, FloatArray]:
    radii = np.arange(0.0, REACH_RADII + _STEP / 2, _STEP)
    blur = _LAST_BLUR_RADII * np.sqrt(np.arange(1, _LEVELS + 1) / _LEVELS)
    heights = np.stack([fresh_profile(radii), *(_blurred(radii, sigma) for sigma in blur)])
    # Diffusion reaches slightly beyond the end: the profile is tapered there to avoid a step in the ground.
    inward = np.clip(REACH_RADII - radii, 0.0, 1.0)
    return radii, heights * inward**2 * (3.0 - 2.0 * inward)


def _blurred(radii: FloatArray, sigma: float) -> FloatArray:
    """Fresh profile convolved with a Gaussian in the plane; for a figure of revolution this is an integral with I0."""
    from scipy.special import i0e

    rings = np.arange(_STEP / 8, _EJECTA_END, _STEP / 4)
    apart = (radii[:, None] - rings) / sigma
    kernel = rings / sigma**2 * np.exp(-(apart**2) / 2) * i0e(radii[:, None] * rings / sigma**2)
    return np.asarray((kernel * fresh_profile(rings)).sum(axis=1) * (_STEP / 4), dtype=np.float64)


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


_LONGEST = 1.6
"""Maximum ratio of a rock's length to its width."""
_HEIGHT_TO_DIAMETER = 0.5


@dataclass(frozen=True)
class RockField:
    """The rocks of a ground. A diameter is the diameter of a circle of equal area."""

    population: Population
    """Diameters and positions."""
    elongation: FloatArray
    """(rocks,) Ratio of length to width."""
    azimuth_rad: FloatArray
    """(rocks,) Direction of the length, from east to north."""


def rocks_per_m2(diameter_m: FloatArray, part: Rocks) -> FloatArray:
    """Rocks larger than a diameter, per square metre.

    On Mars the law gives the area covered; the number follows by dividing the area of each size by the area of one
    rock, which integrates to 4 k q / pi times exp(-q D) / D - q E1(q D).
    """
    if not isinstance(part, MarsRocks):
        return np.asarray(part.per_m2_over_1_m * diameter_m**-part.exponent, dtype=np.float64)
    from scipy.special import exp1

    q = _golombek_q(part.abundance)
    number = np.exp(-q * diameter_m) / diameter_m - q * exp1(q * diameter_m)
    return np.asarray(4 * part.abundance * q / np.pi * number, dtype=np.float64)


def covered_share(smallest_m: float, largest_m: float, part: Rocks) -> float:
    """Sum of the areas of rocks between two diameters, per area of ground."""
    if isinstance(part, MarsRocks):
        q = _golombek_q(part.abundance)
        return part.abundance * (math.exp(-q * smallest_m) - math.exp(-q * largest_m))
    left = 2 - part.exponent
    integral = math.log(largest_m / smallest_m) if left == 0 else (largest_m**left - smallest_m**left) / left
    return math.pi / 4 * part.per_m2_over_1_m * part.exponent * integral


def _golombek_q(abundance: float) -> float:
    return 1.79 + 0.152 / abundance


def scatter_rocks(ground: Generated, part: Rocks, rng: np.random.Generator) -> RockField:
    """Draw the rocks of a ground."""
    population = scatter(ground, "rocks", partial(rocks_per_m2, part=part), math.sqrt(_LONGEST) / 2, rng)
    count = len(population)
    return RockField(population, rng.uniform(1.0, _LONGEST, count), rng.uniform(0.0, np.pi, count))


def rock_layer(ground: Generated, field: RockField) -> FloatArray:
    """Elevation (rows from north to south, columns) that the rocks add.

    Each rock is the upper half of an ellipsoid, half as high as wide; where rocks overlap, the
    higher one counts.
    """
    layer = np.zeros((ground.cells + 1, ground.cells + 1))
    height_m = _HEIGHT_TO_DIAMETER * field.population.diameter_m
    stretch, cosine, sine = np.sqrt(field.elongation), np.cos(field.azimuth_rad), np.sin(field.azimuth_rad)
    for k, window, east, north in stamps(field.population, stretch, ground):
        along = (cosine[k] * east + sine[k] * north) / stretch[k]
        across = (cosine[k] * north - sine[k] * east) * stretch[k]
        top = np.sqrt(np.maximum(1.0 - along**2 - across**2, 0.0))
        np.maximum(layer[window], height_m[k] * top, out=layer[window])
    return layer
