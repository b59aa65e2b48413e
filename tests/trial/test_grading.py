"""Grades of navigations whose errors, trust and gaps are known."""

from __future__ import annotations

import numpy as np
import pytest

import lidar_emu
from lidar_emu.beams.flight import Flight
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.trial.grading import COMMANDED, FIGURES, SERIES, Grade, grade, true_motion
from lidar_emu.trial.solutions import Solutions, Trust

ALTITUDE_M, VELOCITY_MPS, POSITION_M = 2.0, 0.05, 3.0
BIASED = "[{kind: bias, beams: [1], range_m: 40, from_s: 8, to_s: 10}]"


def scenario(faults: str = "[]") -> FlightScenario:
    loaded = load("descent", {"faults": faults})
    assert isinstance(loaded, FlightScenario)
    return loaded


@pytest.fixture(scope="module")
def flight() -> Flight:
    return Flight(scenario())


@pytest.fixture(scope="module")
def biased() -> Measurement:
    return lidar_emu.simulate(scenario(BIASED), seed=3)


def ground_m(flight: Flight, east_m: FloatArray, north_m: FloatArray) -> FloatArray:
    return flight.scene.height_m(east_m, north_m)


def stated(flight: Flight, flown: Measurement, noise: float = 1.0) -> Solutions:
    """A navigation that states the trajectory itself, with Gaussian errors of the sigmas that it states."""
    rng = np.random.default_rng(5)
    time_s = flown.time_ns.max(axis=1) * 1e-9
    state = flight.trajectory.state(time_s)
    shots, ones = len(time_s), np.ones((len(time_s), 3))
    up_m = state.position_site_m[:, 2] - ground_m(flight, *state.position_site_m[:, :2].T)
    trust = np.full((shots, flown.beam_count), Trust.USED, dtype=np.int8)
    return Solutions(
        time_s=time_s,
        arrived_s=time_s + 0.02,
        altitude_m=up_m + noise * ALTITUDE_M * rng.standard_normal(shots),
        sigma_altitude_m=np.full(shots, ALTITUDE_M),
        position_site_m=state.position_site_m + noise * POSITION_M * rng.standard_normal((shots, 3)),
        sigma_position_m=POSITION_M * ones,
        velocity_site_mps=state.velocity_site_mps + noise * VELOCITY_MPS * rng.standard_normal((shots, 3)),
        sigma_velocity_mps=VELOCITY_MPS * ones,
        range_trust=trust,
        speed_trust=trust.copy(),
    )


def graded(flight: Flight, flown: Measurement, solutions: Solutions) -> Grade:
    def height_m(east_m: FloatArray, north_m: FloatArray) -> FloatArray:
        return ground_m(flight, east_m, north_m)

    return grade(flown, height_m, solutions, {"set_pattern": 10.0, "reset": 1000.0})


def test_truth_between_shots_is_the_trajectorys(flight, biased):
    time_s = np.linspace(0.3, 50.3, 777)
    truth, state = true_motion(biased, flight.scene.height_m, time_s), flight.trajectory.state(time_s)
    np.testing.assert_allclose(truth.position_site_m, state.position_site_m, atol=1e-4)
    off_mps = np.abs(truth.velocity_site_mps - state.velocity_site_mps)
    # A step of the acceleration between two shots costs an eighth of step times period.
    assert off_mps.max() < 2 * 0.05 / 8
    assert np.quantile(off_mps, 0.99) < 1e-6
    outside = true_motion(biased, flight.scene.height_m, np.array([-0.1, 50.6]))
    assert np.isnan(outside.position_site_m).all()
    assert np.isnan(outside.altitude_m).all()


def test_a_navigation_that_states_its_errors_is_consistent(flight, biased):
    """Shares of a Gaussian, and the mean of chi-square of three degrees, within four standard errors."""
    found = graded(flight, biased, stated(flight, biased))
    count = len(biased)
    assert set(found.figures) == set(FIGURES) - {COMMANDED}
    assert set(found.series) == set(SERIES)
    for name, share, values in (
        ("altitude_within_1_sigma", 0.6827, count),
        ("altitude_within_3_sigma", 0.9973, count),
        ("velocity_within_1_sigma", 0.6827, 3 * count),
        ("velocity_within_3_sigma", 0.9973, 3 * count),
    ):
        assert found.figures[name] == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / values))
    assert found.figures["velocity_nees_mean"] == pytest.approx(3, abs=4 * np.sqrt(6 / count))
    assert np.mean(found.series["position_nees"].value) == pytest.approx(3, abs=4 * np.sqrt(6 / count))
    np.testing.assert_allclose(found.series["latency_s"].value, 0.02)


def test_sigmas_ten_times_too_small_are_seen(flight, biased):
    solutions = stated(flight, biased)
    found = graded(flight, biased, solutions._replace(sigma_velocity_mps=0.1 * solutions.sigma_velocity_mps))
    assert found.figures["velocity_nees_mean"] == pytest.approx(300, rel=0.2)
    assert found.figures["velocity_within_3_sigma"] < 0.35


def test_a_frozen_clock_is_an_error_of_the_motion(flight, biased):
    """Solutions of half a second ago under the time of now: the altitude is off by the sink rate times the delay."""
    solutions = stated(flight, biased, noise=0.0)
    late = solutions._replace(time_s=solutions.time_s + 0.5)
    found = graded(flight, biased, late)
    sink_mps = -found.truth.velocity_site_mps[:-20, 2]
    np.testing.assert_allclose(
        found.series["altitude_error_m_abs"].value[:-20], 0.5 * sink_mps, rtol=0.05, atol=0.3
    )


@pytest.mark.parametrize("delay_shots", [0, 4])
def test_the_biased_beam_is_the_one_deception_and_its_distrust_is_timed(flight, biased, delay_shots):
    solutions = stated(flight, biased)
    off = np.abs(biased.range_m - biased.true_range_m)[:, 1] > 20
    first, last = np.flatnonzero(off)[[0, -1]]
    solutions.range_trust[first + delay_shots : last + 11, 1] = Trust.GATED
    found = graded(flight, biased, solutions)
    ours = [each for each in found.deceptions if each.quantity == "range" and each.beam == 1]
    assert len(ours) == 1
    period_s = 1 / 20
    assert ours[0].from_s == pytest.approx(biased.time_ns[first, 1] * 1e-9)
    assert ours[0].until_s == pytest.approx(biased.time_ns[last, 1] * 1e-9)
    wrong = np.flatnonzero(off)
    first_rejected = wrong[wrong >= first + delay_shots][0]
    assert ours[0].distrust_s == pytest.approx((first_rejected - first) * period_s, abs=0.5 * period_s)
    assert ours[0].recovery_s == pytest.approx(11 * period_s, abs=0.5 * period_s)
    # Ten shots after the last wrong one were right and rejected, of all right values of eight.
    right = biased.range_valid.sum() + biased.speed_valid.sum() - off.sum()
    assert found.figures["false_distrust_share"] == pytest.approx(10 / right, rel=0.15)
    wrong = sum(1 for each in found.deceptions)
    assert found.figures["deceived_share"] >= (delay_shots > 0) * delay_shots / (off.sum() + 40 * wrong)


def test_a_navigation_that_never_distrusts_and_one_that_does_not_say(flight, biased):
    trusting = graded(flight, biased, stated(flight, biased))
    silent = stated(flight, biased)
    silent.range_trust[:] = silent.speed_trust[:] = Trust.NOT_JUDGED
    unknown = graded(flight, biased, silent)
    assert np.isinf(trusting.series["distrust_s"].value).all()
    assert trusting.figures["deceived_share"] == 1
    assert trusting.figures["false_distrust_share"] == 0
    assert np.isnan(unknown.series["distrust_s"].value).all()
    assert np.isnan(unknown.figures["deceived_share"])


def test_a_deception_that_no_solution_took_in_is_not_judged(flight, biased):
    solutions = stated(flight, biased)
    missed = (solutions.time_s > 7.9) & (solutions.time_s < 10.2)
    found = graded(flight, biased, Solutions(*(column[~missed] for column in solutions)))
    (ours,) = [each for each in found.deceptions if each.quantity == "range" and each.beam == 1]
    assert np.isnan(ours.distrust_s)
    assert np.isnan(ours.recovery_s)
    before = solutions.time_s < 7.9
    (ended,) = [
        each
        for each in graded(flight, biased, Solutions(*(column[before] for column in solutions))).deceptions
        if each.quantity == "range" and each.beam == 1
    ]
    assert np.isnan(ended.recovery_s)


def test_a_beam_without_a_value_in_between_is_not_distrusted(flight):
    """All wrong values are used; for a while the beam has none, and the navigation says so."""
    blinking = BIASED[:-1] + ", {kind: dropout, beams: [1], from_s: 8.5, to_s: 8.7}]"
    flown = lidar_emu.simulate(scenario(blinking), seed=3)
    solutions = stated(flight, flown)
    solutions.range_trust[~flown.range_valid] = Trust.INVALID
    (ours,) = [
        each
        for each in graded(flight, flown, solutions).deceptions
        if each.quantity == "range" and each.beam == 1
    ]
    assert ours.distrust_s == ours.recovery_s == np.inf


def test_gaps_are_unavailability(flight, biased):
    solutions = stated(flight, biased)
    kept = (solutions.time_s < 5) | (solutions.time_s > 9)
    found = graded(flight, biased, Solutions(*(column[kept] for column in solutions)))
    flight_s = (biased.time_ns.max() - biased.time_ns.min()) * 1e-9
    assert found.figures["longest_gap_s"] == pytest.approx(4, abs=0.1)
    assert found.figures["available_share"] == pytest.approx(1 - 3.5 / flight_s, abs=0.1 / flight_s)
    nothing = graded(flight, biased, Solutions(*(column[:0] for column in solutions)))
    assert nothing.figures["available_share"] == 0
    assert nothing.figures["solutions"] == 0


def test_touchdown_is_the_end_of_the_flight(flight, biased):
    found = graded(flight, biased, stated(flight, biased))
    state = flight.trajectory.state(biased.time_ns[-1:, 0] * 1e-9)
    assert found.figures["touchdown_speed_mps"] == pytest.approx(np.linalg.norm(state.velocity_site_mps))
    assert found.figures["touchdown_distance_m"] == pytest.approx(np.hypot(*state.position_site_m[0, :2]))


def test_a_command_has_the_altitude_at_which_it_was_accepted(flight, biased):
    found = graded(flight, biased, stated(flight, biased))
    (position_m,) = flight.trajectory.state(np.array([10.0])).position_site_m
    assert found.commanded_m["set_pattern"] == pytest.approx(
        position_m[2] - ground_m(flight, *position_m[:2, None])[0]
    )
    assert np.isnan(found.commanded_m["reset"])


def test_values_that_are_missing_or_absurd_do_not_stop_a_grade(flight, biased):
    solutions = stated(flight, biased)
    for column in solutions[2:8]:
        column[::2] = np.nan
        column[1::4] = 1e12
    found = graded(flight, biased, solutions)
    assert set(found.figures) == set(FIGURES) - {COMMANDED}
