"""Products and rotations of 3-vectors, written out element by element.

Matrix products of a library may add in another order for another shape; sums written out give a shot the same
bits whatever block it comes in. Leading axes broadcast. Matrices are named target_from_source: columns are
the source's axes in the target frame.
"""

from __future__ import annotations

import numpy as np

from lidar_emu.arrays import FloatArray

_IDENTITY = np.eye(3)
_NEXT, _AFTER_NEXT = [1, 2, 0], [2, 0, 1]
_GENERATORS = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)
"""[v]x = v_x G_x + v_y G_y + v_z G_z."""


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar product of (..., 3) and (..., 3): (...)."""
    product: FloatArray = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return product


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product of (..., 3) and (..., 3): (..., 3)."""
    product: FloatArray = a[..., _NEXT] * b[..., _AFTER_NEXT] - a[..., _AFTER_NEXT] * b[..., _NEXT]
    return product


def normalised(vector: FloatArray) -> FloatArray:
    """Unit vectors along (..., 3)."""
    unit: FloatArray = vector / np.sqrt(dot(vector, vector))[..., None]
    return unit


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


def from_yaw_pitch_roll(yaw_rad: FloatArray, pitch_rad: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """Aerospace sequence about z, then y, then x: parent_from_child (..., 3, 3) for angles (...)."""
    sin_yaw, cos_yaw = np.sin(yaw_rad), np.cos(yaw_rad)
    sin_pitch, cos_pitch = np.sin(pitch_rad), np.cos(pitch_rad)
    sin_roll, cos_roll = np.sin(roll_rad), np.cos(roll_rad)
    elements = [
        cos_yaw * cos_pitch,
        cos_yaw * sin_pitch * sin_roll - sin_yaw * cos_roll,
        cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll,
        sin_yaw * cos_pitch,
        sin_yaw * sin_pitch * sin_roll + cos_yaw * cos_roll,
        sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll,
        -sin_pitch,
        cos_pitch * sin_roll,
        cos_pitch * cos_roll,
    ]
    return np.stack(elements, axis=-1).reshape(*np.shape(yaw_rad), 3, 3)


def from_rotation_vector(vector_rad: FloatArray) -> FloatArray:
    """Rotations exp([v]x), (..., 3, 3), about vectors (..., 3) by their length in radians (Rodrigues).

    sin(a)/a and (1 - cos a)/a² = sinc²(a/2)/2 are finite at a = 0, so that no rotation is a special case.
    """
    squared = dot(vector_rad, vector_rad)[..., None, None]
    angle_rad = np.sqrt(squared)
    first = np.sinc(angle_rad / np.pi)
    second = 0.5 * np.sinc(angle_rad / (2 * np.pi)) ** 2
    x, y, z = (vector_rad[..., axis, None, None] for axis in range(3))
    skew = x * _GENERATORS[0] + y * _GENERATORS[1] + z * _GENERATORS[2]
    outer = vector_rad[..., :, None] * vector_rad[..., None, :]
    rotation: FloatArray = np.cos(angle_rad) * _IDENTITY + second * outer + first * skew
    return rotation
