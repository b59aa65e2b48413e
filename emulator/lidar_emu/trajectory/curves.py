"""Curves through rows of numbers, Euler angles or quaternions, with their rates."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple, Protocol

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vector_arrays import SITE_FROM_NED, conjugate_product, cross, dot, from_quaternions
from lidar_emu.numerics.vectors import Vector, premultiply, set_from_yaw_pitch_roll


class Curve(NamedTuple):
    """A cubic piece between neighbouring knots; the end pieces continue outside."""

    knot_s: FloatArray
    """(k,) Increasing."""
    coefficients: FloatArray
    """(4, k - 1) Coefficients of the powers 0 to 3 of the time since the piece's first knot."""


LEVEL = Curve(np.array([0.0, 1.0]), np.zeros((4, 1)))
"""Zero at all times."""


class Curves:
    """Curves with their own knots, evaluated together."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        # A knot and the piece that begins there share an index; no piece begins at the last knot of a curve.
        self._first = np.cumsum([0, *(len(curve.knot_s) for curve in curves)])
        self._knot_s = np.concatenate([curve.knot_s for curve in curves])
        self._pieces = np.concatenate([np.pad(curve.coefficients.T, ((0, 1), (0, 0))) for curve in curves])

    def at(self, time_s: FloatArray) -> FloatArray:
        """Values, first and second derivatives (3, n, curves) at times (n,); the derivatives are exact, so that speeds
        are consistent with positions."""
        orders = np.empty((3, len(time_s), len(self._first) - 1))
        _read(self._first, self._knot_s, self._pieces, time_s, orders)
        return orders


@kernel(outermost=True)
def _read(
    first: IntArray, knot_s: FloatArray, pieces: FloatArray, time_s: FloatArray, orders: FloatArray
) -> None:
    for c in range(len(first) - 1):
        for k in range(len(time_s)):
            piece = piece_at(knot_s[first[c] : first[c + 1] - 1], time_s[k])
            since_s = time_s[k] - knot_s[first[c] + piece]
            power = pieces[first[c] + piece]
            orders[0, k, c] = ((power[3] * since_s + power[2]) * since_s + power[1]) * since_s + power[0]
            orders[1, k, c] = (3 * power[3] * since_s + 2 * power[2]) * since_s + power[1]
            orders[2, k, c] = 6 * power[3] * since_s + 2 * power[2]


@kernel
def piece_at(start_s: FloatArray, time_s: float) -> int:
    """Index of the last piece that has begun at a time, given their starts (pieces,); 0 before the first."""
    low, high = 0, len(start_s)
    while high - low > 1:
        middle = (low + high) // 2
        if time_s >= start_s[middle]:
            low = middle
        else:
            high = middle
    return low


def hermite(knot_s: FloatArray, value: FloatArray, rate: FloatArray) -> Curve:
    """Curve through values (k,) with given rates (k,) at knots (k,), k at least 2."""
    step_s = np.diff(knot_s)
    slope = np.diff(value) / step_s
    c2 = (3 * slope - 2 * rate[:-1] - rate[1:]) / step_s
    c3 = (rate[:-1] + rate[1:] - 2 * slope) / step_s**2
    return Curve(knot_s, np.stack([value[:-1], rate[:-1], c2, c3]))


def through(knot_s: FloatArray, value: FloatArray) -> Curve:
    """Curve through values (k,) at knots (k,), k at least 2, with rates derived from the values."""
    step_s = np.diff(knot_s)
    return hermite(knot_s, value, knot_rates(step_s, np.diff(value) / step_s))


def knot_rates(step_s: FloatArray, slope: FloatArray) -> FloatArray:
    """Rates (k,) at the knots, from steps (k - 1,) and their mean rates (k - 1,), by the parabola through each knot and
    its neighbours.

    The rates are exact for constant acceleration, which approximates a landing from row to row, and of second order at
    any spacing. Shape-preserving slopes (PCHIP) are neither: they are zero at every extremum, an error in speed of up
    to half a row's acceleration. A spline with a continuous second derivative is smoother, but one outlier or one long
    gap makes all of its neighbours oscillate.
    """
    if len(slope) == 1:
        return np.repeat(slope, 2)
    inner = (step_s[1:] * slope[:-1] + step_s[:-1] * slope[1:]) / (step_s[:-1] + step_s[1:])
    # A parabola's mean rate over a step is the mean of the rates at its ends.
    return np.concatenate([2 * slope[:1] - inner[:1], inner, 2 * slope[-1:] - inner[-1:]])


class AttitudeCurve(Protocol):
    """Attitude of the body as a function of time."""

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rotations site_from_body (n, 3, 3), body rates (n, 3) in rad/s and their derivatives (n, 3) in rad/s² at
        times (n,)."""


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
