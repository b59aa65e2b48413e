"""A ground with static and moving objects."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.scene.mesh.model import TriangleMesh
from lidar_emu.scene.objects.motion import MovingObject
from lidar_emu.scene.ray_hits import Hits, Scene


class PopulatedScene:
    """A ground with static objects.

    Args:
        ground: the ground.
        mesh: all objects, in the site frame.
        description: description of the objects, for plans.
    """

    def __init__(self, ground: Scene, mesh: TriangleMesh, description: str) -> None:
        self._ground, self._mesh = ground, mesh
        self.description = f"{ground.description}; {description}"
        self.origin_altitude_m, self.covers = ground.origin_altitude_m, ground.covers

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        """First contact with the ground or an object; see `Scene.cast`."""
        hits = self._ground.cast(origin_site_m, direction_site, hits, bundle)
        hits.keep_nearer(self._mesh.cast(origin_site_m, direction_site))
        return hits

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        """Height (n,) of the ground, or of the top of the highest object there."""
        ground_m = self._ground.height_m(east_m, north_m)
        return np.fmax(ground_m, self._mesh.top_m(east_m, north_m))


class SceneInMotion:
    """A static scene with moving objects.

    Heights and coverage come from the static scene.

    Args:
        still: the static scene.
        moving: the moving objects.
        description: description of the moving objects, for plans.
    """

    def __init__(self, still: Scene, moving: list[MovingObject], description: str) -> None:
        self.still, self._moving = still, moving
        self.description = f"{still.description}; {description}"
        self.origin_altitude_m = still.origin_altitude_m
        self.height_m, self.covers = still.height_m, still.covers

    def cast(
        self,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
        bundle: int = 1,
    ) -> Hits:
        """First contact at the start of the run; see `Scene.cast`."""
        start_ns = np.zeros(max(len(direction_site) // bundle, 1), dtype=np.int64)
        return self.cast_at(start_ns, origin_site_m, direction_site, hits)

    def cast_at(
        self,
        time_ns: IntArray,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits | None = None,
    ) -> Hits:
        hits = hits or Hits.empty(len(origin_site_m), moving=True)
        hits = self.still.cast(
            origin_site_m, direction_site, hits, bundle=max(len(direction_site) // len(time_ns), 1)
        )
        hits.velocity_site_mps[:] = np.where(np.isnan(hits.range_m), np.nan, 0.0)[:, None]
        for each in self._moving:
            each.meet(time_ns, origin_site_m, direction_site, hits)
        return hits
