"""A ray, the triangles that it meets, and what is told of that.

A triangle is met in two coordinates across the ray, of which each corner has one pair whatever triangle it is seen
from: the areas that an edge spans with the ray are equal and opposite on its two sides, so that a ray at an edge or a
corner is met by one of the triangles there, whatever the rounding (after Woop, Benthin and Wald 2013).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.ray_hits import NOTHING

NUMBERS = 20
X, Y, Z, DX, DY, DZ, RX, RY, RZ, _E1X, _E1Y, _E1Z, _E2X, _E2Y, _E2Z = range(15)
NEAR, _ENTRY, ENTERED, _EXIT, LEFT = range(15, NUMBERS)
"""Of a ray: start, direction, one over it, two unit vectors across it; the nearest contact of any kind, the nearest
with a surface and its triangle, the nearest with the end of a solid and its triangle."""

NONE = 2.0**60
_SAME = 1.0 + 1e-12
"""At a corner seen edge-on the near and the far side of a solid are at one place: it is the near one that is seen."""


@kernel
def set_ray(origin: FloatArray, direction: FloatArray, ray: FloatArray) -> None:
    """Begin a ray along a unit vector: it has met nothing yet."""
    x, y, z = direction[0], direction[1], direction[2]
    for axis in range(3):
        ray[X + axis], ray[DX + axis], ray[RX + axis] = (
            origin[axis],
            direction[axis],
            1.0 / direction[axis],
        )
    # Two vectors across without a case in which they vanish (Duff et al. 2017).
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    ray[_E1X], ray[_E1Y], ray[_E1Z] = 1.0 + sign * x * x * a, sign * b, -sign * x
    ray[_E2X], ray[_E2Y], ray[_E2Z] = b, sign + y * y * a, -y
    ray[NEAR] = ray[_ENTRY] = ray[_EXIT] = np.inf
    ray[ENTERED] = ray[LEFT] = NONE


@kernel(forceinline=True)
def meet(corner_m: FloatArray, sheet: bool, triangle: int, ray: FloatArray) -> None:
    """Note where a ray meets a triangle, if that is nearer than what it has met."""
    x, y, z = ray[X], ray[Y], ray[Z]
    ax, ay, az = corner_m[0, 0] - x, corner_m[0, 1] - y, corner_m[0, 2] - z
    bx, by, bz = corner_m[1, 0] - x, corner_m[1, 1] - y, corner_m[1, 2] - z
    cx, cy, cz = corner_m[2, 0] - x, corner_m[2, 1] - y, corner_m[2, 2] - z
    e1x, e1y, e1z = ray[_E1X], ray[_E1Y], ray[_E1Z]
    e2x, e2y, e2z = ray[_E2X], ray[_E2Y], ray[_E2Z]
    a1, a2 = e1x * ax + e1y * ay + e1z * az, e2x * ax + e2y * ay + e2z * az
    b1, b2 = e1x * bx + e1y * by + e1z * bz, e2x * bx + e2y * by + e2z * bz
    c1, c2 = e1x * cx + e1y * cy + e1z * cz, e2x * cx + e2y * cy + e2z * cz
    u, v, w = c1 * b2 - c2 * b1, a1 * c2 - a2 * c1, b1 * a2 - b2 * a1
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return
    area = u + v + w
    if area == 0.0:
        return
    dx, dy, dz = ray[DX], ray[DY], ray[DZ]
    to_a, to_b, to_c = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz, dx * cx + dy * cy + dz * cz
    t = (u * to_a + v * to_b + w * to_c) / area
    if not t >= 0.0:
        return
    nearest, found = (_ENTRY, ENTERED) if area > 0.0 or sheet else (_EXIT, LEFT)
    # Of several at one place it is the first, in whatever order they come.
    if t < ray[nearest] or (t == ray[nearest] and triangle < ray[found]):
        ray[nearest], ray[found] = t, triangle
        ray[NEAR] = min(ray[NEAR], t)


@kernel
def tell(
    ray: FloatArray,
    corner_m: FloatArray,
    albedo: FloatArray,
    owner: NDArray[np.int16],
    k: int,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    object_id: NDArray[np.int16],
) -> None:
    """Set hit k to what a ray has met."""
    inside[k] = False
    range_m[k], reflectance[k], object_id[k] = np.nan, np.nan, NOTHING
    normal[k, 0], normal[k, 1], normal[k, 2] = np.nan, np.nan, np.nan
    enters = ray[ENTERED] < NONE and ray[_ENTRY] <= ray[_EXIT] * _SAME
    if not enters and ray[LEFT] == NONE:
        return
    if not enters and ray[_EXIT] > 0.0:
        inside[k] = True
        return
    triangle = int(ray[ENTERED] if enters else ray[LEFT])
    range_m[k] = ray[_ENTRY] if enters else 0.0
    reflectance[k], object_id[k] = albedo[triangle], owner[triangle]
    a, b, c = corner_m[triangle, 0], corner_m[triangle, 1], corner_m[triangle, 2]
    x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    length = np.sqrt(x * x + y * y + z * z)
    if enters and x * ray[DX] + y * ray[DY] + z * ray[DZ] > 0.0:
        # The other side of a sheet.
        length = -length
    normal[k, 0], normal[k, 1], normal[k, 2] = x / length, y / length, z / length
