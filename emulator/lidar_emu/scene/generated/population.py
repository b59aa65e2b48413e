"""Objects of many sizes (craters, rocks) at random places, as many as a size-frequency law gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scenario.generated_ground import Generated, diameter_range_m

Law = Callable[[FloatArray], FloatArray]
"""Cumulative number of larger craters or rocks per square metre, as a function of the diameter in metres."""

_BINS_PER_DECADE = 100
_MOST = 1_000_000


@dataclass(frozen=True)
class Population:
    """Diameters and places, the largest first; some lie outside the square, and reach into it."""

    diameter_m: FloatArray
    """(n,)"""
    east_m: FloatArray
    """(n,) from the centre of the square."""
    north_m: FloatArray
    """(n,) from the centre of the square."""

    def __len__(self) -> int:
        return len(self.diameter_m)

    def within(self, size_m: float) -> BoolArray:
        """(n,) whether the centre lies in the square."""
        inside = np.maximum(np.abs(self.east_m), np.abs(self.north_m)) <= size_m / 2
        return np.asarray(inside, dtype=np.bool_)


def scatter(ground: Generated, name: str, law: Law, reach: float, rng: np.random.Generator) -> Population:
    """A Poisson process: numbers and places are independent of one another.

    Args:
        ground: what is asked for.
        name: `craters` or `rocks`.
        law: cumulative number per square metre.
        reach: how far from its centre an object changes the ground, in diameters.
        rng: source of the chance.

    Raises:
        InputError: the law wants more than can be made.
    """
    smallest_m, largest_m = diameter_range_m(ground, name)
    count = int(np.ceil(_BINS_PER_DECADE * np.log10(largest_m / smallest_m))) + 1
    edge_m = np.geomspace(smallest_m, largest_m, count + 1)
    larger = law(edge_m)
    # As wide as the square and all from which the largest of the bin reaches in.
    width_m = ground.size_m + 2 * reach * edge_m[1:]
    expected = (larger[:-1] - larger[1:]) * width_m**2
    if not expected.sum() <= _MOST:
        found = Finding(f"{expected.sum():.3g} {name} from {smallest_m:g} m on")
        allowed = f"allowed: at most {_MOST}; a larger smallest_diameter_m makes fewer"
        raise InputError("site.ground", name, found, allowed)
    drawn = rng.poisson(expected)[::-1]
    share = rng.random(int(drawn.sum()))
    low_m, high_m, wide_m = (np.repeat(values[::-1], drawn) for values in (edge_m[:-1], edge_m[1:], width_m))
    diameter_m = low_m * (high_m / low_m) ** share
    place_m = (rng.random((2, len(share))) - 0.5) * wide_m
    return Population(diameter_m, place_m[0], place_m[1])


Stamp = tuple[int, tuple[slice, slice], FloatArray, FloatArray]


def stamps(population: Population, reach_radii: FloatArray, ground: Generated) -> Iterator[Stamp]:
    """For each object its index, the rows and columns of the grid that it changes, and where these lie.

    Args:
        population: of a ground.
        reach_radii: (n,) distance from the centre up to which it changes the ground, in its radii.
        ground: what is asked for.

    Yields:
        index; rows and columns; (columns,) east and (rows, 1) north of the centre in radii of the object.
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
