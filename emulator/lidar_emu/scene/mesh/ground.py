"""Triangles prepared for the casting of rays, and ground from a mesh of them, placed in the site frame."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import with_fields
from lidar_emu.numerics.vector_arrays import rotate
from lidar_emu.scenario.ground import Mesh, MeshOrigin
from lidar_emu.scenario.site import Site
from lidar_emu.scene.mesh.cast import BUNDLE, DEFERRED, RAY, TRIANGLE, cast_rays
from lidar_emu.scene.mesh.file import MeshFile, enclosed_m3, turned_over
from lidar_emu.scene.mesh.tree import WIDTH, build_tree
from lidar_emu.scene.ray_hits import GROUND, Hits, RayCaster
from lidar_emu.scene.ray_reach import Rectangle
from lidar_emu.scene.terrain.model import site_from_body_fixed


class Triangles(NamedTuple):
    """n triangles of one or several objects."""

    corner_m: FloatArray
    """(n, 3, 3) Corners, counter-clockwise as seen from outside."""
    sheet: BoolArray
    """(n,) Whether the triangle belongs to a sheet, seen from both sides; others bound a solid."""
    reflectance: FloatArray
    """(n,) Albedo."""
    object_id: NDArray[np.int16]
    """(n,) Object, see `Hits.object_id`."""

    @classmethod
    def alike(
        cls,
        corner_m: FloatArray,
        reflectance: float | FloatArray,
        sheet: bool = False,
        object_id: int = GROUND,
    ) -> Self:
        """Triangles that share all attributes but the corners, and the albedo if it is a single one."""
        count = len(corner_m)
        return cls(
            corner_m,
            np.full(count, sheet),
            np.full(count, reflectance),
            np.full(count, object_id, dtype=np.int16),
        )

    def chosen(self, which: IntArray) -> Self:
        """Selected triangles; an index may repeat."""
        columns: tuple[NDArray[Any], ...] = self
        return type(self)(*(np.ascontiguousarray(column[which]) for column in columns))

    @classmethod
    def joined(cls, parts: list[Self]) -> Self:
        """Concatenate several sets of triangles."""
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class TriangleMesh(RayCaster):
    """Triangles in a tree of boxes, in the same frame as the rays."""

    def __init__(self, triangles: Triangles) -> None:
        self._tree = build_tree(triangles.corner_m.min(axis=1), triangles.corner_m.max(axis=1))
        # Neighbours in space become neighbours in memory.
        self._triangles = _records(triangles, self._tree.order)
        self._rays = with_fields(np.empty(BUNDLE, dtype=RAY))
        self._deferred = with_fields(np.empty(WIDTH * self._tree.depth, dtype=DEFERRED))
        self._reached = np.empty((2, WIDTH))

    @property
    def low_m(self) -> FloatArray:
        """Minimum coordinates (3,)."""
        return self._tree.low_m

    @property
    def high_m(self) -> FloatArray:
        """Maximum coordinates (3,)."""
        return self._tree.high_m

    @property
    def corner_m(self) -> FloatArray:
        """Corners (n, 3, 3) in the order of the tree."""
        return np.asarray(self._triangles["corner_m"])

    @property
    def is_sheet(self) -> BoolArray:
        """(n,) Whether each is seen from both sides."""
        return np.asarray(self._triangles["sheet"])

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, _bundle: int) -> None:
        nodes, triangles, static = self._tree.nodes, self._triangles, hits.on_static_ground
        rays, deferred, reached = self._rays, self._deferred, self._reached
        cast_rays(origin, direction, nodes, triangles, rays, deferred, reached, *static)

    def top_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """Highest z straight above or below each point, (n,), with z upward; NaN beside the triangles."""
        east, north = np.broadcast_arrays(east_m, north_m)
        above_m = float(self.high_m[2]) + 1.0
        start_m = np.stack([east, north, np.full(east.shape, above_m)], axis=-1)
        down = np.broadcast_to([0.0, 0.0, -1.0], start_m.shape)
        return above_m - self.cast(start_m, down).range_m


def _records(triangles: Triangles, order: IntArray) -> Any:
    records = np.empty(len(order), dtype=TRIANGLE)
    records["corner_m"], records["sheet"] = triangles.corner_m[order], triangles.sheet[order]
    records["albedo"], records["object_id"] = triangles.reflectance[order], triangles.object_id[order]
    return with_fields(records)


_ALIKE = 10.0
"""Maximum ratio of the radius of a body's sphere to the distance of its mesh from the centre, either way."""


class MeshGround(RayCaster):
    """Triangles in the site frame.

    Args:
        mesh: triangles in the site frame.
        closed: whether they form the closed surface of a body, which no vehicle leaves.
        description: one line for plans.
        origin_altitude_m: height of the origin above the body's sphere.
    """

    def __init__(self, mesh: TriangleMesh, closed: bool, description: str, origin_altitude_m: float) -> None:
        self.mesh, self._closed = mesh, closed
        self.description = description
        self.origin_altitude_m = origin_altitude_m

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, _bundle: int) -> None:
        self.mesh.cast(origin, direction, hits)

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        return self.mesh.top_m(east_m, north_m)

    @property
    def area(self) -> Rectangle:
        low_m, high_m = self.mesh.low_m, self.mesh.high_m
        return Rectangle(float(low_m[0]), float(high_m[0]), float(low_m[1]), float(high_m[1]))

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        within = self.area.holds(*np.broadcast_arrays(east_m, north_m))
        return np.asarray(within | self._closed)


def place_mesh(file: MeshFile, ground: Mesh, part: Site) -> MeshGround:
    """Place a mesh in the site frame."""
    corner_m, altitude_m, origin = file.corner_m, 0.0, ground.origin
    if origin.is_body_fixed:
        corner_m, radius_m = _at_place(file, origin, part)
        altitude_m = radius_m - part.body.radius_m
    if not file.is_closed and file.faces_one_way:
        corner_m = _facing_up(corner_m, altitude_m + part.body.radius_m if origin.is_body_fixed else None)
    albedo = file.albedo("ground.material_reflectance", ground.material_reflectance, part.surface.reflectance)
    triangles = Triangles.alike(corner_m, albedo, sheet=not file.faces_one_way)
    if part.origin_altitude_m is not None:
        altitude_m = part.origin_altitude_m
    return MeshGround(TriangleMesh(triangles), file.is_closed, file.description, altitude_m)


def _facing_up(corner_m: FloatArray, centre_below_m: float | None) -> FloatArray:
    """Orient an open mesh to face away from the body's centre, or upward if it has none."""
    a, b, c = np.moveaxis(corner_m, 1, 0)
    if centre_below_m is None:
        outward = float(np.cross(b - a, c - a)[:, 2].sum())
    else:
        outward = enclosed_m3(corner_m + np.array([0.0, 0.0, centre_below_m]))
    return corner_m if outward >= 0 else turned_over(corner_m)


def _at_place(file: MeshFile, origin: MeshOrigin, part: Site) -> tuple[FloatArray, float]:
    """Corners in axes east, north and up at the origin, and the distance from the body's centre to the origin."""
    if origin.body_fixed_m is not None:
        x, y, z = origin.body_fixed_m
        latitude_rad, longitude_rad = math.atan2(z, math.hypot(x, y)), math.atan2(y, x)
        upright_m = rotate(site_from_body_fixed(latitude_rad, longitude_rad), file.corner_m)
        radius_m = math.sqrt(x * x + y * y + z * z)
    else:
        assert origin.latitude_deg is not None
        assert origin.longitude_deg is not None
        latitude_rad, longitude_rad = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
        upright_m = rotate(site_from_body_fixed(latitude_rad, longitude_rad), file.corner_m)
        radius_m = _height_over_centre_m(upright_m)
        if not radius_m > 0:
            found = Finding(
                f"no surface at latitude {origin.latitude_deg:g}, longitude {origin.longitude_deg:g}"
            )
            raise InputError(file.source, "ground.origin", found, "choose a place on the mesh")
        if not part.body.radius_m / _ALIKE <= radius_m <= part.body.radius_m * _ALIKE:
            off = f"{part.body.radius_m:.7g} m for a mesh whose surface is {radius_m:.4g} m from its centre"
            raise InputError(file.source, "site.body.radius_m", Finding(off), "correct it, or ground.unit")
    return upright_m - np.array([0.0, 0.0, radius_m]), radius_m


def _height_over_centre_m(corner_m: FloatArray) -> float:
    """Greatest z of the triangles on the z axis; NaN if there is none."""
    across = corner_m[..., :2]
    about = (across.min(axis=1) <= 0).all(axis=1) & (across.max(axis=1) >= 0).all(axis=1)
    a, b, c = np.moveaxis(corner_m[about], 1, 0)
    u, v, w = (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b)))
    area = u + v + w
    met = (((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))) & (area != 0)
    z_m = (u * a[:, 2] + v * b[:, 2] + w * c[:, 2])[met] / area[met]
    return float(z_m.max(initial=-np.inf)) if met.any() else math.nan
