"""Products and rotations of 3-vectors, written out element by element.

Matrix products of a library may add in another order for another shape; sums written out give a shot the same
bits whatever block it comes in. Leading axes broadcast. Matrices are named target_from_source: columns are
the source's axes in the target frame. Functions of arrays come first, kernels for a single vector or matrix after.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin, sqrt

import numpy as np
import numpy.typing as npt

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

SITE_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""East-north-up from the north-east-down in which aerospace angles are counted."""

_NEXT, _AFTER_NEXT = [1, 2, 0], [2, 0, 1]


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar product of (..., 3) and (..., 3): (...)."""
    product: FloatArray = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return product


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product of (..., 3) and (..., 3): (..., 3)."""
    product: FloatArray = a[..., _NEXT] * b[..., _AFTER_NEXT] - a[..., _AFTER_NEXT] * b[..., _NEXT]
    return product


def rotate(target_from_source: FloatArray, source: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) on vectors (..., 3): (..., 3)."""
    x, y, z = source[..., 0, None], source[..., 1, None], source[..., 2, None]
    matrix = target_from_source
    target: FloatArray = matrix[..., 0] * x + matrix[..., 1] * y + matrix[..., 2] * z
    return target


def chained(target_from_middle: FloatArray, middle_from_source: FloatArray) -> FloatArray:
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
    return _each(set_yaw_pitch_roll, angles_rad)


def from_rotation_vector(vector_rad: FloatArray) -> FloatArray:
    """Rotations exp([v]x), (..., 3, 3), about vectors (..., 3) by their length in radians (Rodrigues)."""
    return _each(set_rotation_vector, np.ascontiguousarray(vector_rad, dtype=np.float64))


def _each(set_matrix: Callable[..., None], triples: FloatArray) -> FloatArray:
    """The matrices (..., 3, 3) that a kernel sets from three numbers (..., 3) each."""
    matrices = np.empty((*triples.shape, 3))
    for triple, matrix in zip(triples.reshape(-1, 3), matrices.reshape(-1, 3, 3), strict=True):
        set_matrix(triple[0], triple[1], triple[2], matrix)
    return matrices


@kernel
def known(value: float) -> float:
    """0 for NaN."""
    return value if value == value else 0.0


@kernel
def dot_3(a: FloatArray, b: FloatArray) -> float:
    """Scalar product of two vectors (3,)."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@kernel
def set_cross(a: FloatArray, b: FloatArray, product: FloatArray) -> None:
    """Set a vector (3,), none of the factors, to the vector product of two."""
    product[0] = a[1] * b[2] - a[2] * b[1]
    product[1] = a[2] * b[0] - a[0] * b[2]
    product[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def set_rotated(target_from_source: FloatArray, source: FloatArray, target: FloatArray) -> None:
    """Set a vector (3,), which may be the source itself, to the source rotated."""
    x, y, z = source[0], source[1], source[2]
    for row in range(3):
        turn = target_from_source[row]
        target[row] = turn[0] * x + turn[1] * y + turn[2] * z


@kernel
def lead_by(target_from_middle: FloatArray, rotation: FloatArray) -> None:
    """Make middle_from_source (3, 3), in its place, target_from_source."""
    for column in range(3):
        x, y, z = rotation[0, column], rotation[1, column], rotation[2, column]
        for row in range(3):
            turn = target_from_middle[row]
            rotation[row, column] = turn[0] * x + turn[1] * y + turn[2] * z


@kernel
def set_yaw_pitch_roll(yaw_rad: float, pitch_rad: float, roll_rad: float, matrix: FloatArray) -> None:
    """Set parent_from_child (3, 3); see `from_yaw_pitch_roll`."""
    sin_yaw, cos_yaw = sin(yaw_rad), cos(yaw_rad)
    sin_pitch, cos_pitch = sin(pitch_rad), cos(pitch_rad)
    sin_roll, cos_roll = sin(roll_rad), cos(roll_rad)
    matrix[0, 0] = cos_yaw * cos_pitch
    matrix[0, 1] = cos_yaw * sin_pitch * sin_roll - sin_yaw * cos_roll
    matrix[0, 2] = cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll
    matrix[1, 0] = sin_yaw * cos_pitch
    matrix[1, 1] = sin_yaw * sin_pitch * sin_roll + cos_yaw * cos_roll
    matrix[1, 2] = sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll
    matrix[2, 0] = -sin_pitch
    matrix[2, 1] = cos_pitch * sin_roll
    matrix[2, 2] = cos_pitch * cos_roll


@kernel
def set_rotation_vector(x_rad: float, y_rad: float, z_rad: float, matrix: FloatArray) -> None:
    """Set exp([v]x), (3, 3).

    sin(a)/a and (1 - cos a)/a² = (sin(a/2)/(a/2))²/2 are finite at a = 0, so that no rotation is a special case.
    """
    angle_rad = sqrt(x_rad * x_rad + y_rad * y_rad + z_rad * z_rad)
    first, half, cosine = sin_over(angle_rad), sin_over(0.5 * angle_rad), cos(angle_rad)
    second = 0.5 * half * half
    matrix[0, 0] = cosine + second * x_rad * x_rad
    matrix[1, 1] = cosine + second * y_rad * y_rad
    matrix[2, 2] = cosine + second * z_rad * z_rad
    matrix[0, 1] = second * x_rad * y_rad - first * z_rad
    matrix[1, 0] = second * x_rad * y_rad + first * z_rad
    matrix[0, 2] = second * x_rad * z_rad + first * y_rad
    matrix[2, 0] = second * x_rad * z_rad - first * y_rad
    matrix[1, 2] = second * y_rad * z_rad - first * x_rad
    matrix[2, 1] = second * y_rad * z_rad + first * x_rad


@kernel
def sin_over(angle_rad: float) -> float:
    return sin(angle_rad) / angle_rad if angle_rad > 0.0 else 1.0
