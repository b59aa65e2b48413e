"""Attitudes read from rows: rates against differences of the rotation, quaternions against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import SITE_FROM_NED
from lidar_emu.trajectory.curves import AttitudeCurve, EulerAttitude, QuaternionAttitude, through

RNG = np.random.default_rng(3)
KNOT_S = np.cumsum(RNG.uniform(0.3, 1.2, 20))
TIME_S = RNG.uniform(KNOT_S[0], KNOT_S[-1], 300)


def rate_by_difference(attitude: AttitudeCurve, time_s: FloatArray) -> FloatArray:
    step_s = 1e-5
    before, after = attitude.at(time_s - step_s)[0], attitude.at(time_s + step_s)[0]
    turned = Rotation.from_matrix(np.swapaxes(before, 1, 2) @ after)
    return np.asarray(turned.as_rotvec() / (2 * step_s))


def scalar_first(rotation: Rotation) -> FloatArray:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def rough_euler() -> EulerAttitude:
    return EulerAttitude(*(through(KNOT_S, np.cumsum(RNG.normal(0, 0.4, 20))) for _ in range(3)))


def rough_quaternions() -> QuaternionAttitude:
    turns = Rotation.from_rotvec(RNG.normal(0, 0.4, (20, 3)))
    path = [turns[0]]
    for turn in turns[1:]:
        path.append(path[-1] * turn)
    return QuaternionAttitude(KNOT_S, scalar_first(Rotation.concatenate(path)))


@pytest.mark.parametrize("attitude", [rough_euler(), rough_quaternions()], ids=["euler", "quaternion"])
def test_rate_is_the_derivative_of_the_rotation(attitude: AttitudeCurve) -> None:
    away_from_knots = TIME_S[np.min(np.abs(TIME_S[:, None] - KNOT_S), axis=1) > 1e-4]
    rotation, rate, acceleration = attitude.at(away_from_knots)
    np.testing.assert_allclose(rate, rate_by_difference(attitude, away_from_knots), atol=1e-6)
    before, after = (rate_by_difference(attitude, away_from_knots + step_s) for step_s in (-5e-5, 5e-5))
    np.testing.assert_allclose(acceleration, (after - before) / 1e-4, atol=3e-5)
    assert np.abs(acceleration).max() > 1
    identity = np.broadcast_to(np.eye(3), rotation.shape)
    np.testing.assert_allclose(rotation @ np.swapaxes(rotation, 1, 2), identity, atol=1e-14)


def test_euler_rates_at_a_pitch_of_90_degrees() -> None:
    """Nose straight up, turning in heading: all of it about the body's x axis, downward."""
    line = through(np.array([0.0, 1.0]), np.array([0.0, 0.3]))
    up = through(np.array([0.0, 1.0]), np.full(2, np.pi / 2))
    np.testing.assert_allclose(
        EulerAttitude(line, up, None).at(np.array([0.5]))[1], [[-0.3, 0, 0]], atol=1e-15
    )


def test_left_out_angles_are_level_and_north() -> None:
    rotation, rate, _ = EulerAttitude(None, None, None).at(np.array([1.0, 2.0]))
    assert np.array_equal(rotation, np.stack([SITE_FROM_NED] * 2))
    assert not rate.any()


def test_quaternions_pass_through_their_rows_whatever_their_signs() -> None:
    rows = Rotation.random(20, random_state=4)
    nearby = Rotation.from_rotvec(np.cumsum(0.3 * RNG.normal(size=(20, 3)), axis=0))
    for rotation in (rows, nearby):
        signed = scalar_first(rotation) * RNG.choice([-1.0, 1.0], size=(20, 1))
        found, _, _ = QuaternionAttitude(KNOT_S, signed).at(KNOT_S)
        np.testing.assert_allclose(found, rotation.as_matrix(), atol=1e-13)


def test_steady_turn_in_quaternions() -> None:
    """0.5 rad/s with rows 0.3 to 1.2 s apart: the rate exactly at the rows, the attitude to 1e-4 between."""
    rate = np.array([0.3, -0.4, 0.0])
    start = Rotation.from_rotvec([1.0, 2.0, 0.5])
    attitude = QuaternionAttitude(KNOT_S, scalar_first(start * Rotation.from_rotvec(KNOT_S[:, None] * rate)))
    np.testing.assert_allclose(attitude.at(KNOT_S)[1], np.broadcast_to(rate, (20, 3)), atol=1e-13)
    found, found_rate, _ = attitude.at(TIME_S)
    expected = start * Rotation.from_rotvec(TIME_S[:, None] * rate)
    assert np.max((expected.inv() * Rotation.from_matrix(found)).magnitude()) < 1e-4
    assert np.max(np.abs(found_rate - rate)) < 1e-3


def test_still_quaternions_do_not_turn() -> None:
    rows = np.tile([0.6, 0.0, -0.8, 0.0], (20, 1))
    _, rate, acceleration = QuaternionAttitude(KNOT_S, rows).at(TIME_S)
    np.testing.assert_allclose(rate, 0, atol=1e-15)
    np.testing.assert_allclose(acceleration, 0, atol=1e-14)
