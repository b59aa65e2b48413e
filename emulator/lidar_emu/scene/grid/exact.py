"""The slow reference path for a grid: every crossing of every grid line, sorted, and bisection in each interval.

It shares no formula with the fast path: the surface is a weighted mean of four samples, and the height of a ray above
it is divided at its extremum, found from three of its values, and followed to its zero by bracketing.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.plane import PlaneGround
from lidar_emu.scene.ray_hits import GROUND, Hits
from lidar_emu.scene.sphere import SphereGround

if TYPE_CHECKING:
    from lidar_emu.scene.grid.samples import Samples

Beyond = PlaneGround | SphereGround | None
Contact = tuple[float, FloatArray]

_FACE_DEPTH_M = 1e-6
_NO_NORMAL = np.full(3, np.nan)


def cast(
    samples: Samples,
    beyond: Beyond,
    origin_site_m: FloatArray,
    direction_site: FloatArray,
    reflectance: float,
) -> Hits:
    """First contact of n rays, one by one, with the meaning of `Scene.cast`."""
    hits = Hits.none(len(origin_site_m))
    for k, (origin, direction) in enumerate(zip(origin_site_m, direction_site, strict=True)):
        if not np.isfinite([origin, direction]).all():
            continue
        hits.inside[k] = _starts_inside(samples, beyond, origin, direction)
        if not hits.inside[k]:
            hits.range_m[k], hits.normal_site[k] = _first_contact(samples, beyond, origin, direction)
    met = np.isfinite(hits.range_m)
    hits.reflectance[met], hits.object_id[met] = reflectance, GROUND
    return hits


def _starts_inside(samples: Samples, beyond: Beyond, origin: FloatArray, direction: FloatArray) -> bool:
    cell = _cell_at(samples, origin)
    if cell is not None:
        return bool(origin[2] < _height(samples, cell, origin))
    return beyond is not None and bool(beyond.cast_exact(origin[None], direction[None]).inside[0])


def _first_contact(samples: Samples, beyond: Beyond, origin: FloatArray, direction: FloatArray) -> Contact:
    crossings = np.concatenate(
        [
            _crossings(origin[0], direction[0], samples.east_m),
            _crossings(origin[1], direction[1], samples.north_m),
            _diagonal_crossings(samples, origin, direction),
        ]
    )
    edges = np.concatenate([[0.0], np.unique(crossings), [np.inf]])
    for start, end in pairwise(edges):
        inner = start + 1.0 if np.isinf(end) else (start + end) / 2
        cell = _cell_at(samples, origin + inner * direction)
        if cell is None:
            contact = _meet_beyond(samples, beyond, origin, direction, start, end)
        else:
            if np.isinf(end):
                # Straight down or up: nothing follows below the lowest sample.
                end = max(start, (np.nanmin(samples.height_m) - 1.0 - origin[2]) / direction[2])
            contact = _meet_surface(samples, beyond, cell, origin, direction, start, end)
        if contact is not None:
            return contact
    return np.nan, _NO_NORMAL


def _crossings(position: float, rate: float, lines: FloatArray) -> FloatArray:
    """All t > 0 at which a coordinate crosses a grid line."""
    if rate == 0.0:
        return np.empty(0)
    with np.errstate(over="ignore"):
        t = (lines - position) / rate
    return np.asarray(t[(t > 0.0) & np.isfinite(t)])


def _diagonal_crossings(samples: Samples, origin: FloatArray, direction: FloatArray) -> FloatArray:
    """All t > 0 at which a ray crosses the diagonal of a cell, where that is an edge."""
    if samples.interpolation == "bilinear":
        return np.empty(0)
    rows, columns = samples.height_m.shape
    east, north = (
        (origin[0] - samples.west_m) / samples.pixel_east_m,
        (origin[1] - samples.south_m) / samples.pixel_north_m,
    )
    rate = direction[0] / samples.pixel_east_m - direction[1] / samples.pixel_north_m
    return _crossings(east - north, rate, np.arange(1.0 - rows, columns))


def _cell_at(samples: Samples, point: FloatArray) -> tuple[int, int] | None:
    """Cell (i, j) below or above a point; None outside the grid and where a sample is missing."""
    east, north = samples.east_m, samples.north_m
    if not (east[0] <= point[0] <= east[-1] and north[0] <= point[1] <= north[-1]):
        return None
    i = min(int(np.searchsorted(east, point[0], side="right")) - 1, len(east) - 2)
    j = min(int(np.searchsorted(north, point[1], side="right")) - 1, len(north) - 2)
    return None if np.isnan(samples.height_m[j : j + 2, i : i + 2]).any() else (i, j)


def _height(samples: Samples, cell: tuple[int, int], point: FloatArray) -> float:
    i, j = cell
    a = (point[0] - samples.east_m[i]) / samples.pixel_east_m
    b = (point[1] - samples.north_m[j]) / samples.pixel_north_m
    if samples.interpolation == "bilinear":
        weights = np.array([[(1 - a) * (1 - b), a * (1 - b)], [(1 - a) * b, a * b]])
    elif a >= b:
        weights = np.array([[1 - a, a - b], [0.0, b]])
    else:
        weights = np.array([[1 - b, 0.0], [b - a, a]])
    return float((weights * samples.height_m[j : j + 2, i : i + 2]).sum())


def _meet_surface(
    samples: Samples,
    beyond: Beyond,
    cell: tuple[int, int],
    origin: FloatArray,
    direction: FloatArray,
    start: float,
    end: float,
) -> Contact | None:
    def above(t: float) -> float:
        point = origin + t * direction
        return float(point[2]) - _height(samples, cell, point)

    if above(start) < -_FACE_DEPTH_M:
        if beyond is None:
            return np.nan, _NO_NORMAL
        return start, _face(samples, origin + start * direction, direction)
    t = _first_zero(above, start, end)
    return None if t is None else (t, _normal(samples, cell, origin + t * direction))


def _first_zero(above: Callable[[float], float], start: float, end: float) -> float | None:
    """First t in [start, end] at which a parabola is not positive."""
    from scipy.optimize import brentq

    if above(start) <= 0.0:
        return start
    turns = [t for t in (_turning_point(above, start, end),) if start < t < end]
    for low, high in zip([start, *turns], [*turns, end], strict=True):
        if above(high) <= 0.0:
            return float(brentq(above, low, high, xtol=1e-14, rtol=1e-15))
    return None


def _turning_point(above: Callable[[float], float], start: float, end: float) -> float:
    """Vertex of the parabola through three values; NaN for a straight line."""
    first, middle, last = above(start), above((start + end) / 2), above(end)
    curvature = first - 2 * middle + last
    if curvature == 0.0:
        return np.nan
    return start + (end - start) * (0.5 + (first - last) / (4 * curvature))


def _normal(samples: Samples, cell: tuple[int, int], point: FloatArray) -> FloatArray:
    """Normal of the surface from two straight lines in it: edges of a triangle, or the two lines through a point of a
    bilinear patch."""
    i, j = cell
    west, east = samples.east_m[i : i + 2]
    south, north = samples.north_m[j : j + 2]
    x, y = point[:2]
    if samples.interpolation == "triangles":
        southeast = (x - west) * (north - south) >= (y - south) * (east - west)
        x, y = (east, south) if southeast else (west, north)
    ends_m = [(west, y), (east, y), (x, south), (x, north)]
    z = [_height(samples, cell, np.array(end)) for end in ends_m]
    normal = np.cross([east - west, 0.0, z[1] - z[0]], [0.0, north - south, z[3] - z[2]])
    return np.asarray(normal / np.linalg.norm(normal))


def _meet_beyond(
    samples: Samples, beyond: Beyond, origin: FloatArray, direction: FloatArray, start: float, end: float
) -> Contact | None:
    if beyond is None:
        return None
    point = origin + start * direction
    depth = float(beyond.height_m(point[:1], point[1:2])[0] - point[2])
    if depth > _FACE_DEPTH_M:
        return start, _face(samples, point, direction)
    if depth > 0.0:
        # Rounding: the point is on the ground.
        point[2] += depth
    contact = beyond.cast_exact(point[None], direction[None])
    if contact.range_m[0] <= end - start:
        return start + float(contact.range_m[0]), contact.normal_site[0]
    return None


def _face(samples: Samples, point: FloatArray, direction: FloatArray) -> FloatArray:
    """Normal of the upright face at an edge of the grid or of a hole, against the ray."""
    lines_m = (samples.east_m, samples.north_m)
    distance_m = [np.abs(lines_m[axis] - point[axis]).min() if direction[axis] else np.inf for axis in (0, 1)]
    axis = int(np.argmin(distance_m))
    normal = np.zeros(3)
    normal[axis] = -np.sign(direction[axis])
    return normal
