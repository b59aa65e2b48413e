"""Ground from a triangle mesh, placed in the site frame."""

from __future__ import annotations

import math

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.vector_arrays import rotate
from lidar_emu.scenario.ground import Mesh, MeshOrigin
from lidar_emu.scenario.site import Site
from lidar_emu.scene.mesh.file import MeshFile, enclosed_m3, turned_over
from lidar_emu.scene.mesh.model import TriangleMesh, Triangles
from lidar_emu.scene.ray_hits import Hits
from lidar_emu.scene.ray_reach import Rectangle
from lidar_emu.scene.terrain.model import site_from_body_fixed

_ALIKE = 10.0
"""Maximum ratio of the radius of a body's sphere to the distance of its mesh from the centre, either way."""


class MeshGround:
    """Triangles in the site frame.

    Args:
        mesh: triangles in the site frame.
        closed: whether they form the closed surface of a body, which no vehicle leaves.
        description: one line for plans.
        origin_altitude_m: height of the origin above the body's sphere.
    """

    def __init__(self, mesh: TriangleMesh, closed: bool, description: str, origin_altitude_m: float) -> None:
        self._mesh, self._closed = mesh, closed
        self.description = description
        self.origin_altitude_m = origin_altitude_m

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,  # noqa: ARG002
    ) -> Hits:
        return self._mesh.cast(origin_site_m, direction_site, hits)

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """Highest z straight above or below each point, (n,); NaN beside the mesh."""
        return self._mesh.top_m(east_m, north_m)

    @property
    def area(self) -> Rectangle:
        """Bounding rectangle."""
        low_m, high_m = self._mesh.low_m, self._mesh.high_m
        return Rectangle(float(low_m[0]), float(high_m[0]), float(low_m[1]), float(high_m[1]))

    def covers(self, east_m: FloatArray, north_m: FloatArray) -> BoolArray:
        """True for a closed mesh, and within the bounding rectangle of an open one."""
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
        _require_alike(radius_m, file, part.body.radius_m)
    return upright_m - np.array([0.0, 0.0, radius_m]), radius_m


def _require_alike(radius_m: float, file: MeshFile, body_radius_m: float) -> None:
    if not body_radius_m / _ALIKE <= radius_m <= body_radius_m * _ALIKE:
        found = Finding(f"{body_radius_m:.7g} m for a mesh whose surface is {radius_m:.4g} m from its centre")
        raise InputError(file.source, "site.body.radius_m", found, "correct it, or ground.unit")


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
