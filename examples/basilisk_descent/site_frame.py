"""Conversion between the inertial frame of a dynamics simulator and the site frame, which rotates with the ground."""

from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SiteFrame:
    """East, north, up at a point of a body whose centre is the inertial origin and whose axis is inertial z.

    Args:
        latitude_deg, longitude_deg: position of the site; longitude 0 lies in the inertial xz plane at time 0.
        radius_m: distance of the site's origin from the body's centre.
        turning_radps: angular rate of the body.
    """

    def __init__(
        self, latitude_deg: float, longitude_deg: float, radius_m: float, turning_radps: float
    ) -> None:
        self._latitude_rad, self._longitude_rad = radians(latitude_deg), radians(longitude_deg)
        self._origin_site_m = np.array([0.0, 0.0, radius_m])
        self._turning_radps = turning_radps
        self.rate_inertial_radps = np.array([0.0, 0.0, turning_radps])

    def site_from_inertial(self, time_s: float) -> Array:
        """Rotation matrix (3, 3)."""
        longitude_rad = self._longitude_rad + self._turning_radps * time_s
        s, c = sin(longitude_rad), cos(longitude_rad)
        sin_lat, cos_lat = sin(self._latitude_rad), cos(self._latitude_rad)
        east, north = [-s, c, 0.0], [-sin_lat * c, -sin_lat * s, cos_lat]
        return np.array([east, north, [cos_lat * c, cos_lat * s, sin_lat]])

    def to_site(self, time_s: float, position_m: Array, velocity_mps: Array) -> tuple[Array, Array]:
        """Position and velocity relative to the ground, including ω × r."""
        turn = self.site_from_inertial(time_s)
        against_ground_mps = velocity_mps - np.cross(self.rate_inertial_radps, position_m)
        return turn @ position_m - self._origin_site_m, turn @ against_ground_mps

    def to_inertial(self, time_s: float, position_m: Array, velocity_mps: Array) -> tuple[Array, Array]:
        """The inverse of `to_site`."""
        turn = self.site_from_inertial(time_s).T
        position_inertial_m = turn @ (position_m + self._origin_site_m)
        carried_mps = np.cross(self.rate_inertial_radps, position_inertial_m)
        return position_inertial_m, turn @ velocity_mps + carried_mps
