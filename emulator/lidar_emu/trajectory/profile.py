"""A straight path with constant acceleration between waypoints, and constant body rates."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import premultiply, set_from_rotation_vector
from lidar_emu.numerics.vector_arrays import (
    SITE_FROM_NED,
    compose,
    from_yaw_pitch_roll,
)
from lidar_emu.scenario.trajectory import Profile
from lidar_emu.trajectory.curve import piece_at
from lidar_emu.trajectory.state import Gap, VehicleState


class _Legs(NamedTuple):
    """The legs of a path, (legs,) each."""

    start_s: FloatArray
    start_site_m: FloatArray
    """(legs, 3)"""
    start_speed_mps: FloatArray
    acceleration_mps2: FloatArray


class ProfileTrajectory:
    """Legs between waypoints, in closed form; the motion of the first and the last leg continues outside."""

    gaps: tuple[Gap, ...] = ()
    bridged: tuple[Gap, ...] = ()

    def __init__(self, part: Profile) -> None:
        altitude_m = np.array([waypoint.altitude_m for waypoint in part.waypoints])
        speed_mps = np.array([waypoint.speed_mps for waypoint in part.waypoints])
        path_rad, heading_rad = np.radians(part.path_angle_deg), np.radians(part.heading_deg)
        length_m = (altitude_m[:-1] - altitude_m[1:]) / np.sin(path_rad)
        # Holds for equal speeds and for a stop, where dv/a would be 0/0 or cancel.
        leg_s = 2 * length_m / (speed_mps[:-1] + speed_mps[1:])
        leg_end_s = np.cumsum(leg_s)
        self.duration_s = float(leg_end_s[-1])
        self._direction_site = np.array(
            [
                np.cos(path_rad) * np.sin(heading_rad),
                np.cos(path_rad) * np.cos(heading_rad),
                -np.sin(path_rad),
            ]
        )
        self._legs = _Legs(
            start_s=np.concatenate([[0.0], leg_end_s[:-1]]),
            start_site_m=_on_path(part, altitude_m[:-1], self._direction_site),
            start_speed_mps=speed_mps[:-1],
            acceleration_mps2=(speed_mps[1:] - speed_mps[:-1]) / leg_s,
        )
        angles_deg = part.attitude.yaw_deg, part.attitude.pitch_deg, part.attitude.roll_deg
        self._site_from_start = compose(SITE_FROM_NED, from_yaw_pitch_roll(*np.radians(angles_deg)))
        self._body_rate_radps = np.array(part.attitude.body_rate_radps)

    def state(self, time_s: FloatArray) -> VehicleState:
        """State of the vehicle at scenario times (n,)."""
        state = VehicleState.unfilled(time_s)
        _fly(
            tuple(self._legs),
            self._direction_site,
            self._site_from_start,
            self._body_rate_radps,
            tuple(state),
        )
        return state


@kernel(outermost=True)
def _fly(
    leg_arrays: tuple[Any, ...],
    direction_site: FloatArray,
    site_from_start: FloatArray,
    body_rate_radps: FloatArray,
    state_arrays: tuple[Any, ...],
) -> None:
    """Fill the arrays of a `VehicleState` at its times, from the arrays of `_Legs`.

    The turn about body axes is steady: R(t) = R(0) exp([rate]x t).
    """
    legs, vehicle = _Legs(*leg_arrays), VehicleState(*state_arrays)
    x, y, z = body_rate_radps[0], body_rate_radps[1], body_rate_radps[2]
    for k in range(len(vehicle.time_s)):
        time_s = vehicle.time_s[k]
        leg = piece_at(legs.start_s, time_s)
        since_s, acceleration_mps2 = time_s - legs.start_s[leg], legs.acceleration_mps2[leg]
        speed_mps = legs.start_speed_mps[leg] + acceleration_mps2 * since_s
        flown_m = (legs.start_speed_mps[leg] + 0.5 * acceleration_mps2 * since_s) * since_s
        for axis in range(3):
            vehicle.position_site_m[k, axis] = legs.start_site_m[leg, axis] + flown_m * direction_site[axis]
            vehicle.velocity_site_mps[k, axis] = speed_mps * direction_site[axis]
            vehicle.acceleration_site_mps2[k, axis] = acceleration_mps2 * direction_site[axis]
            vehicle.body_rate_radps[k, axis] = body_rate_radps[axis]
        set_from_rotation_vector(time_s * x, time_s * y, time_s * z, vehicle.site_from_body[k])
        premultiply(site_from_start, vehicle.site_from_body[k])


def _on_path(part: Profile, altitude_m: FloatArray, direction_site: FloatArray) -> FloatArray:
    """Points (k, 3) of the path's line at altitudes (k,)."""
    before_target_m = altitude_m / direction_site[2]
    east_m = part.target_east_m + before_target_m * direction_site[0]
    north_m = part.target_north_m + before_target_m * direction_site[1]
    return np.stack([east_m, north_m, altitude_m], axis=-1)
