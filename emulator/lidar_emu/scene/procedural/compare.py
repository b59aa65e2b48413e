"""Comparison of the requested and the measured statistics of a generated ground, with tolerances."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.ground import Craters, Generated, Relief, Rocks, diameter_range_m
from lidar_emu.scene.procedural.generate import Layers, hurst_exponent, rms_slope
from lidar_emu.scene.procedural.populations import (
    CraterField,
    Law,
    Population,
    RockField,
    covered_share,
    rocks_per_m2,
    visible_per_m2,
)

_SIGMAS = 4.0
"""Tolerance in standard deviations of the sampling scatter: one ground in ten thousand exceeds it."""
_MEASURED_SAMPLES = 16
"""Minimum diameter of a crater, in samples, for its depth to be measured on the grid."""
_FEWEST_MEASURED = 5


@dataclass(frozen=True)
class StatisticCheck:
    """One statistic of a ground, requested and measured."""

    quantity: str
    """Quantity with its unit."""
    asked: float
    """Value from the parameters."""
    found: float
    """Value measured on the ground."""
    low: float
    """Lower limit by sampling scatter."""
    high: float
    """Upper limit by sampling scatter."""

    @property
    def within(self) -> bool:
        return self.low <= self.found <= self.high


def compare(ground: Generated, layers: Layers) -> list[StatisticCheck]:
    """Compare all requested statistics with those measured on the layers of a ground."""
    found: list[StatisticCheck] = []
    if ground.relief is not None and layers.relief_m is not None:
        found += _relief(ground, ground.relief, layers.relief_m)
    if ground.craters is not None and layers.craters is not None and layers.crater_m is not None:
        found += _craters(ground, ground.craters, layers.craters, layers.crater_m)
    if ground.rocks is not None and layers.rocks is not None and layers.rock_m is not None:
        found += _rocks(ground, ground.rocks, layers.rocks, layers.rock_m)
    return found


def expected_number(ground: Generated, name: str, diameter_m: FloatArray) -> FloatArray:
    """Expected numbers (diameters,) of `craters` or `rocks` in the square, up to the largest allowed."""
    law = _law(ground, name)
    largest = law(np.array([diameter_range_m(ground, name)[1]]))
    return np.asarray((law(diameter_m) - largest) * ground.size_m**2, dtype=np.float64)


def _law(ground: Generated, name: str) -> Law:
    if name == "craters" and ground.craters is not None:
        return partial(visible_per_m2, part=ground.craters)
    if name == "rocks" and ground.rocks is not None:
        return partial(rocks_per_m2, part=ground.rocks)
    raise ValueError(f"the ground has no {name}")


def _relief(ground: Generated, relief: Relief, height_m: FloatArray) -> Iterator[StatisticCheck]:
    # The estimate scatters over many surfaces by 2 over the samples per side, for any exponent.
    tolerance = 0.005 + _SIGMAS * 2.0 / ground.cells
    asked, found = relief.hurst, hurst_exponent(height_m)
    yield StatisticCheck("Hurst exponent of the relief", asked, found, asked - tolerance, asked + tolerance)
    slope = rms_slope(height_m, ground.spacing_m, relief.baseline_m, relief.hurst)
    asked, found = relief.rms_slope_deg, math.degrees(math.atan(slope))
    quantity = f"rms slope of the relief over {relief.baseline_m:g} m (deg)"
    yield StatisticCheck(quantity, asked, found, asked * 0.999, asked * 1.001)


def _craters(
    ground: Generated, part: Craters, craters: CraterField, height_m: FloatArray
) -> Iterator[StatisticCheck]:
    yield from _numbers(ground, "craters", craters.population)
    ratio = depths_on_the_grid(ground, height_m, craters) / craters.depth_m(part)
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) >= _FEWEST_MEASURED:
        tolerance = 0.05 + 1.0 / math.sqrt(len(ratio))
        quantity = f"crater depth on the grid over true depth, median of {len(ratio)}"
        yield StatisticCheck(quantity, 1.0, float(np.median(ratio)), 1 - tolerance, 1 + tolerance)


def depths_on_the_grid(ground: Generated, height_m: FloatArray, craters: CraterField) -> FloatArray:
    """Depths (craters,): mean height of the rim's circle less the centre's; NaN for craters that are small or near the
    edge."""
    from scipy.ndimage import map_coordinates

    population = craters.population
    radius_m = population.diameter_m / 2
    azimuth = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)[:, None]
    out = np.concatenate([np.zeros((1, 1)), np.ones((16, 1))])
    ring = np.concatenate([np.zeros((1, 1)), azimuth])
    north = population.north_m + out * radius_m * np.sin(ring)
    east = population.east_m + out * radius_m * np.cos(ring)
    half_m = ground.size_m / 2
    place = np.stack([half_m - north, east + half_m]) / ground.spacing_m
    sampled = map_coordinates(height_m, place, order=1, mode="nearest")
    depth_m = sampled[1:].mean(axis=0) - sampled[0]
    inside = np.maximum(np.abs(population.east_m), np.abs(population.north_m)) + radius_m < half_m
    clear = inside & (population.diameter_m >= _MEASURED_SAMPLES * ground.spacing_m)
    return np.where(clear, depth_m, np.nan)


def _rocks(
    ground: Generated, part: Rocks, rocks: RockField, height_m: FloatArray
) -> Iterator[StatisticCheck]:
    yield from _numbers(ground, "rocks", rocks.population)
    # Rocks overlap: independent rocks whose areas sum to a fraction s cover 1 - exp(-s) of the ground.
    asked = -math.expm1(-covered_share(*diameter_range_m(ground, "rocks"), part))
    area_m2 = np.pi / 4 * rocks.population.diameter_m**2
    spread = (
        math.sqrt(float((area_m2**2).sum()) + ground.spacing_m**2 * float(area_m2.sum())) / ground.size_m**2
    )
    tolerance = _SIGMAS * spread + (0.0 if len(area_m2) else asked)
    low, high, found = max(0.0, asked - tolerance), asked + tolerance, float((height_m > 0).mean())
    yield StatisticCheck("fraction of the ground under rocks", asked, found, low, high)


def _numbers(ground: Generated, name: str, population: Population) -> Iterator[StatisticCheck]:
    """Compare numbers above the smallest diameter, twice that diameter, and so on while at least one is expected."""
    smallest_m, largest_m = diameter_range_m(ground, name)
    doublings = np.arange(math.ceil(math.log2(largest_m / smallest_m)))
    diameters_m = smallest_m * np.exp2(doublings.astype(np.float64))
    own_m = population.diameter_m[population.within(ground.size_m)]
    for k, asked in enumerate(expected_number(ground, name, diameters_m).tolist()):
        if asked < 1.0 and k > 0:
            return
        # The square root of a Poisson number has a standard deviation of a half, for any mean.
        low, high = max(0.0, math.sqrt(asked) - _SIGMAS / 2) ** 2, (math.sqrt(asked) + _SIGMAS / 2) ** 2
        found = float(np.count_nonzero(own_m >= diameters_m[k]))
        yield StatisticCheck(f"{name} larger than {diameters_m[k]:.3g} m", asked, found, low, high)
