"""Casting of rays onto triangles, in float64, several nearly parallel rays at a time.

The tree is traversed once for a bundle of rays: a box is opened where the bundle's hull reaches it, and only rays that
reach a leaf's own box are tested against its triangles. At t >= 0 the hull of rays from [o0, o1] along [d0, d1] lies
within [o0 + t d0, o1 + t d1] on each axis; for a single ray it is the ray itself.

Hits do not depend on the division into bundles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import Vector
from lidar_emu.scene.mesh.ray import NONE, meet, set_hit, set_ray

BUNDLE = 128
"""Maximum number of rays in a bundle."""

_APART_M, _ASKEW = 0.5, 2e-3
"""Maximum spread of the origins and of the directions of a bundle's rays, along each axis."""

_SLACK = 1.0 + 1e-14
"""Margin of a box for the rounding of the point at which a ray leaves it."""


class _Hull(NamedTuple):
    """Bounds of a bundle's rays: minimum and maximum origin, and reciprocals of the minimum and maximum direction."""

    start: Vector
    far_start: Vector
    per_rate: Vector
    far_per_rate: Vector


@kernel(outermost=True)
def cast_rays(
    origin: FloatArray,
    direction: FloatArray,
    boxes: NDArray[np.void],
    triangles: NDArray[np.void],
    rays: NDArray[np.void],
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
        boxes: see `BoxTree`.
        triangles: records of `TRIANGLE` in the order of the tree.
        rays: (BUNDLE,) records of `RAY`, overwritten.
        stack: (depth of the tree + 1,) overwritten.
        range_m, normal, inside, reflectance, object_id: see `Hits`.
    """
    start = 0
    while start < origin.shape[0]:
        end = _bundle_end(origin, direction, start)
        if end > start:
            for k in range(start, end):
                set_ray(origin[k], direction[k], rays[k - start])
            _walk(boxes, triangles, rays[: end - start], stack)
        else:
            rays[0].entered = rays[0].left = NONE
            end = start + 1
        for k in range(start, end):
            set_hit(rays[k - start], triangles, k, range_m, normal, inside, reflectance, object_id)
        start = end


@kernel
def _bundle_end(origin: FloatArray, direction: FloatArray, start: int) -> int:
    """First ray after `start` that is not part of the same bundle; `start` itself if it has NaN."""
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
def _hull(rays: NDArray[np.void]) -> _Hull:
    first = rays[0]
    ox0, oy0, oz0 = ox1, oy1, oz1 = first.x, first.y, first.z
    dx0, dy0, dz0 = dx1, dy1, dz1 = first.dx, first.dy, first.dz
    for k in range(1, rays.shape[0]):
        ray = rays[k]
        ox0, ox1 = min(ox0, ray.x), max(ox1, ray.x)
        oy0, oy1 = min(oy0, ray.y), max(oy1, ray.y)
        oz0, oz1 = min(oz0, ray.z), max(oz1, ray.z)
        dx0, dx1 = min(dx0, ray.dx), max(dx1, ray.dx)
        dy0, dy1 = min(dy0, ray.dy), max(dy1, ray.dy)
        dz0, dz1 = min(dz0, ray.dz), max(dz1, ray.dz)
    return _Hull(
        (ox0, oy0, oz0),
        (ox1, oy1, oz1),
        (1.0 / dx0, 1.0 / dy0, 1.0 / dz0),
        (1.0 / dx1, 1.0 / dy1, 1.0 / dz1),
    )


@kernel
def _walk(
    boxes: NDArray[np.void], triangles: NDArray[np.void], rays: NDArray[np.void], stack: IntArray
) -> None:
    """Find the nearest hit of each ray of a bundle."""
    hull = _hull(rays)
    farthest = _farthest(rays)
    node, height = 0, 0
    if not _entry(boxes[0], hull) <= farthest:
        return
    while True:
        if boxes[node].held > 0:
            _meet_leaf(boxes[node], triangles, rays)
            farthest = _farthest(rays)
        else:
            left = boxes[node].first
            t_left, t_right = _entry(boxes[left], hull), _entry(boxes[left + 1], hull)
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
        # Return to a deferred box, unless the rays have ended before it meanwhile.
        while True:
            if height == 0:
                return
            height -= 1
            node = stack[height]
            if _entry(boxes[node], hull) <= farthest:
                break


@kernel
def _farthest(rays: NDArray[np.void]) -> float:
    """Greatest of the rays' nearest hits."""
    farthest: float = rays[0].near
    for k in range(1, rays.shape[0]):
        farthest = max(farthest, rays[k].near)
    return farthest


@kernel(forceinline=True)
def _entry(box: Any, hull: _Hull) -> float:
    """Parameter t >= 0 at which the hull reaches a box; NaN if it does not."""
    low, high = box.low_m, box.high_m
    (ox0, oy0, oz0), (ox1, oy1, oz1), (rx0, ry0, rz0), (rx1, ry1, rz1) = hull
    near, far = 0.0, np.inf
    near, far = _clip(high[0] - ox0, rx0, near, far)
    near, far = _clip(ox1 - low[0], -rx1, near, far)
    near, far = _clip(high[1] - oy0, ry0, near, far)
    near, far = _clip(oy1 - low[1], -ry1, near, far)
    near, far = _clip(high[2] - oz0, rz0, near, far)
    near, far = _clip(oz1 - low[2], -rz1, near, far)
    reached: float = near if near <= far * _SLACK else np.nan
    return reached


@kernel(forceinline=True)
def _clip(distance: float, per_rate: float, near: float, far: float) -> tuple[float, float]:
    """Part of [near, far] in which ``rate * t <= distance``."""
    t = distance * per_rate
    # NaN, for a ray along the face of a box, limits nothing.
    if per_rate > 0.0:
        return near, (t if t < far else far)
    return (t if t > near else near), far


@kernel
def _meet_leaf(box: Any, triangles: NDArray[np.void], rays: NDArray[np.void]) -> None:
    """Update rays with their hits on a leaf's triangles where these are nearer than the known ones."""
    for k in range(rays.shape[0]):
        ray = rays[k]
        if rays.shape[0] > 1:
            start, per_rate = (ray.x, ray.y, ray.z), (ray.rx, ray.ry, ray.rz)
            if not _entry(box, _Hull(start, start, per_rate, per_rate)) <= ray.near:
                continue
        for number in range(box.first, box.first + box.held):
            meet(triangles[number], number, ray)
