"""Beam directions and switches against the stated geometry and a written-out reference."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidar_emu.beams.flight import build_trajectory
from lidar_emu.beams.patterns import ScannerModel, build_scanner, mounting_rotation
from lidar_emu.numerics.vector_arrays import dot, rotate
from lidar_emu.scenario.scanner import Mounting, Scanner
from lidar_emu.scenario.trajectory import Profile

WIDE = {"kind": "square", "angle_deg": 22.5}
NARROW = {"kind": "square", "angle_deg": 7.5}
NAN = float("nan")


def scanner(pattern: dict[str, Any], *switches: dict[str, Any], **keys: Any) -> ScannerModel:
    return build_scanner(Scanner.model_validate({"pattern": pattern, "switches": list(switches), **keys}))


def below(below_m: float, pattern: dict[str, Any] = NARROW, **keys: Any) -> dict[str, Any]:
    return {"kind": "altitude", "below_m": below_m, "pattern": pattern, **keys}


def choices(model: ScannerModel, *shots: tuple[float, float, float]) -> list[int]:
    """Of time and both altitudes: one shot at a time, which gives the same as all at once."""
    time_s, up_m, above_ground_m = np.array(shots, dtype=float).reshape(-1, 3).T.copy()
    columns, whole = (time_s, up_m, up_m - above_ground_m), np.empty(len(shots), dtype=np.int64)
    last = model.choose(model.initial, *columns, whole)
    state, chosen = model.initial, []
    for k in range(len(shots)):
        one = np.empty(1, dtype=np.int64)
        state = model.choose(state, *(column[k : k + 1] for column in columns), one)
        chosen.append(int(one[0]))
    assert whole.tolist() == chosen
    assert state == last
    return chosen


def at_altitudes(model: ScannerModel, *altitudes_m: float) -> list[int]:
    return choices(model, *((float(k), altitude, altitude) for k, altitude in enumerate(altitudes_m)))


def test_square_pattern() -> None:
    model = scanner(WIDE)
    across = np.sin(np.radians(22.5)) / np.sqrt(2)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * across
    np.testing.assert_allclose(model.published_sensor[0, :, :2], corners, atol=1e-15)
    np.testing.assert_allclose(model.published_sensor[0, :, 2], np.cos(np.radians(22.5)))
    assert np.array_equal(model.true_sensor, model.published_sensor)
    assert model.angle_deg.tolist() == [[22.5] * 4]
    assert model.beam_count == 4


def test_first_shots_of_the_slant_descent_of_budge_et_al() -> None:
    """45 degree path at 100 m/s, level body heading along it: closing speeds of forward and aft beams."""
    descent = {
        "waypoints": [{"altitude_m": 2000.0, "speed_mps": 100.0}, {"altitude_m": 500.0, "speed_mps": 30.0}]
    }
    flight = build_trajectory(Profile.model_validate({"kind": "profile", "path_angle_deg": 45.0, **descent}))
    start = flight.state(np.zeros(1))
    beams_site = rotate(
        start.site_from_body[0], rotate(mounting_rotation(Mounting()), scanner(WIDE).true_sensor[0])
    )
    closing = dot(start.velocity_site_mps, beams_site)
    np.testing.assert_allclose(closing, [84.4623, 46.1940, 46.1940, 84.4623], atol=5e-5)
    np.testing.assert_allclose(2000 / -beams_site[:, 2], 2164.784, atol=5e-4)


def test_sets_of_unequal_size_are_filled_up_with_nan() -> None:
    ring = {"kind": "ring", "count": 3, "angle_deg": 10.0, "first_azimuth_deg": 90.0}
    own = {"kind": "directions", "beams": [(0.0, 0.0)]}
    model = scanner(ring, below(100.0, WIDE), {"kind": "time", "at_s": 9.0, "pattern": own})
    assert model.published_sensor.shape == (3, 4, 3)
    assert np.isnan(model.angle_deg).tolist() == [[False] * 3 + [True], [False] * 4, [False] + [True] * 3]
    absent = np.isnan(model.angle_deg)
    assert np.isnan(model.true_sensor[absent]).all()
    lengths = np.sqrt(dot(model.true_sensor, model.true_sensor))
    np.testing.assert_allclose(lengths[~absent], 1, rtol=1e-15)
    np.testing.assert_allclose(
        model.published_sensor[0, 0], [0, np.sin(np.radians(10)), np.cos(np.radians(10))], atol=1e-16
    )
    assert model.published_sensor[2, 0].tolist() == [0, 0, 1]


def test_misalignment_turns_the_true_beam_only() -> None:
    """A small turn about x takes the boresight toward -y, one about y toward +x."""
    boresight = {"kind": "directions", "beams": [(0.0, 0.0), (0.0, 0.0)]}
    model = scanner(boresight, misalignment_mrad=[(0.5, 0.0), (0.0, 0.5)])
    assert model.published_sensor[0].tolist() == [[0, 0, 1], [0, 0, 1]]
    expected = [[0, -np.sin(5e-4), np.cos(5e-4)], [np.sin(5e-4), 0, np.cos(5e-4)]]
    np.testing.assert_allclose(model.true_sensor[0], expected, atol=1e-16)


def test_misalignment_holds_for_a_beam_in_every_pattern() -> None:
    misalignment = [(0.3, -0.2), (1.0, 0.0), (0.0, 2.0), (-0.7, 0.1)]
    model = scanner(WIDE, below(500.0), misalignment_mrad=misalignment)
    turns = Rotation.from_rotvec(np.column_stack([1e-3 * np.array(misalignment), np.zeros(4)]))
    for true, published in zip(model.true_sensor, model.published_sensor, strict=True):
        np.testing.assert_allclose(true, turns.apply(published), atol=1e-15)


def test_firing_cycles() -> None:
    assert scanner(WIDE).firing_cycle.tolist() == [0, 0, 0, 0]
    assert scanner(WIDE, firing="in_turn").firing_cycle.tolist() == [0, 1, 2, 3]


def test_altitude_switch_stays() -> None:
    model = scanner(WIDE, below(500.0))
    assert at_altitudes(model, 501, 500, 499.9, 2000, NAN, 100) == [0, 0, 1, 1, 1, 1]


def test_state_is_plain() -> None:
    model = scanner(WIDE, below(500.0), {"kind": "time", "at_s": 1.0, "pattern": WIDE})
    above_m, chosen = np.array([400.0]), np.empty(1, dtype=np.int64)
    state = model.choose(model.initial, np.array([1.0]), above_m, np.array([0.0]), chosen)
    assert [type(active) for active in state.active] == [bool, bool]
    assert state.active == (True, True)


def test_datum() -> None:
    ground, origin = scanner(WIDE, below(50.0, datum="ground")), scanner(WIDE, below(50.0))
    assert ground.needs_ground_altitude
    assert not origin.needs_ground_altitude
    shots = [(0.0, 100.0, 40.0), (1.0, 40.0, 100.0)]
    assert choices(ground, *shots) == [1, 1]
    assert choices(origin, *shots) == [0, 1]


def test_time_switch_and_last_active_switch_wins() -> None:
    timed = {"kind": "time", "at_s": 2.0, "pattern": WIDE}
    shots = [(0.0, 200.0, NAN), (1.0, 90.0, NAN), (2.0, 90.0, NAN), (3.0, 40.0, NAN)]
    assert choices(scanner(WIDE, below(100.0), timed, below(50.0)), *shots) == [0, 1, 2, 3]
    assert choices(scanner(WIDE, timed, below(50.0), below(100.0)), *shots) == [0, 3, 3, 3]


@given(st.lists(st.one_of(st.floats(0, 100), st.just(NAN)), max_size=30), st.floats(0, 100))
def test_switch_agrees_with_its_history(altitudes_m: list[float], below_m: float) -> None:
    """Active if a shot so far was below."""
    model = scanner(WIDE, below(below_m, datum="ground"))
    found = choices(model, *((float(k), 0.0, altitude) for k, altitude in enumerate(altitudes_m)))
    for k in range(len(altitudes_m)):
        assert found[k] == int(any(a < below_m for a in altitudes_m[: k + 1]))


def test_mounting() -> None:
    assert np.array_equal(mounting_rotation(Mounting()), np.eye(3))
    part = Mounting(roll_deg=10.0, pitch_deg=-25.0, yaw_deg=140.0)
    expected = Rotation.from_euler("ZYX", [140, -25, 10], degrees=True).as_matrix()
    np.testing.assert_allclose(mounting_rotation(part), expected, atol=1e-15)
    forward = rotate(mounting_rotation(Mounting(pitch_deg=20.0)), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(forward, [np.sin(np.radians(20)), 0, np.cos(np.radians(20))], atol=1e-15)


def test_scan_sweeps_the_beams_across_track() -> None:
    """Against scipy's rotations: a positive turn about x takes z to the left, so a scan to the right is negative."""
    fore_and_aft = {"kind": "directions", "beams": [(2.0, 0.0), (2.0, 180.0)]}
    model = scanner(fore_and_aft, scan={"half_angle_deg": 10.0, "steps": 5})
    assert (model.steps, model.set_count) == (5, 1)
    for step, turn_deg in enumerate([-10.0, -5.0, 0.0, 5.0, 10.0]):
        expected = Rotation.from_euler("x", -turn_deg, degrees=True).apply(
            scanner(fore_and_aft).true_sensor[0]
        )
        np.testing.assert_allclose(model.true_sensor[step], expected, atol=1e-15)
    np.testing.assert_allclose(model.angle_deg[2], 2.0)
    np.testing.assert_allclose(
        np.cos(np.radians(model.angle_deg[4])), np.cos(np.radians([2, 2])) * np.cos(np.radians(10))
    )
    assert model.published_sensor[4, 0, 1] > 0 > model.published_sensor[0, 0, 1]


def test_scan_goes_on_from_shot_to_shot_whatever_the_pattern() -> None:
    model = scanner(WIDE, below(100.0), scan={"half_angle_deg": 3.0, "steps": 4, "azimuth_deg": 0.0})
    assert model.set_count == 2
    chosen = np.array([0, 0, 0, 1, 1, 1])
    assert model.row(chosen, np.arange(6)).tolist() == [0, 1, 2, 7, 4, 5]
    np.testing.assert_array_equal(model.row(chosen, np.arange(6)) // 4, chosen)


def test_scan_swings_misaligned_beams_with_the_head() -> None:
    nadir = {"kind": "directions", "beams": [(0.0, 0.0)]}
    model = scanner(nadir, scan={"half_angle_deg": 10.0, "steps": 2}, misalignment_mrad=[(1.0, 0.0)])
    apart = np.linalg.norm(model.true_sensor - model.published_sensor, axis=-1)
    np.testing.assert_allclose(apart, 1e-3, rtol=1e-6)
    steps = np.degrees(np.arctan2(model.true_sensor[:, 0, 1], model.true_sensor[:, 0, 2]))
    np.testing.assert_allclose(np.diff(steps), 20.0)
