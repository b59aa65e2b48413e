"""From the scenario's part to a trajectory."""

from __future__ import annotations

from lidar_emu.scenario.trajectory import Profile, Table
from lidar_emu.trajectory.profile import ProfileTrajectory
from lidar_emu.trajectory.state import Trajectory
from lidar_emu.trajectory.table import TableTrajectory


def build_trajectory(part: Profile | Table) -> Trajectory:
    """The flight that the scenario describes.

    Raises:
        InputError: the file of a table cannot be used; names the file, the column and the value.
    """
    return ProfileTrajectory(part) if isinstance(part, Profile) else TableTrajectory(part)
