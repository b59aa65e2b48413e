"""A straight path with constant acceleration between waypoints, and constant body rates."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.numerics.vector_arrays import SITE_FROM_NED, compose, from_yaw_pitch_roll
from lidar_emu.numerics.vectors import premultiply, set_from_rotation_vector
from lidar_emu.scenario.trajectory import Profile
from lidar_emu.trajectory.curves import piece_at


def seconds(time_ns: IntArray) -> FloatArray:
    """Convert instants to seconds, the unit of trajectories."""
    return time_ns.astype(np.float64) * 1e-9


class Gap(NamedTuple):
    """Two neighbouring filled cells of a column, bridged by interpolation."""

    column: str
    start_s: float
    """Scenario time of the first cell; negative where the gap began before the part flown."""
    length_s: float


class VehicleState(NamedTuple):
    """True motion of the vehicle's reference point at n instants; all arrays are in C order, as kernels require.

    Site frame: east, north, up. Body frame: x forward, y right, z down.
    """

    time_s: FloatArray
    """(n,) Scenario time."""
    position_site_m: FloatArray
    """(n, 3)"""
    velocity_site_mps: FloatArray
    """(n, 3)"""
    acceleration_site_mps2: FloatArray
    """(n, 3)"""
    site_from_body: FloatArray
    """(n, 3, 3) Rotations."""
    body_rate_radps: FloatArray
    """(n, 3) Angular rate of the body against the site, about body x, y and z."""
    angular_acceleration_body_radps2: FloatArray
    """(n, 3) Rate of `body_rate_radps`, which is also the angular acceleration against the site, in body axes."""

    @classmethod
    def unfilled(cls, time_s: FloatArray) -> Self:
        """Allocate arrays for a kernel to fill."""
        vector, matrix = (len(time_s), 3), (len(time_s), 3, 3)
        moving = np.empty(vector), np.empty(vector), np.empty(vector)
        return cls(time_s, *moving, np.empty(matrix), np.empty(vector), np.empty(vector))


class Trajectory(Protocol):
    """A flight from scenario time 0 on."""

    duration_s: float
    """Scenario time at which the flight ends."""
    gaps: tuple[Gap, ...] = ()
    """Longest gap of each column of a table in the part flown, in descending order."""
    bridged: tuple[Gap, ...] = ()
    """Bridged gaps of a table, longer than its maximum, in order."""

    def state(self, time_s: FloatArray) -> VehicleState:
        """State of the vehicle at scenario times (n,); slightly outside [0, duration] the motion is extrapolated.

        The bits at an instant do not depend on the other instants requested.
        """


LEG = np.dtype(
    [
        ("start_s", float),
        ("start_site_m", float, 3),
        ("start_speed_mps", float),
        ("acceleration_mps2", float),
        ("direction_site", float, 3),
        ("site_from_start", float, (3, 3)),
        ("body_rate_radps", float, 3),
    ]
)
"""A leg in kernels. Direction, attitude at scenario time 0 and body rate are the same in all legs of a path."""


class ProfileTrajectory(Trajectory):
    """Legs between waypoints, in closed form; the motion of the first and the last leg continues outside."""

    def __init__(self, part: Profile) -> None:
        altitude_m = np.array([waypoint.altitude_m for waypoint in part.waypoints])
        speed_mps = np.array([waypoint.speed_mps for waypoint in part.waypoints])
        path_rad, heading_rad = np.radians(part.path_angle_deg), np.radians(part.heading_deg)
        length_m = (altitude_m[:-1] - altitude_m[1:]) / np.sin(path_rad)
        # Holds for equal speeds and for a stop, where dv/a would be 0/0 or cancel.
        leg_s = 2 * length_m / (speed_mps[:-1] + speed_mps[1:])
        leg_end_s = np.cumsum(leg_s)
        self.duration_s = float(leg_end_s[-1])
        direction_site = np.array(
            [
                np.cos(path_rad) * np.sin(heading_rad),
                np.cos(path_rad) * np.cos(heading_rad),
                -np.sin(path_rad),
            ]
        )
        angles_deg = part.attitude.yaw_deg, part.attitude.pitch_deg, part.attitude.roll_deg
        self._legs = with_fields(np.empty(len(leg_s), dtype=LEG))
        self._legs["start_s"] = np.concatenate([[0.0], leg_end_s[:-1]])
        self._legs["start_site_m"] = _on_path(part, altitude_m[:-1], direction_site)
        self._legs["start_speed_mps"] = speed_mps[:-1]
        self._legs["acceleration_mps2"] = (speed_mps[1:] - speed_mps[:-1]) / leg_s
        self._legs["direction_site"] = direction_site
        self._legs["site_from_start"] = compose(SITE_FROM_NED, from_yaw_pitch_roll(*np.radians(angles_deg)))
        self._legs["body_rate_radps"] = part.attitude.body_rate_radps

    def state(self, time_s: FloatArray) -> VehicleState:
        state = VehicleState.unfilled(time_s)
        _fly(self._legs, tuple(state))
        return state


@kernel(outermost=True)
def _fly(legs: NDArray[np.void], state_arrays: tuple[Any, ...]) -> None:
    """Fill the arrays of a `VehicleState` at its times from legs (n,) of `LEG`.

    The turn about body axes is steady: R(t) = R(0) exp([rate]x t).
    """
    state = VehicleState(*state_arrays)
    time_s, site_from_body = state.time_s, state.site_from_body
    for k in range(len(time_s)):
        leg = legs[piece_at(legs.start_s, time_s[k])]  # type: ignore[attr-defined]
        since_s, growth_mps2 = time_s[k] - leg.start_s, leg.acceleration_mps2
        speed_mps = leg.start_speed_mps + growth_mps2 * since_s
        flown_m = (leg.start_speed_mps + 0.5 * growth_mps2 * since_s) * since_s
        direction, rate = leg.direction_site, leg.body_rate_radps
        for axis in range(3):
            state.position_site_m[k, axis] = leg.start_site_m[axis] + flown_m * direction[axis]
            state.velocity_site_mps[k, axis] = speed_mps * direction[axis]
            state.acceleration_site_mps2[k, axis] = growth_mps2 * direction[axis]
            state.body_rate_radps[k, axis] = rate[axis]
            state.angular_acceleration_body_radps2[k, axis] = 0.0
        x_rad, y_rad, z_rad = time_s[k] * rate[0], time_s[k] * rate[1], time_s[k] * rate[2]
        set_from_rotation_vector(x_rad, y_rad, z_rad, site_from_body[k])
        premultiply(leg.site_from_start, site_from_body[k])


def _on_path(part: Profile, altitude_m: FloatArray, direction_site: FloatArray) -> FloatArray:
    before_target_m = altitude_m / direction_site[2]
    east_m = part.target_east_m + before_target_m * direction_site[0]
    north_m = part.target_north_m + before_target_m * direction_site[1]
    return np.stack([east_m, north_m, altitude_m], axis=-1)
