"""Several grids, detail and the cut of a flight's ground, from the scenario on."""

from pathlib import Path

import numpy as np
import pytest

import lidar_emu
from lidar_emu.beams.flight import Flight
from lidar_emu.errors import InputError
from lidar_emu.plan.flight import plan_flight
from lidar_emu.scene.mosaic import grids
from lidar_emu.scene.procedural.generate import fractional_surface
from lidar_emu.scene.ray_reach import CroppedGround

SCENARIO = """
name: nested
timing: {{rate_hz: 20}}
instrument: {{base: ndl_four_beam, optics: {{beamlets: 7}}}}
scanner: {{base: ndl_four_beam, misalignment_mrad: [[1, 2], [0, 0], [0, 0], [-3, 0]]}}
mounting: {{lever_arm_m: [1.0, 0.5, 1.5], pitch_deg: 5}}
trajectory:
  kind: profile
  path_angle_deg: 60
  waypoints: [{{altitude_m: 600, speed_mps: 60}}, {{altitude_m: 20, speed_mps: 5}}]
  attitude: {{body_rate_radps: [0, 0, 0.05]}}
site: {{ground: {ground}}}
faults: {faults}
"""
ORIGIN = "origin: {map_x_m: 4000, map_y_m: 4000}"
WIDE = "{kind: grid, file: wide.npz, beyond: plane}"
DETAIL = "detail: {spacing_m: 0.3, below_m: 60}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wide map at 8 m, and the middle of the same surface at 2 m, which another team put 3 m higher."""
    here = tmp_path_factory.mktemp("maps")
    surface_m = 150 * fractional_surface(1001, 0.8, np.random.default_rng(4))
    np.savez(here / "wide.npz", elevation_m=surface_m[::4, ::4], pixel_m=8.0, map_x_m=3000.0, map_y_m=5000.0)
    fine_m = surface_m[400:601, 380:621] + 3
    np.savez(here / "fine.npz", elevation_m=fine_m, pixel_m=2.0, map_x_m=3760.0, map_y_m=4200.0)
    return here


def load(folder: Path, ground: str, faults: str = "[]"):
    path = folder / "nested.yaml"
    path.write_text(SCENARIO.format(ground=ground, faults=faults))
    return lidar_emu.load(path)


def nested(fine: str = "", wide: str = WIDE, more: str = "") -> str:
    return f"{{kind: nested, grids: [{{kind: grid, file: fine.npz, {ORIGIN}{fine}}}, {wide}]{more}}}"


def test_flies_over_both(folder):
    flown = load(folder, nested())
    scene = Flight(flown).scene
    run = lidar_emu.simulate(flown)
    assert np.isfinite(run.true_range_m[run.fired]).all()
    at = np.array([0.0, 500.0]), np.array([0.0, 0.0])
    fine, wide = (np.load(folder / name)["elevation_m"] for name in ("fine.npz", "wide.npz"))
    # Map (4000, 4000) is the origin, row and column of which are 100 and 120 of the fine map, 125 of the wide one.
    assert scene.height_m(*at)[0] == 0
    across = 125 + 500 / 8
    wide_m = wide[125, int(across)] * (1 - across % 1) + wide[125, int(across) + 1] * (across % 1)
    assert scene.height_m(*at)[1] == pytest.approx(wide_m - fine[100, 120])


def test_plan_reports_the_offset_between_the_maps(folder):
    flown = load(folder, nested(f", {DETAIL}"))
    rows = {(d.stage, d.how): d for d in plan_flight(flown, Flight(flown)).decisions if d.stage == "seam"}
    detail, fine = rows.values()
    assert "+3.00 m ± 0." in fine.reason
    assert fine.how == "blended over 32 m"
    assert "detail to 0.25 m" in detail.reason


def test_same_measurements_before_and_after_the_cut(folder, monkeypatch):
    ground = nested(f", {DETAIL}")
    faults = "[{kind: misalignment, from_s: 3, tilt_mrad: [20, -40]}]"
    before = lidar_emu.simulate(load(folder, ground, faults))
    monkeypatch.setattr(grids, "CUT_FROM_SAMPLES", 0)
    flown = load(folder, ground, faults)
    flight = Flight(flown)
    assert isinstance(flight.scene, CroppedGround)
    assert sum(kept.retained for kept in flight.scene.grids) < 0.8 * sum(
        kept.samples for kept in flight.scene.grids
    )
    decisions = [d for d in plan_flight(flown, flight).decisions if d.stage == "ground out of reach"]
    assert len(decisions) == 2
    assert not any(d.computed for d in decisions)
    monkeypatch.setattr(CroppedGround, "whole", property(lambda _: pytest.fail("a ray strayed")))
    after = lidar_emu.simulate(flown)
    for name, column in before.table().items():
        np.testing.assert_array_equal(after.table()[name], column, err_msg=name)


def test_a_misalignment_ordered_in_flight_finds_its_ground(folder, monkeypatch):
    from lidar_emu.shots.model import build_model, measure_whole

    faults = "[{kind: misalignment, from_s: 3, tilt_mrad: [400, 300]}]"
    expected = lidar_emu.simulate(load(folder, nested(), faults))
    monkeypatch.setattr(grids, "CUT_FROM_SAMPLES", 0)
    model = build_model(load(folder, nested()))
    ordered = measure_whole(model.with_faults(load(folder, nested(), faults).faults))
    assert isinstance(model.flight.scene, CroppedGround)
    np.testing.assert_array_equal(ordered.true_range_m, expected.true_range_m)


def test_detail_is_where_the_flight_is_low(folder):
    flown = load(folder, nested(f", {DETAIL}"))
    scene = Flight(flown).scene
    west_m, east_m, *_ = scene.rectangle
    assert 100 < east_m - west_m < 300
    plain = Flight(load(folder, nested())).scene
    # Samples stay, and between them there is something new.
    place = np.arange(-2, 3) * 2.0
    np.testing.assert_allclose(scene.height_m(place, place), plain.height_m(place, place), atol=1e-12)
    between = np.linspace(-4, 4, 331)
    new_m = scene.height_m(between, 0 * between + 0.25) - plain.height_m(between, 0 * between + 0.25)
    assert 0.01 < new_m.std() < 0.5


def test_fits_what_is_generated_into_a_map(folder):
    made = "{kind: generated, size_m: 64, spacing_m: 0.5, at_m: [20, -10], relief: {rms_slope_deg: 4, baseline_m: 2}}"
    ground = f"{{kind: nested, grids: [{{kind: grid, file: fine.npz, {ORIGIN}}}, {made}, {WIDE}]}}"
    with pytest.raises(
        InputError, match=r"ground.grids.1: 0.5 m from sample to sample .*; list the finest grid first"
    ):
        Flight(load(folder, ground)).scene  # noqa: B018
    ground = f"{{kind: nested, grids: [{made}, {{kind: grid, file: wide.npz, {ORIGIN}, at_m: [0, 0], beyond: plane}}]}}"
    scene = Flight(load(folder, ground)).scene
    assert scene.rectangle == (-12, 52, -42, 22)


@pytest.mark.parametrize(
    ("ground", "words"),
    [
        ("{kind: nested, grids: [{kind: grid, file: fine.npz}]}", ["grids", "at least 2"]),
        (nested(", beyond: plane"), ["grids.0.beyond", "plane", "last of the grids"]),
        (nested(wide="{kind: grid, file: gone.npz}"), ["gone.npz", "no such file"]),
        (nested(wide="{kind: grid, file: nested.yaml}"), ["nested.yaml", "unreadable"]),
        (nested(", detail: {spacing_m: 0}"), ["detail.spacing_m", "0"]),
        (nested(", detail: {spacing_m: 1e-3}"), ["fine.npz", "samples over", "at most 40000000", "below_m"]),
        (nested(", detail: {spacing_m: 1, hurst: 2}"), ["detail.hurst", "2"]),
        (
            "{kind: nested, grids: [{kind: grid, file: fine.npz}, {kind: grid, file: wide.npz}]}",
            ["wide.npz", "no position relative to the first grid", "at_m"],
        ),
        (nested(wide="{kind: grid, file: fine.npz, at_m: [0, 0]}"), ["m east", "stay over the ground"]),
    ],
)
def test_refusals(folder, ground, words):
    with pytest.raises(InputError) as refusal:
        Flight(load(folder, ground)).scene  # noqa: B018
    line = str(refusal.value)
    assert "\n" not in line
    for word in words:
        assert word in line
