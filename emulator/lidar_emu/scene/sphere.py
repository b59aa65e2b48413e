"""The body's sphere in the site frame.

All formulas are relative to the top of the sphere, never to its centre, so that the distance to the surface is a small
quantity and not the difference of two body radii.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.ray_hits import GROUND, NOTHING, Hits, contiguous


@kernel(forceinline=True)
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
def _cast(
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


class SphereGround:
    """The body's sphere, horizontal at the origin of the site frame.

    Args:
        radius_m: radius of the body's reference sphere.
        origin_altitude_m: height of the origin above it.
        reflectance: albedo.
    """

    def __init__(self, radius_m: float, origin_altitude_m: float, reflectance: float = 1.0) -> None:
        self.radius_m = radius_m
        self.reflectance = reflectance
        self.origin_altitude_m = origin_altitude_m
        self.description = f"sphere, radius {radius_m / 1e3:.10g} km"

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,  # noqa: ARG002
    ) -> Hits:
        origin, direction = contiguous(origin_site_m, direction_site)
        hits = hits or Hits.empty(len(origin))
        _cast(
            origin,
            direction,
            self.radius_m,
            self.origin_altitude_m,
            self.reflectance,
            *hits.on_static_ground,
        )
        return hits

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """(n,) z of the upper half of the sphere; NaN beside it."""
        square = np.square(east_m, dtype=np.float64) + np.square(north_m, dtype=np.float64)
        square = np.where(square <= self.radius_m**2, square, np.nan)
        sagitta = square / (self.radius_m + np.sqrt(self.radius_m**2 - square))
        return np.asarray(-self.origin_altitude_m - sagitta, dtype=np.float64)

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        return np.isfinite(self.height_m(east_m, north_m))
