"""Objects of many sizes (craters, rocks) at random positions, their number by a size-frequency law."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scenario.generated_ground import Generated, diameter_range_m

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
