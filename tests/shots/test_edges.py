"""Light on either side of an edge, against the share of a Gaussian."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erfc

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.footprint import beam_radius_m, beamlet_pattern
from lidar_emu.receiver.build_level import build_level
from lidar_emu.receiver.echoes import EchoModel
from lidar_emu.receiver.received_echoes import depth_nodes, roughened
from lidar_emu.receiver.returns import FACE
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model, measure_in_blocks

WAIST_M, WAVELENGTH_M = 0.017, 1550e-9
TOP_M, ALTITUDE_M = 5.0, 200.0
RADIUS_M = float(beam_radius_m(np.array(ALTITUDE_M - TOP_M), WAIST_M, WAVELENGTH_M))
# An edge along a row of beamlets would divide them by rounding.
YAW_DEG = 15.0 * np.arange(12) + 1.0
DISTANCE_W = np.linspace(0.0, 1.0, 21)
SLAB = {"name": "slab", "kind": "slab", "length_m": 20, "width_m": 20, "height_m": TOP_M}


def over(make_flight, *objects, beamlets=19, **parts):
    """A beam straight down from `ALTITUDE_M`."""
    return make_flight(
        **{
            "duration_s": 2.0,
            "trajectory": {
                "kind": "profile",
                "waypoints": [
                    {"altitude_m": ALTITUDE_M, "speed_mps": 1},
                    {"altitude_m": ALTITUDE_M - 5, "speed_mps": 1},
                ],
            },
            "scanner": {"pattern": {"kind": "ring", "count": 1, "angle_deg": 0}},
            "instrument": {"optics": {"waist_radius_m": WAIST_M, "beamlets": beamlets}},
            "site": {"ground": {"kind": "plane"}, "objects": list(objects)},
            **parts,
        }
    )


def aimed(scenario, yaw_deg, beyond_m):
    """Model of the echoes, with beams and hits of shots through points at the height of the slab, so far from the
    site's origin in the direction of the yaw."""
    flight, yaw = Flight(scenario), np.radians(yaw_deg)
    pointing, _ = flight.point(np.arange(len(beyond_m)), flight.scanner.initial)
    place_m = np.outer(beyond_m, [np.sin(yaw), np.cos(yaw), 0]) + np.array([0, 0, TOP_M])
    axis = pointing.true_site[:, 0]
    pointing.sensor_site_m[:, 0] = place_m + (ALTITUDE_M - TOP_M) * axis / axis[:, 2:]
    model = EchoModel(scenario.instrument, scenario.site, flight, scenario.instrument.optics.beamlets)
    return model, pointing, flight.cast(pointing)


def share_of_object(scenario, yaw_deg, beyond_m):
    """Share of the footprint's light on top of the first object, for each shot."""
    model, pointing, axis_hits = aimed(scenario, yaw_deg, beyond_m)
    share = on_top(model.cast_beamlets(pointing, axis_hits), len(beyond_m))
    share = share @ beamlet_pattern(share.shape[1])[1]
    if model.cut_beams is not None:
        (beam, weight, _), hits = model.cut_beams
        np.testing.assert_allclose(weight.sum(axis=1), 1.0, rtol=1e-12)
        share[beam] = (weight * on_top(hits, len(beam))).sum(axis=1)
    return share


def on_top(hits, beams):
    return ((hits.object_id == 1) & (hits.normal_site[:, 2] > 0.5)).reshape(beams, -1)


def beyond(distance_w):
    """Share of a footprint beyond a straight line at a distance from its centre."""
    return 0.5 * erfc(2.0 * distance_w)


@pytest.mark.parametrize(("beamlets", "error"), [(7, 0.07), (19, 0.03), (37, 0.03)])
def test_straight_edge(make_flight, beamlets, error) -> None:
    for yaw_deg in YAW_DEG:
        scenario = over(make_flight, SLAB | {"yaw_deg": yaw_deg}, beamlets=beamlets)
        share = share_of_object(scenario, yaw_deg, 10.0 + DISTANCE_W * RADIUS_M)
        np.testing.assert_allclose(share, beyond(DISTANCE_W), atol=error)


@pytest.mark.parametrize(
    ("beamlets", "width_w", "error"), [(7, 0.7, 0.07), (19, 1.0, 0.03), (19, 0.5, 0.03), (37, 0.4, 0.03)]
)
def test_strip(make_flight, beamlets, width_w, error) -> None:
    """Down to the distance of rows of beamlets; narrower ones may lie between two rows."""
    for yaw_deg in YAW_DEG:
        strip = SLAB | {"yaw_deg": yaw_deg, "length_m": width_w * RADIUS_M}
        share = share_of_object(over(make_flight, strip, beamlets=beamlets), yaw_deg, DISTANCE_W * RADIUS_M)
        expected = beyond(DISTANCE_W - width_w / 2) - beyond(DISTANCE_W + width_w / 2)
        np.testing.assert_allclose(share, expected, atol=error)


def test_oblique_beam_over_the_edge_that_hides_the_ground(make_flight) -> None:
    pattern = {"kind": "directions", "beams": [[30, 90]]}
    scenario = over(make_flight, SLAB | {"yaw_deg": 90}, scanner={"pattern": pattern})
    slant = 1 / np.cos(np.radians(30))
    radius_m = float(beam_radius_m(np.array((ALTITUDE_M - TOP_M) * slant), WAIST_M, WAVELENGTH_M))
    share = share_of_object(scenario, 90.0, 10.0 + DISTANCE_W * radius_m * slant)
    np.testing.assert_allclose(share, beyond(DISTANCE_W), atol=0.01)


@pytest.mark.parametrize(
    "other",
    [{"reflectance": 0.5}, {"motion": {"velocity_mps": [0, 0, 3]}}, {"height_m": TOP_M - 0.1}],
    ids=["albedo", "speed", "step"],
)
def test_difference_beside_another_surface(make_flight, other) -> None:
    """Two slabs side by side differ in one thing."""
    beside = SLAB | {"name": "beside", "north_m": 20.0, **other}
    share = share_of_object(over(make_flight, SLAB, beside), 0.0, 10.0 + DISTANCE_W[:1] * RADIUS_M)
    assert share[0] == pytest.approx(0.5, abs=0.01)
    model, pointing, axis_hits = aimed(over(make_flight, SLAB, beside), 0.0, [10.0])
    model.cast_beamlets(pointing, axis_hits)
    assert model.cut_beams is not None


@pytest.mark.parametrize(
    "beside",
    [
        SLAB | {"name": "beside", "north_m": 20.0},
        # Its lower end lies on the ground, its upper one level with the slab: 14 cm from beamlet to beamlet.
        {"name": "beside", "kind": "ramp", "north_m": 12.0, "yaw_deg": 180}
        | {"width_m": 20, "length_m": 2.0, "height_m": TOP_M},
    ],
    ids=["level", "crease"],
)
def test_surfaces_that_meet_are_not_cut(make_flight, beside) -> None:
    scenario = over(make_flight, SLAB, beside, instrument={"optics": {"waist_radius_m": 0.001}})
    model, pointing, axis_hits = aimed(scenario, 0.0, 10.0 + DISTANCE_W * RADIUS_M)
    hits = model.cast_beamlets(pointing, axis_hits)
    assert set(hits.object_id) == {1, 2}
    assert model.cut_beams is None


@pytest.mark.parametrize("distance_w", [0.1, 0.29])
def test_surface_that_wins(make_flight, distance_w) -> None:
    """With speckle the stronger of two surfaces is measured, each as often as its share of the light."""
    scenario = over(make_flight, SLAB | {"yaw_deg": 0.0}, instrument={"optics": {"waist_radius_m": WAIST_M}})
    model, pointing, axis_hits = aimed(scenario, 0.0, [10.0 + distance_w * RADIUS_M])
    echoes = model.echoes(pointing, axis_hits)
    echoes.speckle_place[..., FACE] = 0.0
    shots = 4000
    many = type(echoes)(*(np.repeat(values, shots if len(values) else 1, axis=0) for values in echoes))
    returns = build_level(scenario, model.columns)(many, np.arange(shots))
    valid = returns.range_valid
    top = np.abs(returns.range_m[valid] - (ALTITUDE_M - TOP_M)) < 1.0
    foot = np.abs(returns.range_m[valid] - ALTITUDE_M) < 1.0
    assert valid.mean() > 0.95
    assert (top | foot).mean() > 0.99
    assert top.mean() == pytest.approx(beyond(distance_w), abs=0.03)


def low_over_bars(make_flight):
    """Four beams from 20 m over bars of 6 cm, with all that changes echoes."""
    bars = [
        SLAB | {"name": f"bar {k}", "north_m": 0.1 * k, "length_m": 0.06, "height_m": 0.4}
        for k in range(-60, 60)
    ]
    return over(
        make_flight,
        duration_s=1.5,
        trajectory={
            "kind": "profile",
            "waypoints": [{"altitude_m": 20, "speed_mps": 3}, {"altitude_m": 15, "speed_mps": 3}],
        },
        scanner={"pattern": {"kind": "square", "angle_deg": 10}},
        instrument={"optics": {"waist_radius_m": WAIST_M, "leakage_db": -30}},
        site={"ground": {"kind": "plane"}, "objects": bars},
        plume={"streak_share": 0.5},
        faults=[
            {"kind": "reflectance_patch", "centre_m": [0, 0], "radius_m": 50, "reflectance": 0.9},
            {"kind": "clutter", "range_m": 3, "reflectance": 0.1},
        ],
    )


def test_shots_do_not_depend_on_their_block(make_flight) -> None:
    scenario = low_over_bars(make_flight)
    whole, alone = (
        [block.range_m for block in measure_in_blocks(build_model(scenario), size)] for size in (40, 1)
    )
    np.testing.assert_array_equal(np.concatenate(whole), np.concatenate(alone))


def test_second_parts_take_part_in_what_changes_echoes(make_flight) -> None:
    """Streaks of dust are the column behind them; they are rough, and painted by a patch."""
    model, shot = FlightModel(low_over_bars(make_flight)), np.arange(40)
    pointing, _ = model.aim(shot, model.initial_state)
    echoes = model.echo_model.echoes(pointing, model.flight.cast(pointing))
    second = np.zeros(echoes.power_w.shape, dtype=bool)
    second[..., 19:] = echoes.power_w[..., 19:] > 0
    assert second.any(axis=(0, 2)).all()
    assert model.level.model.ground_beamlets == echoes.power_w.shape[2] == 38
    rough = roughened(echoes, 0.01, model.echo_model.beamlet_hits, depth_nodes(0.01, 0.6))
    assert np.isfinite(rough.range_m[..., :38][second]).all()
    patched = model.physics.modified(echoes, model.echo_model.beamlet_hits, shot)
    # The clutter takes its share from all.
    ratio = patched.power_w[..., :38][second] / echoes.power_w[second]
    np.testing.assert_allclose(ratio, ratio[0])
    assert ratio[0] > 2.0
