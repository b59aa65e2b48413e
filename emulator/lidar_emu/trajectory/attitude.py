"""Attitude along a flight: a steady turn or Euler angles, with the rates of that same rotation."""

from __future__ import annotations

from math import cos, sin
from typing import Protocol

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.kernels import kernel
from lidar_emu.rotations import (
    chained,
    from_yaw_pitch_roll,
    lead_by,
    set_rotation_vector,
    set_yaw_pitch_roll,
)
from lidar_emu.scenario import trajectory as scenario
from lidar_emu.trajectory.curve import LEVEL, Curve, Curves

SITE_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""East-north-up from the north-east-down in which aerospace angles are counted."""


class Attitude(Protocol):
    """How the body is turned."""

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations site_from_body (n, 3, 3) and body rates (n, 3) in rad/s at times (n,)."""
        ...


class SteadyTurn:
    """R(t) = R(0) exp([rate]x t): constant rate about body axes."""

    def __init__(self, part: scenario.Attitude) -> None:
        yaw, pitch, roll = (np.radians(angle) for angle in (part.yaw_deg, part.pitch_deg, part.roll_deg))
        self._site_from_start = chained(SITE_FROM_NED, from_yaw_pitch_roll(yaw, pitch, roll))
        self._rate_radps = np.array(part.body_rate_radps)

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Attitude`."""
        site_from_body, rate_radps = np.empty((len(time_s), 3, 3)), np.empty((len(time_s), 3))
        _turn(self._site_from_start, self._rate_radps, time_s, site_from_body, rate_radps)
        return site_from_body, rate_radps


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


@kernel
def _turn(
    site_from_start: FloatArray,
    body_rate: FloatArray,
    time_s: FloatArray,
    site_from_body: FloatArray,
    body_rates: FloatArray,
) -> None:
    x, y, z = body_rate[0], body_rate[1], body_rate[2]
    for k in range(len(time_s)):
        set_rotation_vector(time_s[k] * x, time_s[k] * y, time_s[k] * z, site_from_body[k])
        lead_by(site_from_start, site_from_body[k])
        body_rates[k, 0], body_rates[k, 1], body_rates[k, 2] = x, y, z


@kernel
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
