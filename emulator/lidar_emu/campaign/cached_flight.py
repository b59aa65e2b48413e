"""A flight that reuses ground and trajectory of earlier flights, so that a process reads its ground once."""

from __future__ import annotations

from functools import cached_property, lru_cache

from lidar_emu.flight.flight import Flight
from lidar_emu.scenario.trajectory import Trajectory as TrajectoryPart
from lidar_emu.scene.grid.ground import GridGround
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.trajectory.build import build_trajectory
from lidar_emu.trajectory.state import Trajectory

_KEPT = 4
_NOT_OF_THE_GRID = {"name", "surface", "atmosphere", "sunlight_w_per_m2_um", "objects"}


class CachedFlight(Flight):
    """A flight with cached trajectory and whole grids; other ground is quick to build or cropped to the flight."""

    @cached_property
    def trajectory(self) -> Trajectory:
        """See `Flight`."""
        part = self.scenario.trajectory
        return _trajectory(type(part), part.model_dump_json(), self.scenario.site.body.radius_m)

    @cached_property
    def ground(self) -> Scene:
        """See `Flight`."""
        site = self.scenario.site
        kept = _grids(site.model_dump_json(exclude=_NOT_OF_THE_GRID))
        if not kept:
            made = super().ground
            if isinstance(made, GridGround):
                kept.append(made)
            return made
        return kept[0].with_reflectance(site.surface.reflectance)


@lru_cache(_KEPT)
def _grids(_site: str) -> list[GridGround]:
    """Cache entry for the grid of a site."""
    return []


@lru_cache(_KEPT)
def _trajectory(kind: type[TrajectoryPart], part: str, body_radius_m: float) -> Trajectory:
    return build_trajectory(kind.model_validate_json(part), body_radius_m)
