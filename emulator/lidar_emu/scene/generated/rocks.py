"""Rocks: their number, and the elevation layer of those that the grid resolves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.generated_ground import Generated, MarsRocks, Rocks
from lidar_emu.scene.generated.population import Population, scatter, stamps

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
