"""Rays onto triangles, in float64, several nearly parallel rays at a time.

The tree is walked once for a bundle of rays: a box is opened where the bundle's hull reaches it, and only the rays that
reach a leaf's own box meet its triangles. The hull of rays from [o0, o1] along [d0, d1] is at t >= 0 within
[o0 + t d0, o1 + t d1] on each axis; for a single ray that is the ray itself.

A triangle is met in two coordinates across the ray, of which each corner has one pair whatever triangle it is seen
from: the areas that an edge spans with the ray are equal and opposite on its two sides, so that a ray at an edge or a
corner is met by one of the triangles there, whatever the rounding (after Woop, Benthin and Wald 2013). Which rays come
in one bundle changes nothing that is found.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.kernels import kernel
from lidar_emu.scene.hits import NOTHING

BUNDLE = 128
"""Most rays of a bundle."""

_APART_M, _ASKEW = 0.5, 2e-3
"""How far rays of a bundle may start apart, and point, along each axis."""

NUMBERS = 17
_X, _Y, _Z, _DX, _DY, _DZ, _RX, _RY, _RZ, _E1X, _E1Y, _E1Z, _E2X, _E2Y, _E2Z, _NEAR, _FOUND = range(NUMBERS)
"""Of a ray: start, direction, one over it, two unit vectors across it, nearest contact, and what it met there."""

_BACK = 1 << 40
"""Added to the number of a triangle that is seen from behind."""

_NONE = 2.0**60
_SLACK = 1.0 + 1e-14
"""By how much a box is taken longer, for the rounding of where a ray leaves it."""


@kernel(outermost=True)
def cast_rays(
    origin: FloatArray,
    direction: FloatArray,
    box: FloatArray,
    first: IntArray,
    count: IntArray,
    corner_m: FloatArray,
    sheet: BoolArray,
    albedo: FloatArray,
    of_thing: NDArray[np.int16],
    rays: FloatArray,
    stack: IntArray,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    thing: NDArray[np.int16],
) -> None:
    """Fill the arrays of `Hits` for n rays.

    Args:
        origin, direction: (n, 3).
        box, first, count: of the `Tree`.
        corner_m: (triangles, 3, 3), in the order of the tree, counter-clockwise from outside.
        sheet: (triangles,) seen from both sides; another one that is seen from behind is the end of a solid.
        albedo, of_thing: (triangles,) what they reflect, and what they belong to.
        rays: (BUNDLE, NUMBERS) room.
        stack: (depth of the tree + 1,) room.
        range_m, normal, inside, reflectance, thing: as in `Hits`.
    """
    start = 0
    while start < origin.shape[0]:
        end = _bundle_end(origin, direction, start)
        if end > start:
            for k in range(start, end):
                _set_ray(origin[k], direction[k], rays[k - start])
            _walk(box, first, count, corner_m, rays[: end - start], stack)
        else:
            rays[0, _FOUND] = _NONE
            end = start + 1
        for k in range(start, end):
            ray = rays[k - start]
            _tell(ray, corner_m, sheet, albedo, of_thing, k, range_m, normal, inside, reflectance, thing)
        start = end


@kernel
def _bundle_end(origin: FloatArray, direction: FloatArray, start: int) -> int:
    """First ray after `start` that does not go with it; `start` itself where that is no ray."""
    length = 0.0
    for axis in range(3):
        length += direction[start, axis] * direction[start, axis] + 0.0 * origin[start, axis]
    if not 0.0 < length < np.inf:
        return start
    end = start + 1
    last = min(start + BUNDLE, origin.shape[0])
    while end < last:
        for axis in range(3):
            apart_m = abs(origin[end, axis] - origin[start, axis])
            askew = abs(direction[end, axis] - direction[start, axis])
            if not (apart_m <= _APART_M and askew <= _ASKEW):
                return end
        end += 1
    return end


@kernel
def _set_ray(origin: FloatArray, direction: FloatArray, ray: FloatArray) -> None:
    x, y, z = direction[0], direction[1], direction[2]
    for axis in range(3):
        ray[_X + axis], ray[_DX + axis], ray[_RX + axis] = (
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
    ray[_NEAR], ray[_FOUND] = np.inf, _NONE


@kernel
def _walk(
    box: FloatArray,
    first: IntArray,
    count: IntArray,
    corner_m: FloatArray,
    rays: FloatArray,
    stack: IntArray,
) -> None:
    """Find the nearest contact of each ray of a bundle."""
    ox0 = ox1 = rays[0, _X]
    oy0 = oy1 = rays[0, _Y]
    oz0 = oz1 = rays[0, _Z]
    dx0 = dx1 = rays[0, _DX]
    dy0 = dy1 = rays[0, _DY]
    dz0 = dz1 = rays[0, _DZ]
    for k in range(1, rays.shape[0]):
        ray = rays[k]
        ox0, ox1 = min(ox0, ray[_X]), max(ox1, ray[_X])
        oy0, oy1 = min(oy0, ray[_Y]), max(oy1, ray[_Y])
        oz0, oz1 = min(oz0, ray[_Z]), max(oz1, ray[_Z])
        dx0, dx1 = min(dx0, ray[_DX]), max(dx1, ray[_DX])
        dy0, dy1 = min(dy0, ray[_DY]), max(dy1, ray[_DY])
        dz0, dz1 = min(dz0, ray[_DZ]), max(dz1, ray[_DZ])
    rx0, ry0, rz0, rx1, ry1, rz1 = 1.0 / dx0, 1.0 / dy0, 1.0 / dz0, 1.0 / dx1, 1.0 / dy1, 1.0 / dz1
    farthest = _farthest(rays)
    node, height = 0, 0
    entry = _entry(box[0], ox0, oy0, oz0, ox1, oy1, oz1, rx0, ry0, rz0, rx1, ry1, rz1)
    if not entry <= farthest:
        return
    while True:
        if count[node] > 0:
            _meet_leaf(box[node], first[node], first[node] + count[node], corner_m, rays)
            farthest = _farthest(rays)
        else:
            left = first[node]
            t_left = _entry(box[left], ox0, oy0, oz0, ox1, oy1, oz1, rx0, ry0, rz0, rx1, ry1, rz1)
            t_right = _entry(box[left + 1], ox0, oy0, oz0, ox1, oy1, oz1, rx0, ry0, rz0, rx1, ry1, rz1)
            if t_left <= farthest and t_right <= farthest:
                nearer = left if t_left <= t_right else left + 1
                stack[height] = 2 * left + 1 - nearer
                height += 1
                node = nearer
                continue
            if t_left <= farthest:
                node = left
                continue
            if t_right <= farthest:
                node = left + 1
                continue
        # Back to a box that was put off, if the rays have not ended before it meanwhile.
        while True:
            if height == 0:
                return
            height -= 1
            node = stack[height]
            if _entry(box[node], ox0, oy0, oz0, ox1, oy1, oz1, rx0, ry0, rz0, rx1, ry1, rz1) <= farthest:
                break


@kernel
def _farthest(rays: FloatArray) -> float:
    """The greatest of the rays' nearest contacts."""
    farthest = rays[0, _NEAR]
    for k in range(1, rays.shape[0]):
        farthest = max(farthest, rays[k, _NEAR])
    return farthest


@kernel(forceinline=True)
def _entry(
    box: FloatArray,
    ox0: float,
    oy0: float,
    oz0: float,
    ox1: float,
    oy1: float,
    oz1: float,
    rx0: float,
    ry0: float,
    rz0: float,
    rx1: float,
    ry1: float,
    rz1: float,
) -> float:
    """t >= 0 at which the hull reaches a box; NaN where it does not. The r are one over the d."""
    near, far = 0.0, np.inf
    near, far = _clip(box[3] - ox0, rx0, near, far)
    near, far = _clip(ox1 - box[0], -rx1, near, far)
    near, far = _clip(box[4] - oy0, ry0, near, far)
    near, far = _clip(oy1 - box[1], -ry1, near, far)
    near, far = _clip(box[5] - oz0, rz0, near, far)
    near, far = _clip(oz1 - box[2], -rz1, near, far)
    reached: float = near if near <= far * _SLACK else np.nan
    return reached


@kernel(forceinline=True)
def _clip(distance: float, per_rate: float, near: float, far: float) -> tuple[float, float]:
    """The t between near and far at which ``rate * t <= distance``."""
    t = distance * per_rate
    # NaN, of a ray along the very face of a box, clips nothing.
    if per_rate > 0.0:
        return near, (t if t < far else far)
    return (t if t > near else near), far


@kernel
def _meet_leaf(box: FloatArray, start: int, end: int, corner_m: FloatArray, rays: FloatArray) -> None:
    """Take the contacts of rays with triangles start ... end-1 where they are nearer than what is known."""
    for k in range(rays.shape[0]):
        ray = rays[k]
        if rays.shape[0] > 1:
            x, y, z = ray[_X], ray[_Y], ray[_Z]
            rx, ry, rz = ray[_RX], ray[_RY], ray[_RZ]
            if not _entry(box, x, y, z, x, y, z, rx, ry, rz, rx, ry, rz) <= ray[_NEAR]:
                continue
        for triangle in range(start, end):
            _meet(corner_m[triangle], triangle, ray)


@kernel(forceinline=True)
def _meet(corner_m: FloatArray, triangle: int, ray: FloatArray) -> None:
    x, y, z = ray[_X], ray[_Y], ray[_Z]
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
    dx, dy, dz = ray[_DX], ray[_DY], ray[_DZ]
    to_a, to_b, to_c = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz, dx * cx + dy * cy + dz * cz
    t = (u * to_a + v * to_b + w * to_c) / area
    if not 0.0 <= t <= ray[_NEAR]:
        return
    # Of triangles at one place that which is seen from before, and of these the first, in whatever order they come.
    found = float(triangle if area > 0.0 else triangle + _BACK)
    if t < ray[_NEAR] or found < ray[_FOUND]:
        ray[_NEAR], ray[_FOUND] = t, found


@kernel
def _tell(
    ray: FloatArray,
    corner_m: FloatArray,
    sheet: BoolArray,
    albedo: FloatArray,
    of_thing: NDArray[np.int16],
    k: int,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    thing: NDArray[np.int16],
) -> None:
    """Set hit k to what a ray has met."""
    inside[k] = False
    range_m[k], reflectance[k], thing[k] = np.nan, np.nan, NOTHING
    normal[k, 0], normal[k, 1], normal[k, 2] = np.nan, np.nan, np.nan
    if ray[_FOUND] == _NONE:
        return
    found = int(ray[_FOUND])
    behind = found >= _BACK
    triangle = found - _BACK if behind else found
    if behind and not sheet[triangle] and ray[_NEAR] > 0.0:
        inside[k] = True
        return
    a, b, c = corner_m[triangle, 0], corner_m[triangle, 1], corner_m[triangle, 2]
    range_m[k], reflectance[k], thing[k] = ray[_NEAR], albedo[triangle], of_thing[triangle]
    x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    length = np.sqrt(x * x + y * y + z * z)
    length = -length if behind and sheet[triangle] else length
    normal[k, 0], normal[k, 1], normal[k, 2] = x / length, y / length, z / length
