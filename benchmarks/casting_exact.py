"""Exact ranges in rational arithmetic, and the axes of the body."""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.grid.cell import Samples

Point = list[Fraction]


class SiteFrame(NamedTuple):
    """Position of the site on the body: x = fixed_from_site x_site + origin_m, in float64 throughout."""

    fixed_from_site: FloatArray
    origin_m: FloatArray

    def to_fixed(self, site: FloatArray, is_point: bool = True) -> FloatArray:
        """Points or directions (n, 3) in the body's axes."""
        turned = (self.fixed_from_site * site[:, None, :]).sum(axis=2)
        return np.asarray(turned + self.origin_m if is_point else turned)

    def to_site(self, fixed: FloatArray, is_point: bool = True) -> FloatArray:
        """Points or directions (n, 3) in the site's axes: the origin is subtracted first, without loss."""
        moved = fixed - self.origin_m if is_point else fixed
        return np.asarray((self.fixed_from_site.T * moved[:, None, :]).sum(axis=2))

    def exactly_to_site(self, fixed: FloatArray, is_point: bool = True) -> Point:
        """One point or direction (3,) in fractions."""
        moved = [Fraction(v) for v in fixed.tolist()]
        if is_point:
            moved = _less(moved, [Fraction(v) for v in self.origin_m.tolist()])
        return [_dot([Fraction(c) for c in column], moved) for column in self.fixed_from_site.T.tolist()]


def lunar_site(latitude_rad: float, longitude_rad: float, radius_m: float) -> SiteFrame:
    """East, north and up at a place of a sphere."""
    sin_lat, cos_lat = np.sin(latitude_rad), np.cos(latitude_rad)
    sin_lon, cos_lon = np.sin(longitude_rad), np.cos(longitude_rad)
    up = np.array([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat])
    east, north = (
        np.array([-sin_lon, cos_lon, 0.0]),
        np.array([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]),
    )
    return SiteFrame(np.stack([east, north, up], axis=1), radius_m * up)


def exact_range_m(samples: Samples, origin: Point, direction: Point, near_m: float) -> Fraction | None:
    """Least t at which a ray hits one of the triangles of the nine cells around its position at `near_m`.

    Independent of the caster: each triangle is a plane and three sides, in rational arithmetic.
    """
    west, south, east_m, north_m = (
        Fraction(v) for v in (samples.west_m, samples.south_m, samples.pixel_east_m, samples.pixel_north_m)
    )
    around = Fraction(near_m)
    i = int((origin[0] + around * direction[0] - west) / east_m)
    j = int((origin[1] + around * direction[1] - south) / north_m)
    found = []
    for row in range(j - 1, j + 2):
        for column in range(i - 1, i + 2):
            corner = {
                (a, b): [west + (column + a) * east_m, south + (row + b) * north_m,
                         Fraction(float(samples.height_m[row + b, column + a]))]
                for a in (0, 1) for b in (0, 1)
            }  # fmt: skip
            for third in ((1, 0), (0, 1)):
                t = _meet_triangle(origin, direction, corner[0, 0], corner[1, 1], corner[third])
                if t is not None:
                    found.append(t)
    return min(found, default=None)


def _meet_triangle(origin: Point, direction: Point, a: Point, b: Point, c: Point) -> Fraction | None:
    first, second, start = _less(b, a), _less(c, a), _less(origin, a)
    across = _cross(direction, second)
    volume = _dot(first, across)
    if volume == 0:
        return None
    turned = _cross(start, first)
    u, v = _dot(start, across) / volume, _dot(direction, turned) / volume
    t = _dot(second, turned) / volume
    return t if u >= 0 and v >= 0 and u + v <= 1 and t >= 0 else None


def _less(p: Point, q: Point) -> Point:
    return [a - b for a, b in zip(p, q, strict=True)]


def _dot(p: Point, q: Point) -> Fraction:
    return sum((a * b for a, b in zip(p, q, strict=True)), Fraction(0))


def _cross(p: Point, q: Point) -> Point:
    return [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
