"""From the objects of a site to what rays can hit."""

from __future__ import annotations

from collections import Counter

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.errors import Finding, InputError
from lidar_emu.rotations import SITE_FROM_NED, chained, from_yaw_pitch_roll, rotate
from lidar_emu.scenario.objects import MeshObject, PlacedObject, Scatter
from lidar_emu.scenario.site import Site
from lidar_emu.scene.cut import CutGround, Kept
from lidar_emu.scene.hits import GROUND, Scene
from lidar_emu.scene.mesh.file import read_mesh
from lidar_emu.scene.mesh.model import Mesh, Triangles
from lidar_emu.scene.objects.motion import MovingObject
from lidar_emu.scene.objects.populated import PopulatedScene, SceneInMotion
from lidar_emu.scene.objects.shapes import corners_m
from lidar_emu.scene.reach import Reach, Span
from lidar_emu.scene.rectangle import Rectangle

_NED_FROM_OBJECT = np.diag([1.0, -1.0, -1.0])
"""Forward-right-down angles, for shapes that are forward-left-up."""


CUT_FROM_TRIANGLES = 20_000
"""Of fewer all are held: there is little to be saved."""


def populated(ground: Scene, part: Site, reach: Reach | None) -> Scene:
    """A ground with the objects of its site.

    Args:
        ground: below them.
        part: the site.
        reach: the rays of the run, so that objects that they cannot meet are left out; None: all are built.

    Raises:
        InputError: the file of an object cannot be used, or there is no ground under one that is to stand on it.
    """
    still: list[Triangles] = []
    moving: list[MovingObject] = []
    for number, each in enumerate(part.objects):
        triangles = _triangles(each, GROUND + 1 + number, part.surface.reflectance)
        if each.motion is not None:
            moving.append(_moving(each, number, triangles, ground, part))
        else:
            still.append(_standing(each, number, triangles, ground, part))
    scene = ground
    if still:
        joined = Triangles.joined(still)
        scene = _within_reach(ground, joined, _counted(part.objects, len(joined.corner_m)), reach)
    if moving:
        scene = SceneInMotion(scene, moving, f"{len(moving)} moving")
    return scene


def _within_reach(ground: Scene, triangles: Triangles, description: str, reach: Reach | None) -> Scene:
    """The ground with those triangles that rays can meet; the others come back if one needs them after all."""

    def whole() -> Scene:
        return PopulatedScene(ground, Mesh(triangles), description)

    if reach is None or len(triangles.corner_m) < CUT_FROM_TRIANGLES:
        return whole()
    low_m, high_m = triangles.corner_m.min(axis=1), triangles.corner_m.max(axis=1)
    (west_m, south_m, floor_m), (east_m, north_m, ceiling_m) = low_m.min(axis=0), high_m.max(axis=0)
    span = Span(Rectangle(west_m, east_m, south_m, north_m), floor_m, ceiling_m)
    area = reach.over(span)
    meets_across = (low_m[:, 0] <= area.east_m) & (area.west_m <= high_m[:, 0])
    met = np.flatnonzero(meets_across & (low_m[:, 1] <= area.north_m) & (area.south_m <= high_m[:, 1]))
    held = PopulatedScene(ground, Mesh(triangles.chosen(met)), description) if met.size else ground
    return CutGround(held, (Kept(span, area, len(low_m), met.size),), whole)


def _counted(parts: list[PlacedObject], triangles: int) -> str:
    counts: Counter[str] = Counter()
    for each in parts:
        if each.motion is None:
            counts[each.kind] += 1 if each.scatter is None else each.scatter.count
    kinds = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    return f"objects: {kinds} ({triangles} triangles)"


def _triangles(part: PlacedObject, thing: int, reflectance: float) -> Triangles:
    """About its place, along the site's axes."""
    sheet = False
    if isinstance(part, MeshObject):
        file = read_mesh(part.file, part.unit)
        corner_m, sheet = part.scale * file.corner_m, not (file.is_closed and file.faces_one_way)
    else:
        corner_m = corners_m(part)
    yaw, pitch, roll = (np.radians(angle) for angle in (part.yaw_deg, part.pitch_deg, part.roll_deg))
    ned_from_object = chained(from_yaw_pitch_roll(yaw, pitch, roll), _NED_FROM_OBJECT)
    turned_m = rotate(chained(SITE_FROM_NED, ned_from_object), corner_m)
    albedo = reflectance if part.reflectance is None else part.reflectance
    return Triangles.alike(turned_m, albedo, sheet, thing)


def _moving(part: PlacedObject, number: int, triangles: Triangles, ground: Scene, site: Site) -> MovingObject:
    assert part.motion is not None
    here = np.array([[part.east_m, part.north_m]])
    place_m = np.zeros((1, 3)) if part.motion.waypoints else _on_ground(part, number, here, ground, site)
    return MovingObject(Mesh(triangles), place_m[0], part.motion)


def _standing(part: PlacedObject, number: int, triangles: Triangles, ground: Scene, site: Site) -> Triangles:
    """In the site frame; copy after copy, if there are several."""
    here = np.array([[part.east_m, part.north_m]])
    if part.scatter is None:
        corner_m = triangles.corner_m + _on_ground(part, number, here, ground, site)[0]
        return triangles._replace(corner_m=corner_m)
    away_m, scale, turn = _strewn(part.scatter)
    place_m = _on_ground(part, number, here + away_m, ground, site)
    turned = rotate(turn[:, None, None], triangles.corner_m[None])
    corner_m = place_m[:, None, None] + scale[:, None, None, None] * turned
    alike = triangles.chosen(np.tile(np.arange(len(triangles.corner_m)), len(corner_m)))
    return alike._replace(corner_m=corner_m.reshape(-1, 3, 3))


def _strewn(scatter: Scatter) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each copy its place (n, 2) east and north of the centre, size (n,), and turn (n, 3, 3) about the vertical."""
    random = np.random.default_rng(scatter.seed).random((scatter.count, 4))
    away_m, towards = scatter.radius_m * np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
    place_m = away_m[:, None] * np.stack([np.sin(towards), np.cos(towards)], axis=-1)
    least, greatest = scatter.scale
    scale = least * (greatest / least) ** random[:, 2]
    return place_m, scale, from_yaw_pitch_roll(2 * np.pi * random[:, 3], 0.0, 0.0)


def _on_ground(
    part: PlacedObject, number: int, horizontal_m: FloatArray, ground: Scene, site: Site
) -> FloatArray:
    """Places (n, 3) over horizontal ones (n, 2): at the object's own height, or on the ground."""
    if part.up_m is not None:
        return np.column_stack([horizontal_m, np.full(len(horizontal_m), part.up_m)])
    up_m = ground.height_m(horizontal_m[:, 0].copy(), horizontal_m[:, 1].copy())
    if np.isnan(up_m).any():
        east_m, north_m = horizontal_m[np.flatnonzero(np.isnan(up_m))[0]]
        found = Finding(f"no ground at {east_m:.1f} m east, {north_m:.1f} m north of the origin")
        allowed = f"for {part.kind} {part.name!r} to stand on; allowed: a place on the ground, or up_m"
        raise InputError(site.name, f"site.objects.{number}", found, allowed)
    return np.column_stack([horizontal_m, up_m])
