"""The simulated inertial unit against an independent integrator, and Allan deviations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidar_emu

Array = np.typing.NDArray[np.float64]
PERFECT = lidar_emu.ImuErrors(0, 0, 1, 0, 0, 0, 0, 1, 0, 0)


def integrated(samples: lidar_emu.ImuSamples) -> tuple[Rotation, Array, Array]:
    """Attitude, velocity and position at the end, by Savage's two-sample corrections for coning and sculling."""
    angle, speed = samples.delta_angle_body_rad, samples.delta_velocity_body_mps
    before_angle, before_speed = (np.concatenate([each[:1], each[:-1]]) for each in (angle, speed))
    turn = Rotation.from_rotvec(angle + np.cross(before_angle, angle) / 12)
    sculling = (np.cross(before_angle, speed) + np.cross(before_speed, angle)) / 12
    in_start_axes = speed + np.cross(angle, speed) / 2 + sculling
    attitude = Rotation.from_quat(samples.site_from_body[0], scalar_first=True)
    velocity_mps, position_m = samples.velocity_site_mps[0], samples.position_site_m[0]
    gravity_mps2 = (samples.gravity_site_mps2[1:] + samples.gravity_site_mps2[:-1]) / 2
    for k, step_s in enumerate(np.diff(samples.time_s)):
        after_mps = velocity_mps + attitude.apply(in_start_axes[k]) + gravity_mps2[k] * step_s
        position_m = position_m + (velocity_mps + after_mps) / 2 * step_s
        velocity_mps, attitude = after_mps, attitude * turn[k]
    return attitude, velocity_mps, position_m


def test_without_errors_it_leads_along_the_true_flight() -> None:
    """80 s to touchdown at 50 Hz from a tumble, on a small body whose gravity turns and grows on the way."""
    tumbling = {"yaw_deg": 20, "pitch_deg": 40, "roll_deg": 10, "body_rate_radps": [0.05, -0.05, 0.1]}
    changes = {"site.body": {"name": "Ceres", "radius_m": 470e3}, "trajectory.start.attitude": tumbling}
    samples = lidar_emu.simulate_imu("powered_descent", changes, rate_hz=50, errors=PERFECT)
    attitude, velocity_mps, position_m = integrated(samples)
    true = Rotation.from_quat(samples.site_from_body[-1], scalar_first=True)
    assert (attitude * true.inv()).magnitude() < 1e-8
    np.testing.assert_allclose(velocity_mps, samples.velocity_site_mps[-1], atol=1e-5)
    np.testing.assert_allclose(position_m, samples.position_site_m[-1], atol=1e-3)


STATIC: dict[str, Any] = {
    "trajectory": {
        "kind": "profile",
        "waypoints": [{"altitude_m": 100.0, "speed_mps": 1e-4}, {"altitude_m": 99.6, "speed_mps": 1e-4}],
    },
    "site": "flat",
}


def allan_deviation(increments: Array, step_s: float, rows: int) -> float:
    """Of clusters of `rows` increments (n, 3), all axes together."""
    whole = len(increments) // rows * rows
    mean = increments[:whole].reshape(-1, rows, 3).sum(axis=1) / (rows * step_s)
    return float(np.sqrt((np.diff(mean, axis=0) ** 2).mean() / 2))


def test_allan_deviations_are_those_stated() -> None:
    """4000 s at rest: N / sqrt(t) of white noise, and the maximum of a Gauss-Markov process."""
    white = lidar_emu.ImuErrors(0, 0, 1, 2e-5, 0, 0, 0, 1, 3e-4, 0)
    samples = lidar_emu.simulate_imu("descent", STATIC, rate_hz=10, errors=white)
    wandering = lidar_emu.ImuErrors(1, 5e-6, 2, 0, 0, 1, 4e-5, 2, 0, 0)
    biased = lidar_emu.simulate_imu("descent", STATIC, rate_hz=10, errors=wandering)
    for name, walk, instability in (
        ("delta_angle_body_rad", 2e-5, 5e-6),
        ("delta_velocity_body_mps", 3e-4, 4e-5),
    ):
        for rows in (1, 10, 30):
            found = allan_deviation(getattr(samples, name), 0.1, rows)
            assert found == pytest.approx(walk / np.sqrt(0.1 * rows), rel=0.05), (name, rows)
        found = allan_deviation(getattr(biased, name), 0.1, 38)
        assert found == pytest.approx(0.618 * instability, rel=0.05), name


def test_biases_and_scales_spread_as_the_data_sheet_states() -> None:
    """LN-200S: 1 degree per hour and 300 micro-g, 100 and 300 ppm; a seed repeats its unit."""
    spins = STATIC | {"trajectory.attitude": {"body_rate_radps": [0.5, 0.5, 0.5]}, "duration_s": 0.1}
    exact = lidar_emu.simulate_imu("descent", spins, errors=PERFECT)
    quiet = lidar_emu.ImuErrors(angle_random_walk=0, velocity_random_walk=0)
    units = [lidar_emu.simulate_imu("descent", spins, seed=seed, errors=quiet) for seed in range(150)]
    rate_radps = np.array([each.gyro_bias_radps for each in units])
    force_mps2 = np.array([each.accelerometer_bias_mps2 for each in units])
    assert np.degrees(rate_radps[:, 0].std()) * 3600 == pytest.approx(np.hypot(1, 0.35), rel=0.1)
    assert force_mps2[:, 0].std() / 9.80665e-6 == pytest.approx(np.hypot(300, 50), rel=0.1)
    turned = np.array([each.delta_angle_body_rad for each in units]) - rate_radps * 0.01
    pushed = np.array([each.delta_velocity_body_mps for each in units]) - force_mps2 * 0.01
    for measured, true, ppm in (
        (turned, exact.delta_angle_body_rad, 100),
        (pushed, exact.delta_velocity_body_mps, 300),
    ):
        assert 1e6 * np.std(measured[:, 5] / true[5] - 1) == pytest.approx(ppm, rel=0.1)
    again = lidar_emu.simulate_imu("descent", spins, seed=7, errors=quiet)
    np.testing.assert_array_equal(again.delta_angle_body_rad, units[7].delta_angle_body_rad)


def test_refusals_are_one_line() -> None:
    for scenario, keys, line in (
        ("descent", {"rate_hz": np.nan}, "simulate_imu: rate_hz: must be a number from 1 to 10000 (got nan)"),
        ("descent", {"errors": 3}, "simulate_imu: errors: must be an ImuErrors (got 3)"),
        (
            "descent",
            {"site.body.name": "Eros"},
            "simulate_imu: gravity_mps2: must be a number from 0 to 1000",
        ),
        ("descent", {"duration_s": 1000}, "descent: duration_s: must be at most 50"),
        ("live", {}, "live: trajectory.kind: must be profile, table or powered_descent"),
    ):
        with pytest.raises(lidar_emu.InputError) as refused:
            lidar_emu.simulate_imu(scenario, **keys)  # type: ignore[arg-type]
        assert str(refused.value).startswith(line)
    with pytest.raises(lidar_emu.InputError, match="ImuErrors: gyro_scale: must be a number from 0 to 1e"):
        lidar_emu.ImuErrors(gyro_scale=-1)
