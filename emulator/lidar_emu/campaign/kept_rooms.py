"""Ground and trajectory of the last few runs, for those that have the same: a process reads its ground once."""

from __future__ import annotations

from functools import lru_cache

from lidar_emu.flight import Rooms
from lidar_emu.scenario.site import Site
from lidar_emu.scenario.trajectory import Trajectory as TrajectoryPart
from lidar_emu.scene.build import build_scene
from lidar_emu.scene.hits import Scene
from lidar_emu.trajectory.build import build_trajectory
from lidar_emu.trajectory.state import Trajectory

_KEPT = 4
_NOT_OF_THE_GROUND = {"name", "surface", "atmosphere", "sunlight_w_per_m2_um"}


def _scene(site: Site) -> Scene:
    return _scene_of(site.model_dump_json(exclude=_NOT_OF_THE_GROUND))


@lru_cache(_KEPT)
def _scene_of(site: str) -> Scene:
    return build_scene(Site.model_validate_json(site))


def _trajectory(part: TrajectoryPart, body_radius_m: float) -> Trajectory:
    return _trajectory_of(type(part), part.model_dump_json(), body_radius_m)


@lru_cache(_KEPT)
def _trajectory_of(kind: type[TrajectoryPart], part: str, body_radius_m: float) -> Trajectory:
    return build_trajectory(kind.model_validate_json(part), body_radius_m)


KEPT_ROOMS = Rooms(_trajectory, _scene)
