"""State of the vehicle along a trajectory."""

from __future__ import annotations

from typing import NamedTuple, Protocol, Self

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray


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

    @property
    def duration_s(self) -> float:
        """Scenario time at which the flight ends."""
        ...

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Longest gap of each column of a table in the part flown, in descending order; empty for profiles."""
        ...

    @property
    def bridged(self) -> tuple[Gap, ...]:
        """Bridged gaps of a table, longer than its maximum, in order."""
        ...

    def state(self, time_s: FloatArray) -> VehicleState:
        """State of the vehicle at scenario times (n,); slightly outside [0, duration] the motion is extrapolated.

        The bits at an instant do not depend on the other instants requested.
        """
        ...
