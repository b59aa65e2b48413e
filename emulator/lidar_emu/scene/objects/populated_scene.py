"""A ground with static and moving objects."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.scenario.objects import Motion
from lidar_emu.scene.mesh.ground import TriangleMesh
from lidar_emu.scene.ray_hits import Hits, RayCaster, Scene
from lidar_emu.trajectory.profile import seconds


class MovingObject:
    """A moving object.

    Args:
        mesh: mesh about the object's position, in the site's axes at the start.
        place_site_m: (3,) position at the start.
        motion: motion from there.
    """

    def __init__(self, mesh: TriangleMesh, place_site_m: FloatArray, motion: Motion) -> None:
        self.mesh, self._start_site_m, self._motion = mesh, place_site_m, motion
        self._reach_m = float(np.sqrt(np.maximum(mesh.low_m**2, mesh.high_m**2).sum()))

    def poses(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and velocities, (m, 3) each, at m times since the start."""
        waypoints = self._motion.waypoints
        if waypoints is None:
            velocity_mps = np.array(self._motion.velocity_mps or (0.0, 0.0, 0.0))
            velocities_mps = np.broadcast_to(velocity_mps, (len(time_s), 3))
            return self._start_site_m + time_s[:, None] * velocity_mps, velocities_mps
        at_s = np.array([point.time_s for point in waypoints])
        at_m = np.array([(point.east_m, point.north_m, point.up_m) for point in waypoints])
        # At rest before the first and after the last waypoint.
        leg_mps = np.pad(np.diff(at_m, axis=0) / np.diff(at_s)[:, None], ((1, 1), (0, 0)))
        place_m = np.stack([np.interp(time_s, at_s, at_m[:, axis]) for axis in range(3)], axis=-1)
        return place_m, leg_mps[np.searchsorted(at_s, time_s, side="right")]

    def meet(
        self,
        time_ns: IntArray,
        origin_site_m: FloatArray,
        direction_site: FloatArray,
        hits: Hits,
    ) -> None:
        """Replace the hits of rays that hit this object first; see `MovingScene.cast_at`."""
        poses = self.poses(seconds(time_ns))
        each = len(origin_site_m) // len(time_ns)
        place_m, velocity_mps = (np.repeat(column, each, axis=0) for column in poses)
        rows = np.flatnonzero(_passes(origin_site_m, direction_site, place_m, self._reach_m))
        if not rows.size:
            return
        found = self.mesh.cast(origin_site_m[rows] - place_m[rows], direction_site[rows])
        hits.keep_nearer(found._replace(velocity_site_mps=velocity_mps[rows]), rows)


def _passes(origin_m: FloatArray, direction: FloatArray, centre_m: FloatArray, reach_m: float) -> FloatArray:
    to_centre_m = centre_m - origin_m
    along_m = np.maximum((to_centre_m * direction).sum(axis=1), 0.0)
    beside_m = to_centre_m - along_m[:, None] * direction
    return np.asarray((beside_m * beside_m).sum(axis=1) <= (reach_m * (1 + 1e-9)) ** 2)


class PopulatedScene(RayCaster):
    """A ground with static objects.

    Args:
        ground: the ground.
        mesh: all objects, in the site frame.
        description: description of the objects, for plans.
    """

    def __init__(self, ground: Scene, mesh: TriangleMesh, description: str) -> None:
        self.ground, self.mesh = ground, mesh
        self.description = f"{ground.description}; {description}"
        self.origin_altitude_m, self.covers = ground.origin_altitude_m, ground.covers

    def _fill(self, origin: FloatArray, direction: FloatArray, hits: Hits, bundle: int) -> None:
        self.ground.cast(origin, direction, hits, bundle)
        hits.keep_nearer(self.mesh.cast(origin, direction))

    def height_m(self, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        ground_m = self.ground.height_m(east_m, north_m)
        return np.fmax(ground_m, self.mesh.top_m(east_m, north_m))


class SceneInMotion:
    """A static scene with moving objects.

    Heights and coverage come from the static scene.

    Args:
        still: the static scene.
        moving: the moving objects.
        description: description of the moving objects, for plans.
    """

    def __init__(self, still: Scene, moving: list[MovingObject], description: str) -> None:
        self.still, self.moving = still, moving
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
        for each in self.moving:
            each.meet(time_ns, origin_site_m, direction_site, hits)
        return hits
