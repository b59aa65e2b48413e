"""From the scenario's part to a trajectory."""

from __future__ import annotations

from lidar_emu.scenario.trajectory import Live, Profile, Table
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.trajectory.profile import ProfileTrajectory
from lidar_emu.trajectory.state import Trajectory
from lidar_emu.trajectory.table import TableTrajectory


def build_trajectory(part: Profile | Table | Live) -> Trajectory:
    """The flight that the scenario describes.

    Raises:
        InputError: the file of a table cannot be used; names the file, the column and the value.
    """
    if isinstance(part, Live):
        return LiveTrajectory(part.jump_m)
    return ProfileTrajectory(part) if isinstance(part, Profile) else TableTrajectory(part)
