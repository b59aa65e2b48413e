"""Attitude along a flight through rows of Euler angles, with the rates of that same rotation."""

from __future__ import annotations

from math import cos, sin
from typing import Protocol

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import SITE_FROM_NED, lead_by, set_yaw_pitch_roll
from lidar_emu.trajectory.curve import LEVEL, Curve, Curves


class Attitude(Protocol):
    """How the body is turned."""

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations site_from_body (n, 3, 3) and body rates (n, 3) in rad/s at times (n,)."""
        ...


class EulerAttitude:
    """Curves of yaw, pitch and roll in radians; an angle left out is 0."""

    def __init__(self, yaw: Curve | None, pitch: Curve | None, roll: Curve | None) -> None:
        self._curves = Curves([curve or LEVEL for curve in (yaw, pitch, roll)])

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Attitude`. This way round there is no singularity, not even at a pitch of 90 degrees."""
        angles, rates, _ = self._curves.at(time_s)
        site_from_body, body_rate = np.empty((len(time_s), 3, 3)), np.empty((len(time_s), 3))
        _from_euler(SITE_FROM_NED, angles, rates, site_from_body, body_rate)
        return site_from_body, body_rate


@kernel(outermost=True)
def _from_euler(
    site_from_ned: FloatArray,
    angles: FloatArray,
    rates: FloatArray,
    site_from_body: FloatArray,
    body_rate: FloatArray,
) -> None:
    """Of yaw, pitch and roll (n, 3) and their rates."""
    for k in range(len(angles)):
        yaw, pitch, roll = angles[k, 0], angles[k, 1], angles[k, 2]
        yaw_rate, pitch_rate, roll_rate = rates[k, 0], rates[k, 1], rates[k, 2]
        set_yaw_pitch_roll(yaw, pitch, roll, site_from_body[k])
        lead_by(site_from_ned, site_from_body[k])
        body_rate[k, 0] = roll_rate - yaw_rate * sin(pitch)
        body_rate[k, 1] = pitch_rate * cos(roll) + yaw_rate * cos(pitch) * sin(roll)
        body_rate[k, 2] = yaw_rate * cos(pitch) * cos(roll) - pitch_rate * sin(roll)
