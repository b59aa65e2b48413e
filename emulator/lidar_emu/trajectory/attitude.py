"""Attitude along a flight: a steady turn or Euler angles, with the rates of that same rotation."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.rotations import chained, from_rotation_vector, from_yaw_pitch_roll
from lidar_emu.scenario import trajectory as scenario
from lidar_emu.trajectory.curve import Curve

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
        start_from_body = from_rotation_vector(time_s[:, None] * self._rate_radps)
        return chained(self._site_from_start, start_from_body), np.tile(self._rate_radps, (len(time_s), 1))


class EulerAttitude:
    """Curves of yaw, pitch and roll in radians; an angle left out is 0."""

    def __init__(self, yaw: Curve | None, pitch: Curve | None, roll: Curve | None) -> None:
        self._curves = yaw, pitch, roll

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Attitude`. This way round there is no singularity, not even at a pitch of 90 degrees."""
        still = np.zeros_like(time_s)
        read = [(still, still) if curve is None else curve.at(time_s)[:2] for curve in self._curves]
        (yaw, yaw_rate), (pitch, pitch_rate), (roll, roll_rate) = read
        pitch_cos, roll_sin, roll_cos = np.cos(pitch), np.sin(roll), np.cos(roll)
        body_rate = [
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * roll_cos + yaw_rate * pitch_cos * roll_sin,
            yaw_rate * pitch_cos * roll_cos - pitch_rate * roll_sin,
        ]
        return chained(SITE_FROM_NED, from_yaw_pitch_roll(yaw, pitch, roll)), np.stack(body_rate, axis=-1)
