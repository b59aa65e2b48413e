"""Rays onto triangles, in float64, several nearly parallel rays at a time.

The tree is walked once for a bundle of rays: a box is opened where the bundle's hull reaches it, and only the rays that
reach a leaf's own box meet its triangles. The hull of rays from [o0, o1] along [d0, d1] is at t >= 0 within
[o0 + t d0, o1 + t d1] on each axis; for a single ray that is the ray itself.

Which rays come in one bundle changes nothing that is found.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.mesh.ray import (
    DX,
    DY,
    DZ,
    ENTERED,
    LEFT,
    NEAR,
    NONE,
    RX,
    RY,
    RZ,
    X,
    Y,
    Z,
    meet,
    set_ray,
    tell,
)

BUNDLE = 128
"""Most rays of a bundle."""

_APART_M, _ASKEW = 0.5, 2e-3
"""How far rays of a bundle may start apart, and point, along each axis."""

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
    owner: NDArray[np.int16],
    rays: FloatArray,
    stack: IntArray,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    object_id: NDArray[np.int16],
) -> None:
    """Fill the arrays of `Hits` for n rays.

    Args:
        origin, direction: (n, 3).
        box, first, count: of the `BoxTree`.
        corner_m: (triangles, 3, 3), in the order of the tree, counter-clockwise from outside.
        sheet: (triangles,) seen from both sides; another one that is seen from behind is the end of a solid.
        albedo, owner: (triangles,) what they reflect, and what they belong to.
        rays: (BUNDLE, NUMBERS) room.
        stack: (depth of the tree + 1,) room.
        range_m, normal, inside, reflectance, object_id: as in `Hits`.
    """
    start = 0
    while start < origin.shape[0]:
        end = _bundle_end(origin, direction, start)
        if end > start:
            for k in range(start, end):
                set_ray(origin[k], direction[k], rays[k - start])
            _walk(box, first, count, corner_m, sheet, rays[: end - start], stack)
        else:
            rays[0, ENTERED] = rays[0, LEFT] = NONE
            end = start + 1
        for k in range(start, end):
            tell(rays[k - start], corner_m, albedo, owner, k, range_m, normal, inside, reflectance, object_id)
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
def _walk(
    box: FloatArray,
    first: IntArray,
    count: IntArray,
    corner_m: FloatArray,
    sheet: BoolArray,
    rays: FloatArray,
    stack: IntArray,
) -> None:
    """Find the nearest contact of each ray of a bundle."""
    ox0 = ox1 = rays[0, X]
    oy0 = oy1 = rays[0, Y]
    oz0 = oz1 = rays[0, Z]
    dx0 = dx1 = rays[0, DX]
    dy0 = dy1 = rays[0, DY]
    dz0 = dz1 = rays[0, DZ]
    for k in range(1, rays.shape[0]):
        ray = rays[k]
        ox0, ox1 = min(ox0, ray[X]), max(ox1, ray[X])
        oy0, oy1 = min(oy0, ray[Y]), max(oy1, ray[Y])
        oz0, oz1 = min(oz0, ray[Z]), max(oz1, ray[Z])
        dx0, dx1 = min(dx0, ray[DX]), max(dx1, ray[DX])
        dy0, dy1 = min(dy0, ray[DY]), max(dy1, ray[DY])
        dz0, dz1 = min(dz0, ray[DZ]), max(dz1, ray[DZ])
    rx0, ry0, rz0, rx1, ry1, rz1 = 1.0 / dx0, 1.0 / dy0, 1.0 / dz0, 1.0 / dx1, 1.0 / dy1, 1.0 / dz1
    farthest = _farthest(rays)
    node, height = 0, 0
    entry = _entry(box[0], ox0, oy0, oz0, ox1, oy1, oz1, rx0, ry0, rz0, rx1, ry1, rz1)
    if not entry <= farthest:
        return
    while True:
        if count[node] > 0:
            _meet_leaf(box[node], first[node], first[node] + count[node], corner_m, sheet, rays)
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
    farthest: float = rays[0, NEAR]
    for k in range(1, rays.shape[0]):
        farthest = max(farthest, rays[k, NEAR])
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
def _meet_leaf(
    box: FloatArray, start: int, end: int, corner_m: FloatArray, sheet: BoolArray, rays: FloatArray
) -> None:
    """Take the contacts of rays with triangles start ... end-1 where they are nearer than what is known."""
    for k in range(rays.shape[0]):
        ray = rays[k]
        if rays.shape[0] > 1:
            x, y, z = ray[X], ray[Y], ray[Z]
            rx, ry, rz = ray[RX], ray[RY], ray[RZ]
            if not _entry(box, x, y, z, x, y, z, rx, ry, rz, rx, ry, rz) <= ray[NEAR]:
                continue
        for triangle in range(start, end):
            meet(corner_m[triangle], sheet[triangle], triangle, ray)
