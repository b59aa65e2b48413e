"""Which part of the map rays can need, whatever the ground between a lowest and a highest height is like."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.map_area import Rectangle

Lines = tuple[FloatArray, FloatArray]
"""Origins and unit directions (n, 3) of rays."""

NOWHERE = (np.inf, -np.inf, np.inf, -np.inf)


class Span(NamedTuple):
    """What a ground may fill: an area of the map between two heights."""

    area: Rectangle
    floor_m: float
    ceiling_m: float


class Reach:
    """The rays of a whole run.

    Args:
        lines: the axes of all beams that may ever be cast, block by block.
        slack_rad: by how much a beamlet's direction may differ from its axis'.
        spread_m: by how far it may start away from it.
    """

    def __init__(self, lines: Callable[[], Iterator[Lines]], slack_rad: float, spread_m: float) -> None:
        self._lines, self._slack_rad, self._spread_m = lines, slack_rad, spread_m

    def over(self, span: Span, below_m: float = np.inf) -> Rectangle:
        """What part of an area contains all places at which a ray is between floor and ceiling, and the place of the
        area nearest to every ray's start; empty if there is none.

        Args:
            span: where the ground is.
            below_m: of rays that start lower than this.
        """
        needed = np.array(NOWHERE)
        for origin, direction in self._lines():
            low = origin[:, 2] < below_m
            slack = self._slack_rad, self._spread_m
            _extend(origin[low], direction[low], *span.area, span.floor_m, span.ceiling_m, *slack, needed)
        return Rectangle(*needed.tolist())


def strays(origin_site_m: FloatArray, direction_site: FloatArray, span: Span, kept: Rectangle) -> BoolArray:
    """(n,) Whether rays may need more of a ground than what is kept of it."""
    stray = np.empty(len(origin_site_m), dtype=np.bool_)
    _find_strays(origin_site_m, direction_site, *span.area, span.floor_m, span.ceiling_m, *kept, stray)
    return stray


@kernel
def _needed(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    west: float,
    east: float,
    south: float,
    north: float,
    floor: float,
    ceiling: float,
    slack: float,
    spread: float,
) -> tuple[float, float, float, float]:
    """The part of an area over which any ray, turned and moved by no more than this, is between floor and ceiling.

    After t a turned ray is within spread + t slack of the given one, in every direction. It comes to the ceiling
    at the earliest if it sinks by slack faster, and to the floor at the latest if by slack slower. One that may not
    sink at all ends where it climbs through the ceiling, or leaves the area.
    """
    if not np.isfinite(x + y + z + dx + dy + dz):
        return np.inf, -np.inf, np.inf, -np.inf
    above = z - spread - ceiling
    first = 0.0
    if above > 0.0:
        first = above / (slack - dz) if slack > dz else np.inf
    away = np.hypot(max(abs(x - west), abs(x - east)), max(abs(y - south), abs(y - north))) + spread
    level = np.hypot(dx, dy) - slack
    last = away / level if level > 0.0 else np.inf
    if -dz > slack:
        last = min(last, max(z + spread - floor, 0.0) / (-dz - slack))
    elif dz > slack:
        last = min(last, max(-above, 0.0) / (dz - slack))
    if first > last:
        return np.inf, -np.inf, np.inf, -np.inf
    if last == np.inf:
        return west, east, south, north
    round_it = spread + last * slack
    return (
        max(west, x + min(first * dx, last * dx) - round_it),
        min(east, x + max(first * dx, last * dx) + round_it),
        max(south, y + min(first * dy, last * dy) - round_it),
        min(north, y + max(first * dy, last * dy) + round_it),
    )


@kernel(outermost=True)
def _extend(
    origin: FloatArray,
    direction: FloatArray,
    west: float,
    east: float,
    south: float,
    north: float,
    floor: float,
    ceiling: float,
    slack: float,
    spread: float,
    needed: FloatArray,
) -> None:
    """Extend a rectangle (4,) by what rays need."""
    for k in range(len(origin)):
        x, y, z = origin[k, 0], origin[k, 1], origin[k, 2]
        dx, dy, dz = direction[k, 0], direction[k, 1], direction[k, 2]
        w, e, s, n = _needed(x, y, z, dx, dy, dz, west, east, south, north, floor, ceiling, slack, spread)
        if w <= e and s <= n:
            needed[0], needed[1] = min(needed[0], w), max(needed[1], e)
            needed[2], needed[3] = min(needed[2], s), max(needed[3], n)
        x, y = min(max(x, west), east), min(max(y, south), north)
        needed[0], needed[1] = min(needed[0], x), max(needed[1], x)
        needed[2], needed[3] = min(needed[2], y), max(needed[3], y)


@kernel(outermost=True)
def _find_strays(
    origin: FloatArray,
    direction: FloatArray,
    west: float,
    east: float,
    south: float,
    north: float,
    floor: float,
    ceiling: float,
    kept_west: float,
    kept_east: float,
    kept_south: float,
    kept_north: float,
    stray: BoolArray,
) -> None:
    for k in range(len(origin)):
        x, y, z = origin[k, 0], origin[k, 1], origin[k, 2]
        dx, dy, dz = direction[k, 0], direction[k, 1], direction[k, 2]
        w, e, s, n = _needed(x, y, z, dx, dy, dz, west, east, south, north, floor, ceiling, 0.0, 0.0)
        within = kept_west <= w and e <= kept_east and kept_south <= s and n <= kept_north
        stray[k] = w <= e and s <= n and not within
