"""Shapes of objects as closed meshes (triangles, 3, 3): axes forward, left and up, with the object's position at
zero."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.objects import Boulder, Cliff, MeshObject, Pad, PlacedObject, RampObject, Slab, Tree

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
