"""Construction of a scene from a ground and the objects of its site."""

from __future__ import annotations

from collections import Counter

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import SITE_FROM_NED, compose, from_yaw_pitch_roll, rotate
from lidar_emu.scenario.objects import MeshObject, PlacedObject
from lidar_emu.scenario.site import Site
from lidar_emu.scene.cropped_ground import CroppedGrid, CroppedGround
from lidar_emu.scene.map_area import Rectangle
from lidar_emu.scene.mesh.file import MAXIMUM_TRIANGLES, read_mesh
from lidar_emu.scene.mesh.model import TriangleMesh, Triangles
from lidar_emu.scene.objects.motion import MovingObject
from lidar_emu.scene.objects.populated_scene import PopulatedScene, SceneInMotion
from lidar_emu.scene.objects.shapes import corners_m
from lidar_emu.scene.objects.static_objects import Standing, draw_copies
from lidar_emu.scene.ray_hits import GROUND, Scene
from lidar_emu.scene.ray_reach import Reach, Span

_NED_FROM_OBJECT = np.diag([1.0, -1.0, -1.0])
"""Rotation from forward-right-down, the axes of the angles, to forward-left-up, the axes of the shapes."""


CUT_FROM_TRIANGLES = 20_000
"""Objects with fewer triangles are not cropped: it would save little."""


def populated(ground: Scene, part: Site, reach: Reach | None) -> Scene:
    """Place the objects of a site on its ground.

    Args:
        ground: the ground.
        part: the site.
        reach: rays of the run; objects that they cannot reach are left out; None: all are built.
    """
    still: list[Standing] = []
    moving: list[MovingObject] = []
    for number, each in enumerate(part.objects):
        triangles = _triangles(each, GROUND + 1 + number, part.surface.reflectance)
        if each.motion is not None:
            moving.append(_moving(each, number, triangles, ground, part))
        else:
            still.append(_standing(each, number, triangles, ground, part))
    scene = ground
    if still:
        scene = _within_reach(ground, still, part, reach)
    if moving:
        scene = SceneInMotion(scene, moving, f"moving objects: {len(moving)}")
    return scene


def _within_reach(ground: Scene, still: list[Standing], part: Site, reach: Reach | None) -> Scene:
    """The ground with the objects that rays can reach; the others are built if a ray needs them."""
    count = sum(each.triangle_count for each in still)
    description = _counted(part.objects, count)

    def whole() -> Scene:
        return PopulatedScene(ground, TriangleMesh(_joined(still)), description)

    if reach is None or count < CUT_FROM_TRIANGLES:
        _require_room(count, part)
        return whole()
    span = _around([each.span for each in still])
    area = reach.over(span)
    near = [each.near(area) for each in still]
    _require_room(sum(each.triangle_count for each in near), part)
    met = _over(area, _joined(near))
    held = PopulatedScene(ground, TriangleMesh(met), description) if len(met.corner_m) else ground
    return CroppedGround(held, (CroppedGrid(span, area, count, len(met.corner_m)),), whole)


def _require_room(triangles: int, part: Site) -> None:
    if triangles > MAXIMUM_TRIANGLES:
        found = Finding(f"{triangles} triangles within reach of the beams, more than {MAXIMUM_TRIANGLES}")
        raise InputError(part.name, "site.objects", found, "scatter fewer copies, or over less ground")


def _joined(still: list[Standing]) -> Triangles:
    return Triangles.joined([each.triangles() for each in still])


def _around(spans: list[Span]) -> Span:
    areas = np.array([span.area for span in spans])
    west_m, _, south_m, _ = areas.min(axis=0).tolist()
    _, east_m, _, north_m = areas.max(axis=0).tolist()
    floor_m, ceiling_m = min(span.floor_m for span in spans), max(span.ceiling_m for span in spans)
    return Span(Rectangle(west_m, east_m, south_m, north_m), floor_m, ceiling_m)


def _over(area: Rectangle, triangles: Triangles) -> Triangles:
    """Triangles that reach into an area."""
    east_m, north_m = triangles.corner_m[..., 0], triangles.corner_m[..., 1]
    met = (east_m.min(axis=1) <= area.east_m) & (area.west_m <= east_m.max(axis=1))
    met &= (north_m.min(axis=1) <= area.north_m) & (area.south_m <= north_m.max(axis=1))
    return triangles.chosen(np.flatnonzero(met))


def _counted(parts: list[PlacedObject], triangles: int) -> str:
    counts: Counter[str] = Counter()
    for each in parts:
        if each.motion is None:
            counts[each.kind] += 1 if each.scatter is None else each.scatter.count
    kinds = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    return f"objects: {kinds} ({triangles} triangles)"


def _triangles(part: PlacedObject, object_id: int, reflectance: float) -> Triangles:
    """Triangles of an object about its position, in the site's axes."""
    sheet = False
    own = reflectance if part.reflectance is None else part.reflectance
    albedo: float | FloatArray = own
    if isinstance(part, MeshObject):
        file = read_mesh(part.file, part.unit)
        corner_m, sheet = part.scale * file.corner_m, not (file.is_closed and file.faces_one_way)
        albedo = file.albedo(f"objects.{part.name}.material_reflectance", part.material_reflectance, own)
    else:
        corner_m = corners_m(part)
    yaw, pitch = np.radians(part.yaw_deg), np.radians(part.pitch_deg)
    ned_from_object = compose(from_yaw_pitch_roll(yaw, pitch, 0.0), _NED_FROM_OBJECT)
    turned_m = rotate(compose(SITE_FROM_NED, ned_from_object), corner_m)
    return Triangles.alike(turned_m, albedo, sheet, object_id)


def _moving(part: PlacedObject, number: int, triangles: Triangles, ground: Scene, site: Site) -> MovingObject:
    assert part.motion is not None
    here = np.array([[part.east_m, part.north_m]])
    place_m = np.zeros((1, 3)) if part.motion.waypoints else _on_ground(part, number, here, ground, site)
    return MovingObject(TriangleMesh(triangles), place_m[0], part.motion)


def _standing(part: PlacedObject, number: int, shape: Triangles, ground: Scene, site: Site) -> Standing:
    here = np.array([[part.east_m, part.north_m]])
    if part.scatter is None:
        return Standing(shape, _on_ground(part, number, here, ground, site), np.ones(1), np.zeros(1))
    away_m, scale, turn_rad = draw_copies(part.scatter)
    return Standing(shape, _on_ground(part, number, here + away_m, ground, site), scale, turn_rad)


def _on_ground(
    part: PlacedObject, number: int, horizontal_m: FloatArray, ground: Scene, site: Site
) -> FloatArray:
    """Positions (n, 3) from horizontal ones (n, 2): at the object's own height, or on the ground."""
    if part.up_m is not None:
        return np.column_stack([horizontal_m, np.full(len(horizontal_m), part.up_m)])
    up_m = ground.height_m(horizontal_m[:, 0].copy(), horizontal_m[:, 1].copy())
    if np.isnan(up_m).any():
        east_m, north_m = horizontal_m[np.flatnonzero(np.isnan(up_m))[0]]
        found = Finding(f"no ground at {east_m:.1f} m east, {north_m:.1f} m north of the origin")
        remedy = f"place the {part.kind} {part.name!r} on the ground, or state up_m"
        raise InputError(site.name, f"site.objects.{number}", found, remedy)
    return np.column_stack([horizontal_m, up_m])
