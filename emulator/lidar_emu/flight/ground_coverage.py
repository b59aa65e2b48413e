"""Check that a flight stays over its ground."""

from __future__ import annotations

import numpy as np

from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.generated_ground import Generated
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.site import ElevationGrid, Nested
from lidar_emu.scene.ray_hits import Scene
from lidar_emu.trajectory.state import Trajectory, seconds

_CHECKED_SHOTS = 4096


def may_leave_its_ground(scenario: FlightScenario) -> bool:
    """Whether the site has an edge, and the trajectory is known in advance."""
    ground = scenario.site.ground
    return (
        isinstance(ground, ElevationGrid | Generated | Nested)
        and ground.beyond == "none"
        and scenario.live is None
    )


def refuse_to_leave(
    scenario: FlightScenario, trajectory: Trajectory, ground: Scene, shots: int, period_ns: int
) -> None:
    """Refuse a flight in which a shot begins where there is no ground.

    Raises:
        InputError: names the first such position.
    """
    for first in range(0, shots, _CHECKED_SHOTS):
        shot = np.arange(first, min(first + _CHECKED_SHOTS, shots), dtype=np.int64)
        _refuse_outside(scenario, trajectory, ground, seconds(shot * period_ns))


def _refuse_outside(
    scenario: FlightScenario, trajectory: Trajectory, ground: Scene, time_s: FloatArray
) -> None:
    position_m = trajectory.state(time_s).position_site_m
    outside = np.flatnonzero(~ground.covers(position_m[:, 0], position_m[:, 1]))
    if outside.size:
        east_m, north_m, up_m = position_m[outside[0]]
        place = f"{east_m:.1f} m east, {north_m:.1f} m north, {up_m:.1f} m up"
        found = Finding(f"off the ground ({ground.description}) at {time_s[outside[0]]:.3f} s: {place}")
        remedy = "stay over the ground, or continue it by beyond: plane or sphere"
        raise InputError(scenario.name, "trajectory", found, remedy)
