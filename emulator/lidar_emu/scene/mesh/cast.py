"""Casting of rays onto triangles, in float64, several nearly parallel rays at a time.

The tree is traversed once for a bundle of rays: a box is opened where the bundle's hull reaches it, and only rays that
reach a leaf's own box are tested against its triangles. At t >= 0 the hull of rays from [o0, o1] along [d0, d1] lies
within [o0 + t d0, o1 + t d1] on each axis; for a single ray it is the ray itself. It reaches a box [low, high] where

    o0 + t d0 <= high and o1 + t d1 >= low,

bounds of t from below or from above, by the signs of d0 and d1.

Hits do not depend on the division into bundles.

A triangle is tested in two coordinates across the ray. Each corner has the same coordinates for every triangle that it
belongs to, so that the signed areas that an edge spans with the ray are equal and opposite on its two sides: a ray at
an edge or a corner hits one of the triangles there, whatever the rounding (after Woop, Benthin and Wald 2013).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scene.mesh.tree import WIDTH
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


@kernel
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


BUNDLE = 128
"""Maximum number of rays in a bundle."""

DEFERRED = np.dtype([("box", np.int64), ("reached", np.float64)])
"""A box to be visited, WIDTH times its node plus its place there, and the t at which the bundle reaches it."""

_APART_M, _ASKEW = 0.5, 2e-3
"""Maximum spread of the origins and of the directions of a bundle's rays, along each axis."""

_SLACK = 1.0 + 1e-14
"""Margin of a box for the rounding of the point at which a ray leaves it."""


class _Bound(NamedTuple):
    """A bound of t, (plane - start) * per_rate."""

    plane: int
    """Row of `planes_m` in `NODE`."""
    start: float
    per_rate: float


_FREE = _Bound(0, -np.inf, 0.0)
"""NaN, which limits nothing."""


class _Hull(NamedTuple):
    """Bounds of t between which a bundle's hull is in a box, along x, y and z."""

    least: tuple[_Bound, _Bound, _Bound]
    most: tuple[_Bound, _Bound, _Bound]
    also_least: tuple[_Bound, _Bound, _Bound]
    """Second lower bounds, where directions of both signs occur along an axis."""
    both_ways: bool
    """Whether there are any."""


@kernel(outermost=True)
def cast_rays(
    origin: FloatArray,
    direction: FloatArray,
    nodes: NDArray[np.void],
    triangles: NDArray[np.void],
    rays: NDArray[np.void],
    deferred: NDArray[np.void],
    reached: FloatArray,
    range_m: FloatArray,
    normal: FloatArray,
    inside: BoolArray,
    reflectance: FloatArray,
    object_id: NDArray[np.int16],
) -> None:
    """Fill the arrays of `Hits` for n rays.

    Args:
        origin, direction: (n, 3).
        nodes: see `BoxTree`.
        triangles: records of `TRIANGLE` in the order of the tree.
        rays: (BUNDLE,) records of `RAY`, overwritten.
        deferred: (WIDTH * depth of the tree,) records of `DEFERRED`, overwritten.
        reached: (2, WIDTH) overwritten.
        range_m, normal, inside, reflectance, object_id: see `Hits`.
    """
    start = 0
    while start < origin.shape[0]:
        end = _bundle_end(origin, direction, start)
        if end > start:
            for k in range(start, end):
                set_ray(origin[k], direction[k], rays[k - start])
            _walk(nodes, triangles, rays[: end - start], deferred, reached)
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
    x, y, z = (
        _bounds(0, ox0, ox1, 1.0 / dx0, 1.0 / dx1),
        _bounds(1, oy0, oy1, 1.0 / dy0, 1.0 / dy1),
        _bounds(2, oz0, oz1, 1.0 / dz0, 1.0 / dz1),
    )
    return _Hull((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2]), x[3] or y[3] or z[3])


@kernel
def _bounds(
    axis: int, start: float, far_start: float, per_rate: float, far_per_rate: float
) -> tuple[_Bound, _Bound, _Bound, bool]:
    """Bounds of t along one axis, by minimum and maximum origin and the reciprocals of minimum and maximum direction:
    from below, from above, a second one from below, and whether there is such a one."""
    by_high, by_low = _Bound(3 + axis, start, per_rate), _Bound(axis, far_start, far_per_rate)
    if per_rate > 0.0:
        return by_low, by_high, _FREE, False
    if far_per_rate < 0.0:
        return by_high, by_low, _FREE, False
    return by_high, _FREE, by_low, True


@kernel
def _walk(
    nodes: NDArray[np.void],
    triangles: NDArray[np.void],
    rays: NDArray[np.void],
    deferred: NDArray[np.void],
    reached: FloatArray,
) -> None:
    hull = _hull(rays)
    farthest = np.inf
    node, height = 0, 0
    while True:
        _reach(nodes[node].planes_m, hull, reached)
        height = _defer(node, reached, farthest, deferred, height)
        while True:
            if height == 0:
                return
            height -= 1
            if not deferred[height].reached <= farthest:
                continue
            box, place = deferred[height].box // WIDTH, deferred[height].box % WIDTH
            if nodes[box].held[place] == 0:
                break
            _meet_leaf(nodes[box], place, triangles, rays)
            farthest = _farthest(rays)
        node = nodes[box].first[place]


@kernel
def _reach(planes_m: NDArray[np.float32], hull: _Hull, reached: FloatArray) -> None:
    """Set the least and the greatest t >= 0 at which the hull is in each box of a node, (2, WIDTH).

    Comparisons are written so that NaN, for a ray along the face of a box, limits nothing, and loops without branches,
    so that they are vectorised.
    """
    least, most = reached[0], reached[1]
    x, y, z = hull.least
    x_m, y_m, z_m = planes_m[x.plane], planes_m[y.plane], planes_m[z.plane]
    for c in range(len(least)):
        t, near = (x_m[c] - x.start) * x.per_rate, 0.0
        near = t if t > near else near
        t = (y_m[c] - y.start) * y.per_rate
        near = t if t > near else near
        t = (z_m[c] - z.start) * z.per_rate
        least[c] = t if t > near else near
    x, y, z = hull.most
    x_m, y_m, z_m = planes_m[x.plane], planes_m[y.plane], planes_m[z.plane]
    for c in range(len(most)):
        t, far = (x_m[c] - x.start) * x.per_rate, np.inf
        far = t if t < far else far
        t = (y_m[c] - y.start) * y.per_rate
        far = t if t < far else far
        t = (z_m[c] - z.start) * z.per_rate
        most[c] = t if t < far else far
    if hull.both_ways:
        for bound in hull.also_least:
            plane_m = planes_m[bound.plane]
            for c in range(len(least)):
                t = (plane_m[c] - bound.start) * bound.per_rate
                least[c] = t if t > least[c] else least[c]


@kernel
def _defer(node: int, reached: FloatArray, farthest: float, deferred: NDArray[np.void], height: int) -> int:
    base = height
    for c in range(WIDTH):
        t = reached[0, c]
        if t <= farthest and t <= reached[1, c] * _SLACK:
            k = height
            while k > base and deferred[k - 1].reached < t:
                deferred[k].box, deferred[k].reached = deferred[k - 1].box, deferred[k - 1].reached
                k -= 1
            deferred[k].box, deferred[k].reached = WIDTH * node + c, t
            height += 1
    return height


@kernel
def _farthest(rays: NDArray[np.void]) -> float:
    farthest: float = rays[0].near
    for k in range(1, rays.shape[0]):
        farthest = max(farthest, rays[k].near)
    return farthest


@kernel
def _meet_leaf(node: Any, place: int, triangles: NDArray[np.void], rays: NDArray[np.void]) -> None:
    first = node.first[place]
    for k in range(rays.shape[0]):
        ray = rays[k]
        if rays.shape[0] > 1 and not _reaches(ray, node.planes_m, place) <= ray.near:
            continue
        for number in range(first, first + node.held[place]):
            meet(triangles[number], number, ray)


@kernel
def _reaches(ray: Any, planes_m: NDArray[np.float32], place: int) -> float:
    """Parameter t >= 0 at which a ray reaches a box of a node; NaN if it does not."""
    near, far = 0.0, np.inf
    near, far = _clip(planes_m[0, place] - ray.x, planes_m[3, place] - ray.x, ray.rx, near, far)
    near, far = _clip(planes_m[1, place] - ray.y, planes_m[4, place] - ray.y, ray.ry, near, far)
    near, far = _clip(planes_m[2, place] - ray.z, planes_m[5, place] - ray.z, ray.rz, near, far)
    t: float = near if near <= far * _SLACK else np.nan
    return t


@kernel
def _clip(low: float, high: float, per_rate: float, near: float, far: float) -> tuple[float, float]:
    """Part of [near, far] in which a coordinate is between two distances from the ray's start."""
    entering, leaving = low * per_rate, high * per_rate
    if per_rate < 0.0:
        entering, leaving = leaving, entering
    return (entering if entering > near else near), (leaving if leaving < far else far)
