"""Triangles cast by lidar-emu and by Embree, an independent ray tracer in float32, on the same rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import cross, dot
from lidar_emu.scene.mesh.ground import MeshGround, TriangleMesh
from lidar_emu.scene.objects.populated_scene import PopulatedScene, SceneInMotion
from lidar_emu.scene.ray_hits import Scene

RAYS = 100_000
_AWAY = 2.5
"""Distance of the rays' origins from their targets, in radii of a sphere around the mesh."""
_ROUNDINGS = 8
_BESIDE = 64


class Embree:
    """embreex in robust mode: Embree, one ray after another."""

    def __init__(self, vertex_m: FloatArray, face: NDArray[np.int64]) -> None:
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)
        self._mesh = EmbreeMesh(self._scene, vertex_m.astype(np.float32)[face])
        self.range_m(vertex_m[:1], np.array([[0.0, 0.0, -1.0]]))  # commits the scene

    def prepare(self, origin: FloatArray, direction: FloatArray) -> Callable[[], Any]:
        """A call that traces n rays, arrays (n, 3): distance, normal and triangle of each."""
        rays = origin.astype(np.float32), direction.astype(np.float32)
        return lambda: self._scene.run(*rays, output=True)

    def range_m(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """(n,) Distances; NaN where nothing is hit."""
        met = self.prepare(origin, direction)()
        return np.where(met["primID"] < 0, np.nan, met["tfar"].astype(np.float64))


def meshes_of(scene: Scene) -> dict[str, TriangleMesh]:
    """The triangles of a scene, without objects that move: `ground`, `objects`."""
    found = {}
    scene = scene.still if isinstance(scene, SceneInMotion) else scene
    if isinstance(scene, PopulatedScene):
        found["objects"], scene = scene.mesh, scene.ground
    return {"ground": scene.mesh} | found if isinstance(scene, MeshGround) else found


def compare_casting(mesh: TriangleMesh, rng: np.random.Generator) -> dict[str, Any]:
    """Cast rays from all around at the front of triangles, a fifth of them at edges and corners.

    Embree has the mesh moved and scaled to a sphere of radius 1. Ranges may differ by eight roundings to float32 at the
    distance of the origins, over the cosine of incidence. At an edge one caster alone may hit, or hit what is behind:
    Embree, whose rays pass between triangles, or either at an outline. A difference is `unexplained` if most rays
    beside, at that distance, differ as well, or if lidar-emu alone misses what it hits with all of them.

    Returns:
        Counts, differences of ranges, and the worst rays: values of JSON.
    """
    corner_m, low_m, high_m = mesh.corner_m, mesh.low_m, mesh.high_m
    middle_m, radius_m = (low_m + high_m) / 2, float(np.linalg.norm(high_m - low_m)) / 2
    normal = cross(corner_m[:, 1] - corner_m[:, 0], corner_m[:, 2] - corner_m[:, 0])
    normal /= np.sqrt(dot(normal, normal))[:, None]
    tolerance_m = _ROUNDINGS * _AWAY * radius_m * float(np.finfo(np.float32).eps)
    face = np.arange(3 * len(corner_m)).reshape(-1, 3)
    embree = Embree((corner_m.reshape(-1, 3) - middle_m) / radius_m, face)

    def cast(origin_m: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
        """Ranges (n,) of both, infinite where nothing is hit, and whether they differ."""
        ours_m = mesh.cast(origin_m, direction).range_m
        met = embree.prepare((origin_m - middle_m) / radius_m, direction)()
        hit = met["primID"]
        theirs_m = radius_m * np.where(hit < 0, np.inf, met["tfar"].astype(np.float64))
        cosine = dot(normal[hit], direction)
        slack_m = tolerance_m / np.maximum(np.abs(cosine), 1e-12)
        ours_m = np.where(np.isnan(ours_m), np.inf, ours_m)
        # The back of a solid is no hit, unless an edge is seen where its front is too.
        back = ~mesh.is_sheet[hit] & (cosine > 0) & ~(np.abs(ours_m - theirs_m) <= slack_m)
        theirs_m[back] = np.inf
        return ours_m, theirs_m, (ours_m != theirs_m) & ~(np.abs(ours_m - theirs_m) <= slack_m)

    target_m, direction = _targets(corner_m, normal, rng)
    origin_m = target_m - _AWAY * radius_m * direction
    with np.errstate(invalid="ignore"):  # the difference of two infinite ranges
        ours_m, theirs_m, differs = cast(origin_m, direction)
        apart_m = np.abs(ours_m - theirs_m)
        rays = np.flatnonzero(differs)
        moved_m = tolerance_m * rng.uniform(-1, 1, (_BESIDE, 3))
        beside = [cast(origin_m[rays] + each_m, direction[rays]) for each_m in moved_m]
    farthest_m = np.max([ours for ours, _, _ in beside], axis=0)
    lost = (ours_m > theirs_m)[rays] & (farthest_m < (ours_m + theirs_m)[rays] / 2)
    unexplained = lost | (np.mean([differ for *_, differ in beside], axis=0) > 1 / 2)
    order = np.lexsort((-apart_m[rays], ~unexplained))[:3]
    both = np.isfinite(apart_m)
    shares = np.quantile(apart_m[both] if both.any() else [0.0], [0.5, 0.999, 1]).tolist()
    return {
        "triangles": len(corner_m),
        "rays": RAYS,
        "hit_by_both": int(both.sum()),
        "hit_by_lidar_emu_alone": int((ours_m < theirs_m)[~both].sum()),
        "hit_by_embree_alone": int((theirs_m < ours_m)[~both].sum()),
        "apart_m": dict(zip(("median", "p99_9", "largest"), shares, strict=True)),
        "tolerance_m": tolerance_m,
        "differing": len(rays),
        "unexplained": int(unexplained.sum()),
        "worst": [
            {
                "unexplained": bool(unexplained[place]),
                "lidar_emu_m": float(ours_m[ray]) if np.isfinite(ours_m[ray]) else None,
                "embree_m": float(theirs_m[ray]) if np.isfinite(theirs_m[ray]) else None,
                "origin_m": origin_m[ray].tolist(),
                "direction": direction[ray].tolist(),
            }
            for place, ray in zip(order, rays[order], strict=True)
        ],
    }


def _targets(
    corner_m: FloatArray, normal: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Points (RAYS, 3) in triangles, and unit vectors that meet these from the front."""
    chosen = rng.integers(0, len(corner_m), RAYS)
    share = rng.dirichlet(np.ones(3), RAYS)
    share[: RAYS // 5, 2] = 0.0
    share[: RAYS // 20, 1] = 0.0
    share /= share.sum(axis=1, keepdims=True)
    direction = rng.standard_normal((RAYS, 3))
    direction *= -np.sign(dot(direction, normal[chosen]))[:, None]
    direction /= np.sqrt(dot(direction, direction))[:, None]
    return (share[:, :, None] * corner_m[chosen]).sum(axis=1), direction
