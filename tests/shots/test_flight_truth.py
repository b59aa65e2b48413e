"""Truth of a flight against closed forms: the beams, the ground and the sensor on a turning body."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.beams.flight import Flight
from lidar_emu.beams.pointing import BeamVectors
from lidar_emu.measurement import Measurement
from lidar_emu.receiver.returns import Reason
from lidar_emu.shots.model import build_model, measure_in_blocks

SLANT = 1 / np.cos(np.radians(22.5))


def test_vertical_descent_over_a_plane(make_flight):
    run = simulate(make_flight())
    up_m = run.position_site_m[:, 2:]
    speed_mps = -run.velocity_site_mps[:, 2:]
    np.testing.assert_allclose(
        run.true_range_m, np.broadcast_to(up_m * SLANT, run.true_range_m.shape), rtol=1e-12
    )
    np.testing.assert_allclose(
        run.true_closing_speed_mps, np.broadcast_to(speed_mps / SLANT, run.true_range_m.shape), rtol=1e-12
    )
    np.testing.assert_allclose(run.true_incidence_deg, 22.5, rtol=1e-12)
    # v² falls linearly with altitude: 60 to 20 m/s over 900 m.
    np.testing.assert_allclose(speed_mps**2, 400 + (up_m - 100) * (3600 - 400) / 900, rtol=1e-9)


def test_validity_is_the_centre_of_the_constant_segment(make_flight):
    run = simulate(make_flight(timing={"rate_hz": 10}))
    record_s = 2**17 / 600e6
    expected_s = 0.1 * np.arange(len(run)) + 2 * 300e-6 - record_s / 2
    np.testing.assert_allclose(run.time_s, np.repeat(expected_s[:, None], 4, axis=1), atol=1e-9)
    # The packet is due when the cycle has ended and 2 ms of processing have passed.
    np.testing.assert_array_equal(run.due_ns, 100_000_000 * np.arange(len(run)) + 900_000 + 2_000_000)


def test_beams_in_turn_have_their_own_time_and_truth(make_flight):
    scanner = {"pattern": {"kind": "square", "angle_deg": 22.5}, "firing": "in_turn"}
    run = simulate(make_flight(scanner=scanner))
    together = simulate(make_flight())
    np.testing.assert_array_equal(np.diff(run.time_ns, axis=1), 900_000)
    np.testing.assert_array_equal(run.due_ns - together.due_ns, 3 * 900_000)
    fallen_m = (run.true_range_m[:, 0] - run.true_range_m[:, 3]) / SLANT
    speed_mps = -run.velocity_site_mps[:, 2]
    np.testing.assert_allclose(fallen_m, speed_mps * 2.7e-3, atol=2e-5)


@pytest.mark.parametrize("firing", ["together", "in_turn"])
def test_looks_are_centred_on_the_time_of_validity(make_flight, firing):
    """Four cycles of 0.9 ms a beam: the middle of their constant records lies 1.5 cycles after the first's."""
    scenario = make_flight(
        instrument={"detection": {"looks": 4}},
        scanner={"pattern": {"kind": "square", "angle_deg": 22.5}, "firing": firing},
    )
    beams_in_turn = 4 if firing == "in_turn" else 1
    assert scenario.cycle_time_s == pytest.approx(4 * 0.9e-3 * beams_in_turn, rel=1e-12)
    flight = Flight(scenario)
    pointing, _ = flight.point(np.arange(3), flight.scanner.initial)
    first_s = 2 * 300e-6 - 2**17 / 600e6 / 2 + 1.5 * 0.9e-3
    expected_s = first_s + np.arange(4) * 3.6e-3 * (firing == "in_turn")
    np.testing.assert_allclose(pointing.time_ns[0] * 1e-9, expected_s, atol=2e-9)
    np.testing.assert_array_equal(flight.due_ns(np.arange(1)), 3_600_000 * beams_in_turn + 2_000_000)


def test_looks_lower_the_rate_that_can_be_reached(make_flight):
    with pytest.raises(ValueError, match=r"at most 277\.778.*detection\.looks 4"):
        make_flight(instrument={"detection": {"looks": 4}}, timing={"rate_hz": 278})
    make_flight(instrument={"detection": {"looks": 4}}, timing={"rate_hz": 277})


def test_velocity_and_acceleration_of_the_sensor_on_a_turning_body(make_flight):
    flight = Flight(
        make_flight(
            trajectory={
                "kind": "profile",
                "waypoints": [{"altitude_m": 1000, "speed_mps": 60}, {"altitude_m": 900, "speed_mps": 30}],
                "attitude": {"body_rate_radps": [0.1, 0.5, -0.2]},
            },
            mounting={"lever_arm_m": [2.0, 0.3, -0.5]},
        )
    )
    flight.period_ns = 100_000
    pointing, _ = flight.point(np.arange(200), flight.scanner.initial)
    for rate, value, atol in (
        (pointing.sensor_velocity_site_mps, pointing.sensor_site_m, 2e-8),
        (BeamVectors(*pointing.beams).acceleration_mps2, pointing.sensor_velocity_site_mps, 1e-8),
        (np.cross(pointing.turning_site_radps, pointing.true_site), pointing.true_site, 1e-8),
    ):
        np.testing.assert_allclose(rate[1:-1], (value[2:] - value[:-2]) / 200e-6, atol=atol)


def test_plane_with_a_slope(make_flight):
    site = {"ground": {"kind": "plane", "slope_deg": 20, "downhill_azimuth_deg": 90}}
    run = simulate(make_flight(site=site))
    # Level at heading 0, sensor x points north and y east: beam at azimuth a looks sin a to the east.
    tilt, angle = np.tan(np.radians(20)), np.radians(22.5)
    east = np.sin(np.radians(45 + 90 * np.arange(4))) * np.sin(angle)
    expected = run.position_site_m[:, 2:] / (np.cos(angle) - tilt * east)
    np.testing.assert_allclose(run.true_range_m, expected, rtol=1e-12)
    against_normal = np.cos(np.radians(20)) * np.cos(angle) - np.sin(np.radians(20)) * east
    np.testing.assert_allclose(
        np.cos(np.radians(run.true_incidence_deg)),
        np.broadcast_to(against_normal, run.true_incidence_deg.shape),
        rtol=1e-12,
    )


def test_misalignment_moves_the_truth_but_not_the_published_direction(make_flight):
    scanner = {"pattern": {"kind": "ring", "count": 1, "angle_deg": 0}, "misalignment_mrad": [[0, 10]]}
    run = simulate(make_flight(scanner=scanner))
    np.testing.assert_allclose(run.true_range_m[:, 0], run.position_site_m[:, 2] / np.cos(10e-3), rtol=1e-9)
    below_m = run.position_site_m[:, None, :2] - run.point_site_m[..., :2]
    np.testing.assert_allclose(below_m, 0, atol=1e-9)


def test_a_switch_changes_angle_and_number_on_a_shot_boundary(make_flight):
    scanner = {
        "pattern": {"kind": "square", "angle_deg": 22.5},
        "switches": [
            {"kind": "altitude", "below_m": 500, "pattern": {"kind": "ring", "count": 3, "angle_deg": 7.5}}
        ],
    }
    run = simulate(make_flight(scanner=scanner))
    start_m = np.interp(0.05 * np.arange(len(run)), run.time_s[:, 0], run.position_site_m[:, 2])
    low = start_m < 500 - 0.1
    high = start_m > 500 + 0.1
    assert (run.beam_angle_deg[high] == 22.5).all()
    assert (run.beam_angle_deg[low][:, :3] == 7.5).all()
    assert not run.fired[low][:, 3].any()
    assert (run.reason[low][:, 3] == Reason.NOT_FIRED).all()
    for name in ("time_s", "range_m", "closing_speed_mps", "true_range_m", "beam_angle_deg"):
        assert np.isnan(getattr(run, name)[low][:, 3]).all(), name


@pytest.mark.parametrize(
    "scenario", ["descent.yaml", "nasa_three_beam.yaml", "dust_storm.yaml", "bench.yaml"]
)
def test_a_shot_does_not_depend_on_the_block_that_it_came_in(scenario):
    from lidar_emu.scenario.load import load

    model = build_model(load(scenario, {"duration_s": "6"}))
    whole = Measurement.concatenate(list(measure_in_blocks(model, 1000)))
    for size in (1, 7, 64):
        parts = Measurement.concatenate(list(measure_in_blocks(model, size)))
        for field in fields(Measurement):
            np.testing.assert_array_equal(getattr(parts, field.name), getattr(whole, field.name), field.name)
