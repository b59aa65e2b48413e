"""Area of the map that rays can reach, for any ground between a lowest and a highest height."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import Vector, vector_at
from lidar_emu.scene.ray_hits import Hits, RayCaster, Scene


class Rectangle(NamedTuple):
    """A rectangle of the map, edges included, in metres of the site frame."""

    west_m: float
    east_m: float
    south_m: float
    north_m: float

    def holds(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """Whether points lie in the rectangle, (n,)."""
        across = (self.west_m <= east_m) & (east_m <= self.east_m)
        return np.asarray(across & (self.south_m <= north_m) & (north_m <= self.north_m))


Lines = tuple[FloatArray, FloatArray]
"""Origins and unit directions (n, 3) of rays."""

NOWHERE = (np.inf, -np.inf, np.inf, -np.inf)


class Span(NamedTuple):
    """Bounds of a ground: an area of the map, and the lowest and highest height."""

    area: Rectangle
    floor_m: float
    ceiling_m: float


class Reach:
    """The rays of a whole run.

    Args:
        lines: axes of all beams that may be cast, block by block.
        slack_rad: maximum angle between a beamlet and its axis.
        spread_m: maximum distance between their origins.
    """

    def __init__(self, lines: Callable[[], Iterator[Lines]], slack_rad: float, spread_m: float) -> None:
        self._lines, self._slack_rad, self._spread_m = lines, slack_rad, spread_m

    def over(self, span: Span, below_m: float = np.inf) -> Rectangle:
        """Part of an area that contains all positions of rays between floor and ceiling, and the nearest position of
        the area to each ray's origin; empty if there is none.

        Args:
            span: bounds of the ground.
            below_m: only rays that start below this height count.
        """
        needed = np.array(NOWHERE)
        for origin, direction in self._lines():
            low = origin[:, 2] < below_m
            _extend(origin[low], direction[low], as_record(span), self._slack_rad, self._spread_m, needed)
        return Rectangle(*needed.tolist())


def strays(
    origin_site_m: FloatArray, direction_site: FloatArray, parts: Sequence[tuple[Span, Rectangle]]
) -> BoolArray | None:
    """Whether rays may need more of the grounds in these spans than the kept parts, (n,); None if no ray does."""
    stray, is_any = np.empty(len(origin_site_m), dtype=np.bool_), False
    for number, (span, kept) in enumerate(parts):
        is_any = _find_strays(
            origin_site_m, direction_site, as_record(span), as_record(kept), number > 0, stray
        )
    return stray if is_any else None


@kernel
def _needed(
    start: Vector, way: Vector, span: Span, slack: float, spread: float
) -> tuple[float, float, float, float]:
    """Part of an area over which a ray, rotated and displaced by up to these limits, is between floor and ceiling.

    After t a rotated ray is within spread + t slack of the given one, in every direction. It reaches the ceiling at the
    earliest with a descent rate increased by slack, and the floor at the latest with a rate decreased by slack. A ray
    that may not descend ends where it rises through the ceiling or leaves the area.
    """
    (x, y, z), (dx, dy, dz) = start, way
    west, east, south, north = span.area.west_m, span.area.east_m, span.area.south_m, span.area.north_m
    if not np.isfinite(x + y + z + dx + dy + dz):
        return np.inf, -np.inf, np.inf, -np.inf
    above = z - spread - span.ceiling_m
    first = 0.0
    if above > 0.0:
        first = above / (slack - dz) if slack > dz else np.inf
    away = np.hypot(max(abs(x - west), abs(x - east)), max(abs(y - south), abs(y - north))) + spread
    level = np.hypot(dx, dy) - slack
    last = away / level if level > 0.0 else np.inf
    if -dz > slack:
        last = min(last, max(z + spread - span.floor_m, 0.0) / (-dz - slack))
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
    spans: NDArray[np.void],
    slack: float,
    spread: float,
    needed: FloatArray,
) -> None:
    """Extend a rectangle (4,) to the area that rays need of the ground in a span, the record of a `Span`."""
    span = spans[0]
    area = span.area
    for k in range(len(origin)):
        start = vector_at(origin[k], 0)
        w, e, s, n = _needed(start, vector_at(direction[k], 0), span, slack, spread)
        if w <= e and s <= n:
            needed[0], needed[1] = min(needed[0], w), max(needed[1], e)
            needed[2], needed[3] = min(needed[2], s), max(needed[3], n)
        x, y = min(max(start[0], area.west_m), area.east_m), min(max(start[1], area.south_m), area.north_m)
        needed[0], needed[1] = min(needed[0], x), max(needed[1], x)
        needed[2], needed[3] = min(needed[2], y), max(needed[3], y)


@kernel(outermost=True)
def _find_strays(
    origin: FloatArray,
    direction: FloatArray,
    spans: NDArray[np.void],
    areas: NDArray[np.void],
    adds: bool,
    stray: BoolArray,
) -> bool:
    """Fill `stray` (n,), or add to it: whether rays may need more of the ground in a span than the kept area.

    Returns:
        Whether any ray is in `stray`.
    """
    kept, is_any = areas[0], False
    for k in range(len(origin)):
        w, e, s, n = _needed(vector_at(origin[k], 0), vector_at(direction[k], 0), spans[0], 0.0, 0.0)
        within = kept.west_m <= w and e <= kept.east_m and kept.south_m <= s and n <= kept.north_m
        stray[k] = (w <= e and s <= n and not within) or (adds and stray[k])
        is_any = is_any or stray[k]
    return bool(is_any)


class CroppedGrid(NamedTuple):
    """The part of one grid that is in memory."""

    span: Span
    """Extent of the whole grid, with heights that bound all grids of the ground."""
    area: Rectangle
    """Area of that part."""
    samples: int
    """Samples of the whole grid."""
    retained: int
    """Samples of that part."""


class CroppedGround(RayCaster):
    """A ground cut to what a run can reach.

    The rays of a run are known in advance, except with faults injected in flight and in other uses of the scene. Each
    ray is therefore checked: a ray that may need more than that part is cast onto the whole ground, which is built
    on first use. The hits equal those on the whole ground.

    Args:
        cropped: the cropped ground.
        grids: the part of each grid in memory.
        build_whole: builds the whole ground.
    """

    def __init__(
        self, cropped: Scene, grids: tuple[CroppedGrid, ...], build_whole: Callable[[], Scene]
    ) -> None:
        self.cropped, self.grids = cropped, grids
        self.description = cropped.description
        self.origin_altitude_m = cropped.origin_altitude_m
        self._build_whole = build_whole
        self._parts = [(grid.span, grid.area) for grid in grids]
        self.by_kernels = getattr(cropped, "by_kernels", False)

    @cached_property
    def whole(self) -> Scene:
        """The ground before cropping."""
        return self._build_whole()

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, bundle: int) -> None:
        self.cropped.cast(origin, direction, hits, bundle)
        stray = strays(origin, direction, self._parts)
        if stray is not None:
            hits.set_rows(np.flatnonzero(stray), self.whole.cast(origin[stray], direction[stray]))

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        cut_away = self._cut_away(east_m, north_m)
        kept_m = self.cropped.height_m(east_m, north_m)
        return np.where(cut_away, self.whole.height_m(east_m, north_m), kept_m) if cut_away.any() else kept_m

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        return self.cropped.covers(east_m, north_m) | self._cut_away(east_m, north_m)

    def _cut_away(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        cut = np.zeros(np.shape(east_m), dtype=np.bool_)
        for grid in self.grids:
            cut |= grid.span.area.holds(east_m, north_m) & ~grid.area.holds(east_m, north_m)
        return cut
