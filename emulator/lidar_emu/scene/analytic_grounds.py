"""A plane and the body's sphere as ground.

All formulas are relative to the top of the sphere, never to its centre, so that the distance to the surface is a small
quantity and not the difference of two body radii.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.ray_hits import GROUND, NOTHING, Hits, RayCaster


@kernel
def plane_stretch(height: float, climb: float) -> tuple[float, float]:
    """First and last t of the interval in which ``height + t * climb <= 0``; (inf, -inf) if there is none."""
    if climb < 0.0:
        return -height / climb, np.inf
    if climb > 0.0:
        return -np.inf, -height / climb
    if height < 0.0:
        return -np.inf, np.inf
    if height == 0.0:
        return 0.0, np.inf
    return np.inf, -np.inf


@kernel(outermost=True)
def _cast_on_plane(
    origin: FloatArray,
    direction: FloatArray,
    plane_normal: FloatArray,
    albedo: float,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    object_id: NDArray[np.int16],
) -> None:
    a, b, c = plane_normal
    for k in range(origin.shape[0]):
        height = a * origin[k, 0] + b * origin[k, 1] + c * origin[k, 2]
        climb = a * direction[k, 0] + b * direction[k, 1] + c * direction[k, 2]
        enter, leave = plane_stretch(height, climb)
        inside[k] = enter < 0.0 < leave
        hit = not inside[k] and enter <= leave and leave >= 0.0
        range_m[k] = max(enter, 0.0) if hit else np.nan
        reflectance[k] = albedo if hit else np.nan
        object_id[k] = GROUND if hit else NOTHING
        for axis in range(3):
            normal[k, axis] = plane_normal[axis] if hit else np.nan


class PlaneGround(RayCaster):
    """A plane of any slope below the vertical.

    Args:
        slope_rad: inclination.
        downhill_azimuth_rad: direction in which it falls, clockwise from north.
        origin_altitude_m: height of the origin above the body's sphere.
        reflectance: albedo.
    """

    by_kernels = True

    def __init__(
        self,
        slope_rad: float,
        downhill_azimuth_rad: float,
        origin_altitude_m: float,
        reflectance: float = 1.0,
    ) -> None:
        self.origin_altitude_m = origin_altitude_m
        self.reflectance = reflectance
        self.normal_site = np.array(
            [
                math.sin(slope_rad) * math.sin(downhill_azimuth_rad),
                math.sin(slope_rad) * math.cos(downhill_azimuth_rad),
                math.cos(slope_rad),
            ]
        )
        self.description = "level plane"
        if slope_rad:
            slope_deg, azimuth_deg = math.degrees(slope_rad), math.degrees(downhill_azimuth_rad)
            self.description = f"plane, falling {slope_deg:g}° toward azimuth {azimuth_deg:g}°"

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, _bundle: int) -> None:
        _cast_on_plane(origin, direction, self.normal_site, self.reflectance, *hits.on_static_ground)

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        a, b, c = self.normal_site.tolist()
        return np.asarray(-(a * np.asarray(east_m) + b * np.asarray(north_m)) / c, dtype=np.float64)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        return np.ones(np.broadcast(east_m, north_m).shape, dtype=np.bool_)


@kernel
def sphere_stretch(
    x: float, y: float, above: float, dx: float, dy: float, dz: float, radius: float
) -> tuple[float, float]:
    """First and last t of a line inside the sphere; (inf, -inf) if there is none.

    The line starts at x, y and height ``above`` the top of the sphere; (dx, dy, dz) is a unit vector. Points in the
    sphere satisfy t² + 2 b t + power <= 0, where power = |o - centre|² - R² is computed without subtracting radii, and
    the roots without subtracting b from itself.
    """
    power = x * x + y * y + above * (above + 2.0 * radius)
    b = x * dx + y * dy + above * dz + radius * dz
    discriminant = b * b - power
    if not discriminant >= 0.0:
        return np.inf, -np.inf
    if b < 0.0:
        far = -b + np.sqrt(discriminant)
        return power / far, far
    near = -b - np.sqrt(discriminant)
    return near, power / near if near != 0.0 else 0.0


@kernel(outermost=True)
def _cast_on_sphere(
    origin: FloatArray,
    direction: FloatArray,
    radius: float,
    drop: float,
    albedo: float,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    object_id: NDArray[np.int16],
) -> None:
    for k in range(origin.shape[0]):
        x, y, above = origin[k, 0], origin[k, 1], origin[k, 2] + drop
        dx, dy, dz = direction[k, 0], direction[k, 1], direction[k, 2]
        enter, leave = sphere_stretch(x, y, above, dx, dy, dz, radius)
        inside[k] = enter < 0.0 < leave
        hit = not inside[k] and enter <= leave and leave >= 0.0
        t = max(enter, 0.0) if hit else np.nan
        range_m[k] = t
        reflectance[k] = albedo if hit else np.nan
        object_id[k] = GROUND if hit else NOTHING
        normal[k, 0] = (x + t * dx) / radius
        normal[k, 1] = (y + t * dy) / radius
        normal[k, 2] = 1.0 + (above + t * dz) / radius


class SphereGround(RayCaster):
    """The body's sphere, horizontal at the origin of the site frame.

    Args:
        radius_m: radius of the body's reference sphere.
        origin_altitude_m: height of the origin above it.
        reflectance: albedo.
    """

    by_kernels = True

    def __init__(self, radius_m: float, origin_altitude_m: float, reflectance: float = 1.0) -> None:
        self.radius_m = radius_m
        self.reflectance = reflectance
        self.origin_altitude_m = origin_altitude_m
        self.description = f"sphere, radius {radius_m / 1e3:.10g} km"

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, _bundle: int) -> None:
        drop_m, static = self.origin_altitude_m, hits.on_static_ground
        _cast_on_sphere(origin, direction, self.radius_m, drop_m, self.reflectance, *static)

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """(n,) z of the upper half of the sphere; NaN beside it."""
        square = np.square(east_m, dtype=np.float64) + np.square(north_m, dtype=np.float64)
        square = np.where(square <= self.radius_m**2, square, np.nan)
        sagitta = square / (self.radius_m + np.sqrt(self.radius_m**2 - square))
        return np.asarray(-self.origin_altitude_m - sagitta, dtype=np.float64)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        return np.isfinite(self.height_m(east_m, north_m))
