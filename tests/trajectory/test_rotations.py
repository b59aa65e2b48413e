"""Rotations against scipy's and against products of a library."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidar_emu.numerics.vector_arrays import (
    compose,
    cross,
    dot,
    from_rotation_vector,
    from_yaw_pitch_roll,
    rotate,
)
from lidar_emu.numerics.vectors import to_quaternion

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("length", [0.0, 1e-200, 1e-9, 1e-4, 1.0, np.pi, 200.0])
def test_rotation_vectors_agree_with_scipy(length: float) -> None:
    vector = RNG.normal(size=(50, 3))
    vector *= length / np.linalg.norm(vector, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        from_rotation_vector(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-13
    )


def test_yaw_pitch_roll_agrees_with_scipy() -> None:
    yaw, pitch, roll = RNG.uniform(-4, 4, size=(3, 200))
    expected = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=-1)).as_matrix()
    np.testing.assert_allclose(from_yaw_pitch_roll(yaw, pitch, roll), expected, atol=1e-15)


def test_products_agree_with_numpy_and_broadcast() -> None:
    a, b = RNG.normal(size=(2, 4, 1, 3, 3)), RNG.normal(size=(5, 3, 3))
    v, w = RNG.normal(size=(5, 3)), RNG.normal(size=(2, 4, 1, 3))
    np.testing.assert_allclose(compose(a, b), a @ b, atol=1e-14)
    np.testing.assert_allclose(rotate(a, v), (a @ v[..., None])[..., 0], atol=1e-14)
    np.testing.assert_allclose(rotate(a[0, 0, 0], v), v @ a[0, 0, 0].T, atol=1e-14)
    np.testing.assert_allclose(dot(v, w), (v * w).sum(axis=-1), atol=1e-14)
    np.testing.assert_allclose(cross(v, w), np.cross(v, w), atol=1e-14)


@pytest.mark.parametrize("largest", range(4))
def test_quaternion_of_a_matrix_from_each_component(largest: int) -> None:
    for _ in range(50):
        quaternion = RNG.uniform(-0.9, 0.9, 4)
        quaternion[largest] = RNG.choice([-1.0, 1.0])
        quaternion /= np.linalg.norm(quaternion)
        found = np.array(to_quaternion(Rotation.from_quat(quaternion, scalar_first=True).as_matrix()))
        assert found[0] >= 0
        np.testing.assert_allclose(found * np.sign(found @ quaternion), quaternion, atol=1e-14)
