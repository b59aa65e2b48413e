"""The ground truth of vehicle and beams against closed forms, differences in time, and scipy's rotations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidar_emu
from lidar_emu.beams.flight import Flight
from lidar_emu.errors import InputError
from lidar_emu.measurement import COLUMNS, GroundTruth, Measurement
from lidar_emu.numerics.arrays import Group, in_groups
from lidar_emu.receiver.returns import Reason
from lidar_emu.scene.ray_hits import NOTHING

LEVER_ARM_M = (2.0, 0.3, -0.5)
TURNING = {
    "trajectory": {
        "kind": "profile",
        "waypoints": [{"altitude_m": 1000, "speed_mps": 60}, {"altitude_m": 900, "speed_mps": 30}],
        "attitude": {"roll_deg": 3, "pitch_deg": 2, "yaw_deg": 30, "body_rate_radps": [0.1, 0.5, -0.2]},
    },
    "mounting": {"lever_arm_m": LEVER_ARM_M},
    "level": "geometric",
    "timing": {"rate_hz": 500},
}


def test_attitude_and_rates_of_a_turning_vehicle(make_flight: Any) -> None:
    scenario = make_flight(**TURNING)
    run = lidar_emu.simulate(scenario)
    truth = run.truth
    attitude = Rotation.from_quat(truth.site_from_body, scalar_first=True)
    state = Flight(scenario).trajectory.state(run.time_ns[:, 0] * 1e-9)
    np.testing.assert_allclose(attitude.as_matrix(), state.site_from_body, atol=1e-14)
    assert (truth.site_from_body[:, 0] >= 0).all()
    half = 1 / (2 * 500)
    step = attitude[:-1].inv() * attitude[1:]
    np.testing.assert_allclose(
        step.as_rotvec() / (2 * half), (truth.body_rate_radps[1:] + truth.body_rate_radps[:-1]) / 2, atol=1e-6
    )
    for rate, value in (
        (truth.acceleration_site_mps2, truth.velocity_site_mps),
        (truth.velocity_site_mps, truth.position_site_m),
    ):
        np.testing.assert_allclose(rate[1:-1], (value[2:] - value[:-2]) / (4 * half), atol=1e-5)
    arm_m = attitude.apply(LEVER_ARM_M)
    np.testing.assert_allclose(truth.sensor_site_m[:, 0], truth.position_site_m + arm_m, atol=1e-9)


SQUARE, NARROW = ({"kind": "square", "angle_deg": angle_deg} for angle_deg in (22.5, 7.5))
TURNED_DEG = {"yaw_deg": 20, "pitch_deg": -10, "roll_deg": 5}
MISALIGNED_MRAD = [[3, 0], [0, -2], [1, 1], [-4, 2]]
SWITCHED: dict[str, Any] = TURNING | {
    "mounting": {"lever_arm_m": LEVER_ARM_M, **TURNED_DEG},
    "scanner": {
        "pattern": SQUARE,
        "switches": [{"kind": "time", "at_s": 1.0, "pattern": NARROW}],
        "misalignment_mrad": MISALIGNED_MRAD,
    },
}


def test_beam_axes_are_those_of_the_data_sheet_and_of_the_line_of_sight(make_flight: Any) -> None:
    """Published axes by the scanner's angles and the mounting, true ones by misalignment and attitude as well."""
    run = lidar_emu.simulate(make_flight(**SWITCHED), duration_s=1.5)
    angle = np.radians(np.where(np.arange(len(run)) < 500, 22.5, 7.5))[:, None]
    azimuth = np.radians([45.0, 135.0, 225.0, 315.0])
    across = np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth)
    sheet = np.stack([*across, np.broadcast_to(np.cos(angle), across[0].shape)], axis=-1)
    body_from_sensor = Rotation.from_euler("ZYX", list(TURNED_DEG.values()), degrees=True)
    attitude = Rotation.from_quat(run.site_from_body, scalar_first=True)
    for beam, tilt_mrad in enumerate(MISALIGNED_MRAD):
        published = body_from_sensor.apply(sheet[:, beam])
        np.testing.assert_allclose(run.beam_axis_body[:, beam], published, atol=1e-14)
        tilted = Rotation.from_rotvec([1e-3 * tilt_mrad[0], 1e-3 * tilt_mrad[1], 0]).apply(sheet[:, beam])
        true = attitude.apply(body_from_sensor.apply(tilted))
        np.testing.assert_allclose(run.true_beam_axis_site[:, beam], true, atol=1e-14)
    sight_m = run.true_point_site_m - run.true_sensor_site_m
    axis = sight_m / np.linalg.norm(sight_m, axis=-1, keepdims=True)
    np.testing.assert_allclose(run.true_beam_axis_site, axis, atol=1e-12)


def test_closing_speeds_along_published_axes_give_the_velocity() -> None:
    """Least squares with the stated deviations, as a flight computer does it: errors are chi-square of 3 a shot."""
    keys = {"mounting": {"lever_arm_m": LEVER_ARM_M, "pitch_deg": -10}, "site": "flat", "timing.rate_hz": 10}
    run = lidar_emu.simulate("powered_descent", keys)
    attitude = Rotation.from_quat(run.site_from_body, scalar_first=True)
    true_mps = attitude.inv().apply(run.velocity_site_mps) + np.cross(run.body_rate_radps, LEVER_ARM_M)
    assert set(np.unique(run.beam_angle_deg)) == {7.5, 22.5}  # a pattern switch
    normalised = []
    for shot in np.flatnonzero(run.speed_valid.all(axis=1)):
        design = run.beam_axis_body[shot] / run.sigma_speed_mps[shot, :, None]
        found_mps = np.linalg.lstsq(design, run.closing_speed_mps[shot] / run.sigma_speed_mps[shot])[0]
        normalised.append(((design @ (found_mps - true_mps[shot])) ** 2).sum())
    assert len(normalised) > 700
    assert np.mean(normalised) == pytest.approx(3, rel=0.1)


def test_what_is_hit(make_flight: Any) -> None:
    """A slab below the eastern beams, and none of the ground beyond the plane's horizon for beams that look up."""
    slab = {"name": "deck", "kind": "slab", "length_m": 2000, "width_m": 2000, "height_m": 5}
    site = {"ground": {"kind": "plane"}, "objects": [slab | {"east_m": 1000, "reflectance": 0.5}]}
    truth = lidar_emu.simulate(make_flight(site=site, level="geometric")).truth
    is_east = truth.point_site_m[..., 0] > 0
    assert is_east.any()
    np.testing.assert_array_equal(truth.object, is_east)
    np.testing.assert_allclose(truth.point_site_m[..., 2], 5.0 * is_east, atol=1e-9)
    upward = lidar_emu.simulate(make_flight(mounting={"roll_deg": 180}, level="geometric")).truth
    assert (upward.object == -1).all()
    assert np.isnan(upward.point_site_m).all()
    assert np.isfinite(upward.sensor_site_m).all()


def test_the_view_names_every_true_column() -> None:
    run = lidar_emu.simulate("bench", duration_s=1)
    vehicle, beams = (set(in_groups(COLUMNS, group)) for group in (Group.VEHICLE, Group.TRUTH))
    named = vehicle | {f"true_{name}" for name in set(GroundTruth._fields) - vehicle}
    assert vehicle | beams == named | {"true_in_gap", "true_peak_source"}
    assert np.isnan(run.truth.site_from_body).all()  # a bench pattern has no vehicle
    assert (run.truth.object == NOTHING).all()
    np.testing.assert_array_equal(run.truth.range_m, run.true_range_m)


@pytest.fixture(scope="module")
def run() -> Measurement:
    return lidar_emu.simulate("descent", duration_s=2)


def test_pandas_has_the_table_with_reasons_by_name(run: Measurement) -> None:
    frame = run.to_pandas()
    for name, column in run.table().items():
        if name != "reason":
            np.testing.assert_array_equal(frame[name], column, name)
    assert list(frame.columns) == list(run.table())
    np.testing.assert_array_equal(frame["reason"], run.reason_name.ravel())
    np.testing.assert_array_equal(frame["reason"] == "VALID", run.range_valid.ravel())
    assert list(frame["reason"].cat.categories) == [each.name for each in Reason]


def test_without_pandas_one_line_names_the_extra(run: Measurement, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(
        InputError, match=r"^to_pandas: .* requires pandas; run: .*pip install .*\[pandas\]'$"
    ):
        run.to_pandas()


def test_a_reader_sees_a_summary(run: Measurement) -> None:
    share = 100 * run.range_valid.mean()
    for text in (repr(run), run._repr_html_()):
        assert f"VALID {share:.3g} %" in text
        assert "NOT_FIRED" not in text
    assert "<td>40</td>" in run._repr_html_()
    assert len(repr(run)) < 200
