"""First contact of rays with any scene by slow paths that share no formula with the product's casters.

Plane and sphere use the textbook formulas in 50 digits; meshes try every triangle (Möller and Trumbore 1997) in
extended precision. On a grid every crossing of every grid line is sorted, and each interval bisected: the surface is a
weighted mean of four samples, and the height of a ray above it is divided at its extremum, found from three values.
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext
from functools import singledispatch
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scene.analytic_grounds import PlaneGround, SphereGround
from lidar_emu.scene.grid.cell import Samples
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.mesh.ground import MeshGround, TriangleMesh
from lidar_emu.scene.mosaic.nested import NestedGround
from lidar_emu.scene.objects.populated_scene import PopulatedScene, SceneInMotion
from lidar_emu.scene.ray_hits import GROUND, Hits, Scene
from lidar_emu.scene.ray_reach import CroppedGround

Beyond = PlaneGround | SphereGround | None
Contact = tuple[float, FloatArray]

_FACE_DEPTH_M = 1e-6
_NO_NORMAL = np.full(3, np.nan)


@singledispatch
def cast_exact(scene: Any, _origin_site_m: FloatArray, _direction_site: FloatArray) -> Hits:
    """First contact of rays (n, 3), with the meaning of `Scene.cast`; of moving objects at the start of the run."""
    raise TypeError(scene)


@cast_exact.register
def _(plane: PlaneGround, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    hits = Hits.none(len(origin_site_m))
    a, b, c = (Decimal(x) for x in plane.normal_site.tolist())
    for k, (origin, direction) in enumerate(zip(origin_site_m, direction_site, strict=True)):
        if not np.isfinite([origin, direction]).all():
            continue
        with localcontext(prec=50):
            x, y, z = (Decimal(v) for v in origin.tolist())
            dx, dy, dz = (Decimal(v) for v in direction.tolist())
            height = a * x + b * y + c * z
            climb = a * dx + b * dy + c * dz
            hits.inside[k] = height < 0
            if height == 0 or (height > 0 and climb < 0):
                hits.range_m[k] = float(-height / climb) if height else 0.0
                hits.normal_site[k] = plane.normal_site
                hits.reflectance[k], hits.object_id[k] = plane.reflectance, GROUND
    return hits


@cast_exact.register
def _(sphere: SphereGround, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    hits = Hits.none(len(origin_site_m))
    for k, (origin, direction) in enumerate(zip(origin_site_m, direction_site, strict=True)):
        if not np.isfinite([origin, direction]).all():
            continue
        with localcontext(prec=50):
            radius = Decimal(sphere.radius_m)
            d = [Decimal(v) for v in direction.tolist()]
            o = [Decimal(v) for v in origin.tolist()]
            o[2] += radius + Decimal(sphere.origin_altitude_m)
            a = sum(v * v for v in d)
            b = sum(v * w for v, w in zip(o, d, strict=True))
            c = sum(v * v for v in o) - radius * radius
            discriminant = b * b - a * c
            hits.inside[k] = c < 0
            if c == 0 or (c > 0 and b < 0 and discriminant >= 0):
                t = (-b - discriminant.sqrt()) / a if c else Decimal(0)
                hits.range_m[k] = float(t)
                hits.normal_site[k] = [float((v + t * w) / radius) for v, w in zip(o, d, strict=True)]
                hits.reflectance[k], hits.object_id[k] = sphere.reflectance, GROUND
    return hits


@cast_exact.register
def _(ground: GridGround, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    hits = Hits.none(len(origin_site_m))
    samples, beyond = ground.samples, ground.beyond
    for k, (origin, direction) in enumerate(zip(origin_site_m, direction_site, strict=True)):
        if not np.isfinite([origin, direction]).all():
            continue
        hits.inside[k] = _starts_inside(samples, beyond, origin, direction)
        if not hits.inside[k]:
            hits.range_m[k], hits.normal_site[k] = _first_contact(samples, beyond, origin, direction)
    met = np.isfinite(hits.range_m)
    hits.reflectance[met], hits.object_id[met] = ground.reflectance, GROUND
    return hits


@cast_exact.register
def _(mesh: TriangleMesh, origin_m: FloatArray, direction: FloatArray) -> Hits:
    hits = Hits.none(len(origin_m))
    for k, (origin, way) in enumerate(zip(origin_m, direction, strict=True)):
        if np.isfinite([origin, way]).all():
            _try_every_triangle(mesh, origin.astype(np.longdouble), way.astype(np.longdouble), k, hits)
    return hits


@cast_exact.register
def _(ground: NestedGround, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    hits = Hits.none(len(origin_site_m))
    for k in range(len(origin_site_m)):
        ray = slice(k, k + 1)
        origin, direction = origin_site_m[ray], direction_site[ray]
        if not np.isfinite([origin, direction]).all():
            continue
        edges_m = np.array(ground.rectangle).reshape(2, 2)
        crossings = [_crossings(origin[0, axis], direction[0, axis], edges_m[axis]) for axis in (0, 1)]
        ends = np.unique(np.concatenate(crossings)).tolist()
        for start, end in zip([0.0, *ends], [*ends, np.inf], strict=True):
            east, north, _ = origin[0] + min((start + end) / 2, start + 1.0) * direction[0]
            part = ground.inner if ground.rectangle.holds(east, north) else ground.outer
            found = _cast_from(part, origin + start * direction, direction, ground._lift_m if start else 0.0)
            if found.inside[0] or found.range_m[0] <= end - start:
                hits.set_rows(ray, found)
                hits.range_m[k] += start
                break
    return hits


@cast_exact.register
def _(ground: CroppedGround, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    return cast_exact(ground.whole, origin_site_m, direction_site)


@cast_exact.register
def _(ground: MeshGround, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    return cast_exact(ground.mesh, origin_site_m, direction_site)


@cast_exact.register
def _(scene: PopulatedScene, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    hits = cast_exact(scene.ground, origin_site_m, direction_site)
    hits.keep_nearer(cast_exact(scene.mesh, origin_site_m, direction_site))
    return hits


@cast_exact.register
def _(scene: SceneInMotion, origin_site_m: FloatArray, direction_site: FloatArray) -> Hits:
    hits = cast_exact(scene.still, origin_site_m, direction_site)
    hits = hits._replace(
        velocity_site_mps=np.where(np.isnan(hits.range_m), np.nan, 0.0)[:, None].repeat(3, axis=1)
    )
    for each in scene.moving:
        place_m, velocity_mps = (column[0] for column in each.poses(np.zeros(1)))
        found = cast_exact(each.mesh, origin_site_m - place_m, direction_site)
        moved = np.broadcast_to(velocity_mps, found.normal_site.shape)
        hits.keep_nearer(found._replace(velocity_site_mps=moved))
    return hits


def _cast_from(ground: Scene, start_m: FloatArray, direction: FloatArray, lift_m: float) -> Hits:
    """Hits of one ray on a part of a nested ground; below it by up to `lift_m` it hits the seam."""
    hits = cast_exact(ground, start_m, direction)
    if hits.inside[0] and lift_m > 0.0:
        least_m = ground.height_m(start_m[:, 0], start_m[:, 1]) + 8 * np.spacing(np.abs(start_m).max())
        if least_m[0] - start_m[0, 2] <= lift_m:
            hits = cast_exact(ground, np.array([[*start_m[0, :2], least_m[0]]]), direction)
        hits.inside[0] = False
    return hits


def _try_every_triangle(
    mesh: TriangleMesh, origin: NDArray[np.longdouble], way: NDArray[np.longdouble], k: int, hits: Hits
) -> None:
    triangles = mesh._triangles
    a, b, c = np.moveaxis(triangles["corner_m"].astype(np.longdouble), 1, 0)
    p = np.cross(way, c - a)
    volume = ((b - a) * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        q = np.cross(origin - a, b - a)
        along_b, along_c = ((origin - a) * p).sum(axis=1) / volume, (q @ way) / volume
        t = ((c - a) * q).sum(axis=1) / volume
        met = (along_b >= 0) & (along_c >= 0) & (along_b + along_c <= 1) & (t >= 0)
    if not met.any():
        return
    # At equal ranges the triangle that faces the ray counts.
    nearest = np.flatnonzero(met)[np.lexsort((volume[met] < 0, t[met]))[0]]
    behind = volume[nearest] < 0
    hits.inside[k] = behind and not triangles["sheet"][nearest] and t[nearest] > 0
    if not hits.inside[k]:
        normal = np.cross((b - a)[nearest], (c - a)[nearest])
        normal *= -1 if behind and triangles["sheet"][nearest] else 1
        hits.range_m[k] = t[nearest]
        hits.normal_site[k] = normal / np.sqrt((normal * normal).sum())
        hits.reflectance[k], hits.object_id[k] = (
            triangles["albedo"][nearest],
            triangles["object_id"][nearest],
        )


def _starts_inside(samples: Samples, beyond: Beyond, origin: FloatArray, direction: FloatArray) -> bool:
    cell = _cell_at(samples, origin)
    if cell is not None:
        return bool(origin[2] < _height(samples, cell, origin))
    return beyond is not None and bool(cast_exact(beyond, origin[None], direction[None]).inside[0])


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
    contact = cast_exact(beyond, point[None], direction[None])
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
