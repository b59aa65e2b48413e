"""Attitude through rows of quaternions: scalar first, unit, Hamilton, site_from_body."""

from __future__ import annotations

from math import sqrt

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.rotations import cross, dot
from lidar_emu.trajectory.curve import Curves, hermite, knot_rates


class QuaternionAttitude:
    """Cubic Hermite in the four components, made unit where it is read.

    The rates at the rows come from the turns between them, so that a steady turn keeps its rate there.
    """

    def __init__(self, knot_s: FloatArray, site_from_body: FloatArray) -> None:
        """`site_from_body`: unit quaternions (k, 4) of either sign at knots (k,), k at least 2."""
        quaternion = _of_one_sign(site_from_body)
        derivative = _derivatives(knot_s, quaternion)
        self._curves = Curves([hermite(knot_s, quaternion[:, i], derivative[:, i]) for i in range(4)])

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations site_from_body (n, 3, 3) and body rates (n, 3) in rad/s at times (n,).

        The rate is the vector part of 2 q* dq/dt; the change of the curve's length is in the scalar part.
        """
        quaternion, derivative, _ = self._curves.at(time_s)
        return rotate_by(quaternion, derivative)


def rotate_by(quaternion: FloatArray, derivative: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotations (n, 3, 3) and rates (n, 3) about the source's axes, of quaternions (n, 4) of any length and their
    derivatives."""
    rotation, rate = np.empty((len(quaternion), 3, 3)), np.empty((len(quaternion), 3))
    _from_quaternions(quaternion, derivative, rotation, rate)
    return rotation, rate


@kernel(outermost=True)
def _from_quaternions(
    quaternion: FloatArray, derivative: FloatArray, site_from_body: FloatArray, body_rate: FloatArray
) -> None:
    """Of quaternions (n, 4) of any length and their derivatives."""
    for k in range(len(quaternion)):
        w, x, y, z = quaternion[k, 0], quaternion[k, 1], quaternion[k, 2], quaternion[k, 3]
        dw, dx, dy, dz = derivative[k, 0], derivative[k, 1], derivative[k, 2], derivative[k, 3]
        squared = w * w + x * x + y * y + z * z
        body_rate[k, 0] = 2 * (w * dx - dw * x - (y * dz - z * dy)) / squared
        body_rate[k, 1] = 2 * (w * dy - dw * y - (z * dx - x * dz)) / squared
        body_rate[k, 2] = 2 * (w * dz - dw * z - (x * dy - y * dx)) / squared
        length = sqrt(squared)
        set_matrix(w / length, x / length, y / length, z / length, site_from_body[k])


@kernel
def set_matrix(w: float, x: float, y: float, z: float, matrix: FloatArray) -> None:
    """Set the rotation (3, 3) of a unit quaternion."""
    matrix[0, 0], matrix[0, 1], matrix[0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
    )
    matrix[1, 0], matrix[1, 1], matrix[1, 2] = (
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
    )
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = (
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )


def _of_one_sign(quaternion: FloatArray) -> FloatArray:
    """q and -q are the same attitude: of the two, the one nearer to the row before."""
    along, _ = _conjugate_times(quaternion[:-1], quaternion[1:])
    sign = np.cumprod(np.where(along < 0, -1.0, 1.0))
    return np.concatenate([quaternion[:1], sign[:, None] * quaternion[1:]])


def _derivatives(knot_s: FloatArray, quaternion: FloatArray) -> FloatArray:
    """dq/dt = q (0, rate) / 2 at the knots: (k, 4)."""
    step_s = np.diff(knot_s)
    step_cos, step_sin_axis = _conjugate_times(quaternion[:-1], quaternion[1:])
    half_turn = np.arctan2(np.sqrt(dot(step_sin_axis, step_sin_axis)), step_cos)
    mean_rate = 2 * step_sin_axis / (np.sinc(half_turn / np.pi) * step_s)[:, None]
    rate = np.stack([knot_rates(step_s, mean_rate[:, axis]) for axis in range(3)], axis=-1)
    scalar, vector = quaternion[:, 0], quaternion[:, 1:]
    turning = scalar[:, None] * rate + cross(vector, rate)
    return 0.5 * np.concatenate([-dot(vector, rate)[:, None], turning], axis=1)


def _conjugate_times(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """a* b as its scalar (n,) and its vector (n, 3)."""
    a_scalar, a_vector, b_scalar, b_vector = a[:, 0], a[:, 1:], b[:, 0], b[:, 1:]
    scalar = a_scalar * b_scalar + dot(a_vector, b_vector)
    vector = a_scalar[:, None] * b_vector - b_scalar[:, None] * a_vector - cross(a_vector, b_vector)
    return scalar, vector
