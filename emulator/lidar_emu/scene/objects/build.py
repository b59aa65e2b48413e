"""Construction of a scene from a ground and the objects of its site."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple, Self

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.numerics.vector_arrays import SITE_FROM_NED, compose, from_yaw_pitch_roll, rotate
from lidar_emu.scenario.objects import (
    Boulder,
    Cliff,
    MeshObject,
    Pad,
    PlacedObject,
    RampObject,
    Scatter,
    Slab,
    Tree,
)
from lidar_emu.scenario.site import Site
from lidar_emu.scene.mesh.file import MAXIMUM_TRIANGLES, read_mesh
from lidar_emu.scene.mesh.ground import TriangleMesh, Triangles
from lidar_emu.scene.objects.populated_scene import MovingObject, PopulatedScene, SceneInMotion
from lidar_emu.scene.ray_hits import GROUND, Scene
from lidar_emu.scene.ray_reach import CroppedGrid, CroppedGround, Reach, Rectangle, Span

_ROUNDING = 1 + 1e-9
"""Margin for rotated corners, which may extend beyond the widest one by rounding."""


class Standing(NamedTuple):
    """n copies of an object; n is 1 without `scatter`."""

    shape: Triangles
    """Triangles about the object's position, in the site's axes."""
    place_m: FloatArray
    """(n, 3) Positions in the site frame."""
    scale: FloatArray
    """(n,) Sizes relative to the shape."""
    turn_rad: FloatArray
    """(n,) Rotations about the vertical."""

    @property
    def triangle_count(self) -> int:
        return len(self.shape.corner_m) * len(self.place_m)

    def near(self, area: Rectangle) -> Self:
        """The copies that may reach into an area."""
        (east_m, north_m, _), away_m = self.place_m.T, self._away_m
        near = (area.west_m - away_m <= east_m) & (east_m <= area.east_m + away_m)
        near &= (area.south_m - away_m <= north_m) & (north_m <= area.north_m + away_m)
        return self._replace(place_m=self.place_m[near], scale=self.scale[near], turn_rad=self.turn_rad[near])

    def triangles(self) -> Triangles:
        """Triangles in the site frame, copy after copy."""
        turn = from_yaw_pitch_roll(self.turn_rad, 0.0, 0.0)[:, None, None]
        corner_m = rotate(turn, self.shape.corner_m[None])
        corner_m *= self.scale[:, None, None, None]
        corner_m += self.place_m[:, None, None]
        alike = self.shape.chosen(np.tile(np.arange(len(self.shape.corner_m)), len(corner_m)))
        return alike._replace(corner_m=corner_m.reshape(-1, 3, 3))

    @property
    def _away_m(self) -> FloatArray:
        """Horizontal reach (n,) of each copy from its position."""
        corner_m = self.shape.corner_m
        return np.asarray(self.scale * (_ROUNDING * np.hypot(corner_m[..., 0], corner_m[..., 1]).max()))

    @property
    def span(self) -> Span:
        """Bounds of all copies, with a margin."""
        (east_m, north_m, up_m), away_m = self.place_m.T, self._away_m
        z_m = self.shape.corner_m[..., 2]
        west_m, easternmost_m = (east_m - away_m).min(), (east_m + away_m).max()
        south_m, northernmost_m = (north_m - away_m).min(), (north_m + away_m).max()
        across = Rectangle(float(west_m), float(easternmost_m), float(south_m), float(northernmost_m))
        floor_m, ceiling_m = (up_m + self.scale * z_m.min()).min(), (up_m + self.scale * z_m.max()).max()
        return Span(across, float(floor_m), float(ceiling_m))


def draw_copies(scatter: Scatter) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw the copies: positions (n, 2) east and north of the centre, sizes (n,), and rotations (n,) about the
    vertical."""
    random = generator(scatter.seed, bit_generator=np.random.PCG64).random((scatter.count, 4))
    away_m, towards = scatter.radius_m * np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
    place_m = away_m[:, None] * np.stack([np.sin(towards), np.cos(towards)], axis=-1)
    least, greatest = scatter.scale
    return place_m, least * (greatest / least) ** random[:, 2], 2 * np.pi * random[:, 3]


_ROUND = 48
"""Corners of a round pad: at most 0.2 % of the radius inside the circle. Trunks have a quarter of them."""
_HALVINGS = 2
"""Subdivisions of an icosahedron for an ellipsoid: 320 faces, at most 2 % of the radius inside it."""

Outline = Sequence[tuple[float, float]]


def corners_m(part: PlacedObject) -> FloatArray:
    """Shape of an object that is not read from a file."""
    match part:
        case Boulder():
            height_m = part.diameter_m / 2 if part.height_m is None else part.height_m
            return ellipsoid(part.diameter_m, 2 * height_m, 0.0)
        case Slab():
            top, back = part.height_m, part.length_m / 2
            return _across([(-back, 0), (back, 0), (back, top), (-back, top)], part.width_m)
        case Cliff():
            foot, top = -part.height_m / np.tan(np.radians(part.face_deg)), part.height_m
            foot = 0.0 if part.face_deg == 90 else float(foot)
            return _across([(foot, 0), (part.length_m, 0), (part.length_m, top), (0, top)], part.width_m)
        case RampObject():
            return _across([(0, 0), (part.length_m, 0), (part.length_m, part.height_m)], part.width_m)
        case Tree():
            return _tree(part)
        case Pad():
            return _upright(part.diameter_m / 2, 0.0, part.height_m, _ROUND)
        case MeshObject():
            raise TypeError("a mesh is read from its file")


def ellipsoid(diameter_m: float, height_m: float, centre_m: float) -> FloatArray:
    """An upright ellipsoid with its corners on the surface."""
    radii_m = np.array([diameter_m, diameter_m, height_m]) / 2
    return np.asarray(_unit_sphere() * radii_m + np.array([0.0, 0.0, centre_m]))


def _tree(part: Tree) -> FloatArray:
    base_m, trunk_m = part.height_m / 3, part.crown_diameter_m / 10
    middle_m = (base_m + part.height_m) / 2
    crown = ellipsoid(part.crown_diameter_m, part.height_m - base_m, middle_m)
    # The trunk ends within the crown.
    return np.concatenate([crown, _upright(trunk_m / 2, 0.0, middle_m, _ROUND // 4)])


def _across(outline: Outline, width_m: float) -> FloatArray:
    """A prism across the object, over a convex outline of (forward, up), counter-clockwise as seen from the right."""
    points = np.array(outline, dtype=np.float64)
    return _prism(np.insert(points, 1, -width_m / 2, axis=1), np.insert(points, 1, width_m / 2, axis=1))


def _upright(radius_m: float, from_m: float, to_m: float, corners: int) -> FloatArray:
    angle = 2 * np.pi * np.arange(corners) / corners
    ring = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle)], axis=1)
    return _prism(np.insert(ring, 2, to_m, axis=1), np.insert(ring, 2, from_m, axis=1))


def _prism(near: FloatArray, far: FloatArray) -> FloatArray:
    """Prism between two outlines (n, 3) of equal size, the near one counter-clockwise as seen from outside."""
    after_near, after_far = np.roll(near, -1, axis=0), np.roll(far, -1, axis=0)
    sides = [np.stack([near, far, after_far], axis=1), np.stack([near, after_far, after_near], axis=1)]
    ends = [_fan(near), _fan(far[::-1])]
    return np.concatenate([*sides, *ends])


def _fan(outline: FloatArray) -> FloatArray:
    return np.stack([np.broadcast_to(outline[0], outline[2:].shape), outline[1:-1], outline[2:]], axis=1)


@cache
def _unit_sphere() -> FloatArray:
    """An icosahedron whose faces are subdivided and projected onto the sphere."""
    golden = (1 + 5**0.5) / 2
    vertex = np.array([[0.0, y, z] for y in (-1, 1) for z in (-golden, golden)])
    vertex = np.concatenate([np.roll(vertex, turn, axis=1) for turn in range(3)])
    near = np.linalg.norm(vertex[:, None] - vertex[None], axis=2) < 2.1
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i + 1, 12)
        for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    corner: FloatArray = vertex[np.array(faces)]
    inward = np.linalg.det(corner) < 0
    corner[inward] = corner[inward, ::-1]
    corner /= np.linalg.norm(corner, axis=2, keepdims=True)
    for _ in range(_HALVINGS):
        a, b, c = np.moveaxis(corner, 1, 0)
        ab, bc, ca = (p + q for p, q in ((a, b), (b, c), (c, a)))
        fours = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corner = np.concatenate([np.stack(four, axis=1) for four in fours])
        corner /= np.linalg.norm(corner, axis=2, keepdims=True)
    return corner


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
