"""A ray, its intersection with triangles, and its hit.

A triangle is tested in two coordinates across the ray. Each corner has the same coordinates for every triangle that it
belongs to, so that the signed areas that an edge spans with the ray are equal and opposite on its two sides: a ray at
an edge or a corner hits one of the triangles there, whatever the rounding (after Woop, Benthin and Wald 2013).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.ray_hits import NOTHING

RAY = np.dtype(
    [(name, np.float64) for name in ("x", "y", "z", "dx", "dy", "dz", "rx", "ry", "rz")]
    + [(name, np.float64) for name in ("e1x", "e1y", "e1z", "e2x", "e2y", "e2z")]
    + [(name, np.float64) for name in ("near", "entry", "exit")]
    + [("entered", np.int64), ("left", np.int64)]
)
"""A ray: origin, direction, its reciprocal, two unit vectors across it; t of the nearest contact of any kind, of the
nearest with a front face and of the nearest with a back face of a solid; the triangles of these two."""

TRIANGLE = np.dtype(
    [("corner_m", np.float64, (3, 3)), ("albedo", np.float64), ("object_id", np.int16), ("sheet", np.bool_)],
    align=True,
)
"""A triangle: corners counter-clockwise from outside, reflectance, object, and whether it is seen from both sides; a
triangle of a solid that is seen from behind is where the ray leaves the solid."""

NONE = 2**60
"""Placeholder for no triangle."""
_SAME = 1.0 + 1e-12
"""Tolerance at a corner seen edge-on, where front and back of a solid coincide: the front counts."""


@kernel
def set_ray(origin: FloatArray, direction: FloatArray, ray: Any) -> None:
    """Initialise a ray along a unit vector, without contacts."""
    # -0 becomes 0, whose reciprocal is positive.
    x, y, z = direction[0] + 0.0, direction[1] + 0.0, direction[2] + 0.0
    ray.x, ray.y, ray.z = origin[0], origin[1], origin[2]
    ray.dx, ray.dy, ray.dz = x, y, z
    ray.rx, ray.ry, ray.rz = 1.0 / x, 1.0 / y, 1.0 / z
    # Two perpendicular vectors, defined for every direction (Duff et al. 2017).
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    ray.e1x, ray.e1y, ray.e1z = 1.0 + sign * x * x * a, sign * b, -sign * x
    ray.e2x, ray.e2y, ray.e2z = b, sign + y * y * a, -y
    ray.near = ray.entry = ray.exit = np.inf
    ray.entered = ray.left = NONE


@kernel(forceinline=True)
def meet(triangle: Any, number: int, ray: Any) -> None:
    """Record the contact of a ray with a triangle if it is nearer than the known ones."""
    corner_m = triangle.corner_m
    x, y, z = ray.x, ray.y, ray.z
    ax, ay, az = corner_m[0, 0] - x, corner_m[0, 1] - y, corner_m[0, 2] - z
    bx, by, bz = corner_m[1, 0] - x, corner_m[1, 1] - y, corner_m[1, 2] - z
    cx, cy, cz = corner_m[2, 0] - x, corner_m[2, 1] - y, corner_m[2, 2] - z
    e1x, e1y, e1z = ray.e1x, ray.e1y, ray.e1z
    e2x, e2y, e2z = ray.e2x, ray.e2y, ray.e2z
    a1, a2 = e1x * ax + e1y * ay + e1z * az, e2x * ax + e2y * ay + e2z * az
    b1, b2 = e1x * bx + e1y * by + e1z * bz, e2x * bx + e2y * by + e2z * bz
    c1, c2 = e1x * cx + e1y * cy + e1z * cz, e2x * cx + e2y * cy + e2z * cz
    u, v, w = c1 * b2 - c2 * b1, a1 * c2 - a2 * c1, b1 * a2 - b2 * a1
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return
    area = u + v + w
    if area == 0.0:
        return
    dx, dy, dz = ray.dx, ray.dy, ray.dz
    to_a, to_b, to_c = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz, dx * cx + dy * cy + dz * cz
    t = (u * to_a + v * to_b + w * to_c) / area
    if not t >= 0.0:
        return
    # At equal ranges the lowest number counts, in whatever order the triangles come.
    if area > 0.0 or triangle.sheet:
        if t < ray.entry or (t == ray.entry and number < ray.entered):
            ray.entry, ray.entered = t, number
            ray.near = min(ray.near, t)
    elif t < ray.exit or (t == ray.exit and number < ray.left):
        ray.exit, ray.left = t, number
        ray.near = min(ray.near, t)


@kernel
def set_hit(
    ray: Any,
    triangles: NDArray[np.void],
    k: int,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    object_id: NDArray[np.int16],
) -> None:
    """Set hit k from the contacts of a ray."""
    inside[k] = False
    range_m[k], reflectance[k], object_id[k] = np.nan, np.nan, NOTHING
    normal[k, 0], normal[k, 1], normal[k, 2] = np.nan, np.nan, np.nan
    enters = ray.entered < NONE and ray.entry <= ray.exit * _SAME
    if not enters and ray.left == NONE:
        return
    if not enters and ray.exit > 0.0:
        inside[k] = True
        return
    triangle = triangles[ray.entered if enters else ray.left]
    corner_m = triangle.corner_m
    range_m[k] = ray.entry if enters else 0.0
    reflectance[k], object_id[k] = triangle.albedo, triangle.object_id
    a, b, c = corner_m[0], corner_m[1], corner_m[2]
    x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    length = np.sqrt(x * x + y * y + z * z)
    if enters and x * ray.dx + y * ray.dy + z * ray.dz > 0.0:
        # The back of a sheet.
        length = -length
    normal[k, 0], normal[k, 1], normal[k, 2] = x / length, y / length, z / length
