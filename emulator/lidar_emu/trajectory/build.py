"""Construction of a trajectory from the scenario."""

from __future__ import annotations

from math import inf

from lidar_emu.scenario.trajectory import Live, PoweredDescent, Profile, Table
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.profile import ProfileTrajectory, Trajectory
from lidar_emu.trajectory.table import TableTrajectory


def build_trajectory(part: Profile | Table | Live | PoweredDescent, body_radius_m: float = inf) -> Trajectory:
    """Build the trajectory of a scenario.

    Args:
        part: the scenario's `trajectory`.
        body_radius_m: radius of the celestial body, on which the gravity of a powered descent depends.

    Raises:
        InputError: the file of a table cannot be used (names file, column and value), or a powered descent does not
            land.
    """
    if isinstance(part, PoweredDescent):
        from lidar_emu.trajectory.powered.solution import DescentTrajectory

        return DescentTrajectory(part, body_radius_m)
    if isinstance(part, Live):
        return LiveTrajectory(round(part.stale_after_s * 1e9))
    return ProfileTrajectory(part) if isinstance(part, Profile) else TableTrajectory(part)
