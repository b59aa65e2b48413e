"""Vector and rotation algebra for numpy arrays; leading axes broadcast.

Products are written out element by element: a library's matrix product may add in another order for another shape,
while a sum written out gives a shot the same bits whatever block it comes in. Matrices are named target_from_source:
columns are the source's axes in the target frame. Quaternions are scalar first (Hamilton).
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
import numpy.typing as npt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import (
    angular_motion,
    quaternion_at,
    set_from_quaternion,
    set_from_rotation_vector,
    set_from_yaw_pitch_roll,
    store,
)

SITE_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Rotation to east-north-up from north-east-down, the frame of aerospace angles."""

_NEXT, _AFTER_NEXT = [1, 2, 0], [2, 0, 1]


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar product of (..., 3) and (..., 3): (...)."""
    product: FloatArray = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return product


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product of (..., 3) and (..., 3): (..., 3)."""
    product: FloatArray = a[..., _NEXT] * b[..., _AFTER_NEXT] - a[..., _AFTER_NEXT] * b[..., _NEXT]
    return product


def unit_across(axis: FloatArray) -> FloatArray:
    """Unit vector (3,) perpendicular to a vector (3,), in the plane across its smallest component."""
    across = cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    return np.asarray(across / np.sqrt(dot(across, across)))


def rotate(target_from_source: FloatArray, source: FloatArray) -> FloatArray:
    """Rotate vectors (..., 3) by matrices (..., 3, 3): (..., 3)."""
    x, y, z = source[..., 0, None], source[..., 1, None], source[..., 2, None]
    matrix = target_from_source
    target: FloatArray = matrix[..., 0] * x + matrix[..., 1] * y + matrix[..., 2] * z
    return target


def compose(target_from_middle: FloatArray, middle_from_source: FloatArray) -> FloatArray:
    """Product of rotations (..., 3, 3): target_from_source (..., 3, 3)."""
    a, b = target_from_middle[..., None], middle_from_source[..., None, :, :]
    product: FloatArray = (
        a[..., 0, :] * b[..., 0, :] + a[..., 1, :] * b[..., 1, :] + a[..., 2, :] * b[..., 2, :]
    )
    return product


def from_yaw_pitch_roll(
    yaw_rad: npt.ArrayLike, pitch_rad: npt.ArrayLike, roll_rad: npt.ArrayLike
) -> FloatArray:
    """Aerospace sequence about z, then y, then x: parent_from_child (..., 3, 3) for angles (...)."""
    angles_rad = np.stack(np.broadcast_arrays(yaw_rad, pitch_rad, roll_rad), axis=-1, dtype=np.float64)
    return _matrices(set_from_yaw_pitch_roll, angles_rad)


def from_rotation_vector(vector_rad: FloatArray) -> FloatArray:
    """Rotations exp([v]x), (..., 3, 3), about vectors (..., 3) by their length in radians (Rodrigues)."""
    return _matrices(set_from_rotation_vector, np.ascontiguousarray(vector_rad, dtype=np.float64))


def _matrices(set_matrix: Callable[..., None], triples: FloatArray) -> FloatArray:
    matrices = np.empty((*triples.shape, 3))
    for triple, matrix in zip(triples.reshape(-1, 3), matrices.reshape(-1, 3, 3), strict=True):
        set_matrix(triple[0], triple[1], triple[2], matrix)
    return matrices


def from_quaternions(orders: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotations parent_from_child (n, 3, 3), angular rates (n, 3) in rad/s and angular accelerations (n, 3) in rad/s²
    about the child's axes.

    Args:
        orders: (3, n, 4) quaternions of any length, their first and their second derivatives in time.
    """
    count = orders.shape[1]
    rotation, rate, acceleration = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3))
    _set_from_quaternions(orders, rotation, rate, acceleration)
    return rotation, rate, acceleration


@kernel(outermost=True)
def _set_from_quaternions(
    orders: FloatArray, rotation: FloatArray, rate: FloatArray, acceleration: FloatArray
) -> None:
    for k in range(orders.shape[1]):
        w, x, y, z = q = quaternion_at(orders[0, k], 0)
        turning = angular_motion(q, quaternion_at(orders[1, k], 0), quaternion_at(orders[2, k], 0))
        store(rate[k], 0, turning[0])
        store(acceleration[k], 0, turning[1])
        length = sqrt(w * w + x * x + y * y + z * z)
        set_from_quaternion(w / length, x / length, y / length, z / length, rotation[k])


def conjugate_product(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Product a* b of quaternions (n, 4): scalars (n,) and vectors (n, 3)."""
    a_scalar, a_vector, b_scalar, b_vector = a[:, 0], a[:, 1:], b[:, 0], b[:, 1:]
    scalar = a_scalar * b_scalar + dot(a_vector, b_vector)
    vector = a_scalar[:, None] * b_vector - b_scalar[:, None] * a_vector - cross(a_vector, b_vector)
    return scalar, vector
