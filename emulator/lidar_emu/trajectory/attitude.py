"""Attitude curves through rows of Euler angles or quaternions, with consistent body rates."""

from __future__ import annotations

from math import cos, sin
from typing import Protocol

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import premultiply, set_from_yaw_pitch_roll
from lidar_emu.numerics.vector_arrays import (
    SITE_FROM_NED,
    conjugate_product,
    cross,
    dot,
    from_quaternions,
)
from lidar_emu.numerics.vectors import Vector
from lidar_emu.trajectory.curve import LEVEL, Curve, Curves, hermite, knot_rates


class AttitudeCurve(Protocol):
    """Attitude of the body as a function of time."""

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rotations site_from_body (n, 3, 3), body rates (n, 3) in rad/s and their derivatives (n, 3) in rad/s² at
        times (n,)."""
        ...


class EulerAttitude:
    """Curves of yaw, pitch and roll in radians; an angle left out is 0."""

    def __init__(self, yaw: Curve | None, pitch: Curve | None, roll: Curve | None) -> None:
        self._curves = Curves([curve or LEVEL for curve in (yaw, pitch, roll)])

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See `AttitudeCurve`; rates from angles have no singularity, not even at a pitch of 90 degrees."""
        angles, rates, bends = self._curves.at(time_s)
        site_from_body, vector = np.empty((len(time_s), 3, 3)), (len(time_s), 3)
        body_rate, acceleration = np.empty(vector), np.empty(vector)
        _from_euler(SITE_FROM_NED, angles, rates, bends, site_from_body, body_rate, acceleration)
        return site_from_body, body_rate, acceleration


@kernel(outermost=True)
def _from_euler(
    site_from_ned: FloatArray,
    angles: FloatArray,
    rates: FloatArray,
    bends: FloatArray,
    site_from_body: FloatArray,
    body_rate: FloatArray,
    acceleration: FloatArray,
) -> None:
    """Set the last three from yaw, pitch and roll (n, 3) in radians, their rates and their second derivatives."""
    for k in range(len(angles)):
        yaw, pitch, roll = angles[k, 0], angles[k, 1], angles[k, 2]
        yaw_rate, pitch_rate, roll_rate = rates[k, 0], rates[k, 1], rates[k, 2]
        set_from_yaw_pitch_roll(yaw, pitch, roll, site_from_body[k])
        premultiply(site_from_ned, site_from_body[k])
        # The rates of yaw and of pitch act about axes that turn with the angles after them.
        x, y, z = _about_body(yaw_rate, pitch_rate, pitch, roll)
        body_rate[k, 0], body_rate[k, 1], body_rate[k, 2] = roll_rate + x, y, z
        bend_x, bend_y, bend_z = _about_body(bends[k, 0], bends[k, 1], pitch, roll)
        acceleration[k, 0] = bends[k, 2] + bend_x - yaw_rate * pitch_rate * cos(pitch)
        tilting = yaw_rate * pitch_rate * sin(pitch)
        acceleration[k, 1] = bend_y + roll_rate * z - tilting * sin(roll)
        acceleration[k, 2] = bend_z - roll_rate * y - tilting * cos(roll)


@kernel
def _about_body(yaw_rate: float, pitch_rate: float, pitch: float, roll: float) -> Vector:
    """Rates about the body's axes by rates of yaw and pitch alone."""
    return (
        -yaw_rate * sin(pitch),
        pitch_rate * cos(roll) + yaw_rate * cos(pitch) * sin(roll),
        yaw_rate * cos(pitch) * cos(roll) - pitch_rate * sin(roll),
    )


class QuaternionAttitude:
    """Cubic Hermite curve in the four components, normalised on evaluation.

    The rates at the rows derive from the rotations between them, so that a steady turn keeps its rate.
    """

    def __init__(self, knot_s: FloatArray, site_from_body: FloatArray) -> None:
        """`site_from_body`: unit quaternions (k, 4) of either sign at knots (k,), k at least 2."""
        quaternion = _of_one_sign(site_from_body)
        derivative = _derivatives(knot_s, quaternion)
        self._curves = Curves([hermite(knot_s, quaternion[:, i], derivative[:, i]) for i in range(4)])

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See `AttitudeCurve`."""
        return from_quaternions(self._curves.at(time_s))


def _of_one_sign(quaternion: FloatArray) -> FloatArray:
    """Choose between q and -q, which are the same attitude, the one nearer to the preceding row."""
    along, _ = conjugate_product(quaternion[:-1], quaternion[1:])
    sign = np.cumprod(np.where(along < 0, -1.0, 1.0))
    return np.concatenate([quaternion[:1], sign[:, None] * quaternion[1:]])


def _derivatives(knot_s: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Derivatives (k, 4) at the knots, dq/dt = q (0, rate) / 2."""
    step_s = np.diff(knot_s)
    step_cos, step_sin_axis = conjugate_product(quaternion[:-1], quaternion[1:])
    half_turn = np.arctan2(np.sqrt(dot(step_sin_axis, step_sin_axis)), step_cos)
    mean_rate = 2 * step_sin_axis / (np.sinc(half_turn / np.pi) * step_s)[:, None]
    rate = np.stack([knot_rates(step_s, mean_rate[:, axis]) for axis in range(3)], axis=-1)
    scalar, vector = quaternion[:, 0], quaternion[:, 1:]
    turning = scalar[:, None] * rate + cross(vector, rate)
    return 0.5 * np.concatenate([-dot(vector, rate)[:, None], turning], axis=1)
