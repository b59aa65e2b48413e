"""Profiles against the published decelerations, the v² law and differences of their own positions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidar_emu.beams.flight import build_trajectory
from lidar_emu.numerics.vector_arrays import dot, rotate
from lidar_emu.scenario.trajectory import Attitude, Profile, Waypoint
from lidar_emu.trajectory.profile import Trajectory


def profile(*waypoints: tuple[float, float], **keys: object) -> Trajectory:
    points = [Waypoint(altitude_m=altitude, speed_mps=speed) for altitude, speed in waypoints]
    return build_trajectory(Profile.model_validate({"kind": "profile", "waypoints": points, **keys}))


@pytest.mark.parametrize(
    ("waypoints", "path_angle_deg", "deceleration_mps2"),
    [
        (((2000.0, 100.0), (500.0, 32.0)), 90.0, 2.992),
        (((500.0, 30.0), (100.0, 6.0)), 90.0, 1.080),
        (((2000.0, 100.0), (500.0, 30.0)), 45.0, 2.145),
    ],
)
def test_decelerations_of_budge_et_al(
    waypoints: tuple[tuple[float, float], ...], path_angle_deg: float, deceleration_mps2: float
) -> None:
    flight = profile(*waypoints, path_angle_deg=path_angle_deg)
    state = flight.state(np.array([0.0, flight.duration_s]))
    along = state.velocity_site_mps[0] / waypoints[0][1]
    np.testing.assert_allclose(dot(state.acceleration_site_mps2, along), -deceleration_mps2, atol=5e-4)
    np.testing.assert_allclose(state.position_site_m[:, 2], [w[0] for w in waypoints], rtol=1e-13)
    speed = np.sqrt(dot(state.velocity_site_mps, state.velocity_site_mps))
    np.testing.assert_allclose(speed, [w[1] for w in waypoints], rtol=1e-13)


def test_path_descends_along_its_heading_to_the_target() -> None:
    """30 degrees below the horizontal, heading 60 degrees: the line meets altitude 0 at the target."""
    flight = profile(
        (100.0, 20.0),
        (10.0, 5.0),
        path_angle_deg=30.0,
        heading_deg=60.0,
        target_east_m=7.0,
        target_north_m=-3.0,
    )
    state = flight.state(np.linspace(0, flight.duration_s, 9))
    before_m = state.position_site_m[:, 2] * np.sqrt(3)
    np.testing.assert_allclose(state.position_site_m[:, 0], 7 - before_m * np.sqrt(3) / 2, atol=1e-11)
    np.testing.assert_allclose(state.position_site_m[:, 1], -3 - before_m / 2, atol=1e-11)
    direction = np.array([0.75, np.sqrt(3) / 4, -0.5])
    np.testing.assert_allclose(state.velocity_site_mps[0], 20 * direction, atol=1e-13)


speeds = st.floats(0.1, 300)


@given(st.tuples(speeds, speeds, speeds), st.floats(5, 90), st.floats(0, 1))
def test_speed_squared_is_linear_in_the_distance_flown(
    speed: tuple[float, float, float], path_angle_deg: float, share: float
) -> None:
    altitude = np.array([900.0, 400.0, 10.0])
    flight = profile(*zip(altitude.tolist(), speed, strict=True), path_angle_deg=path_angle_deg)
    state = flight.state(np.array([share * flight.duration_s]))
    squared = dot(state.velocity_site_mps, state.velocity_site_mps)
    expected = np.interp(-state.position_site_m[:, 2], -altitude, np.square(speed))
    np.testing.assert_allclose(squared, expected, rtol=1e-9)


@pytest.mark.parametrize("speeds_mps", [(20.0, 20.0, 20.0), (40.0, 20.0, 0.0), (0.0, 30.0, 1e-9)])
def test_equal_speeds_and_stops(speeds_mps: tuple[float, float, float]) -> None:
    flight = profile(*zip((600.0, 200.0, 0.0), speeds_mps, strict=True))
    expected_s = sum(
        2 * length / (a + b) for length, a, b in zip((400, 200), speeds_mps, speeds_mps[1:], strict=False)
    )
    assert flight.duration_s == pytest.approx(expected_s, rel=1e-14)
    end = flight.state(np.array([flight.duration_s]))
    np.testing.assert_allclose(end.position_site_m, 0, atol=1e-10)
    np.testing.assert_allclose(end.velocity_site_mps[:, 2], -speeds_mps[-1], atol=1e-12)


def test_motion_continues_outside() -> None:
    flight = profile((500.0, 30.0), (100.0, 6.0))
    outside_s = np.array([-0.1, flight.duration_s + 0.1])
    acceleration = (30**2 - 6**2) / (2 * 400)
    expected = [500 + 30 * 0.1 + acceleration * 0.1**2 / 2, 100 - 6 * 0.1 + acceleration * 0.1**2 / 2]
    np.testing.assert_allclose(flight.state(outside_s).position_site_m[:, 2], expected, rtol=1e-13)


def test_level_body_with_a_heading() -> None:
    heading = np.radians(70)
    flight = profile((10.0, 1.0), (5.0, 1.0), attitude=Attitude(yaw_deg=70.0))
    axes = flight.state(np.zeros(1)).site_from_body[0].T
    expected = [[np.sin(heading), np.cos(heading), 0], [np.cos(heading), -np.sin(heading), 0], [0, 0, -1]]
    np.testing.assert_allclose(axes, expected, atol=1e-15)


def test_nose_up_lifts_the_forward_axis_and_roll_lowers_the_right_one() -> None:
    nose_up = profile((10.0, 1.0), (5.0, 1.0), attitude=Attitude(pitch_deg=30.0)).state(np.zeros(1))
    np.testing.assert_allclose(rotate(nose_up.site_from_body[0], np.array([1.0, 0, 0]))[2], 0.5)
    rolled = profile((10.0, 1.0), (5.0, 1.0), attitude=Attitude(roll_deg=30.0)).state(np.zeros(1))
    np.testing.assert_allclose(rotate(rolled.site_from_body[0], np.array([0, 1.0, 0]))[2], -0.5)
