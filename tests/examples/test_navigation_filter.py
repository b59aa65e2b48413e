"""The filter's parts against differences, against an exact flight, and its statistics against chi-square."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from beams import Array, directions, from_run
from error_state import ERRORS, MARE, ErrorState, Ground, rotation
from inertial import TACTICAL, Grade
from scipy.stats import chi2
from simulated_inertial import SimulatedInertial, rotation_vectors
from trials import START_SIGMAS, Log, errors, fly, normalised, start
from trust import CAREFUL, NoiseMonitor, Rules
from truth import Truth

import lidar_emu
from lidar_emu.errors import InputError

pytestmark = pytest.mark.slow

EXACT, FLAT = Grade(0, 0, 0, 0), Ground(0, 0)
TURNING = """{kind: profile, path_angle_deg: 50, heading_deg: 30,
    attitude: {yaw_deg: 20, pitch_deg: 10, roll_deg: -15, body_rate_radps: [0.05, -0.1, 0.2]},
    waypoints: [{altitude_m: 600, speed_mps: 30}, {altitude_m: 450, speed_mps: 25}]}"""
BEAMS = directions(22.5, [45.0, 135.0, 225.0, 315.0])
COUPLING_S2 = 0.029


def flown(**overrides: str) -> Truth:
    return Truth(lidar_emu.load("descent", {"site": "flat", **overrides}))


def some_state() -> ErrorState:
    """Free of noise; banked, over a slope, moving and accelerating."""
    state = ErrorState(
        np.array([10.0, -20.0, 300.0]),
        np.array([7.0, 12.0, -30.0]),
        rotation(np.array([0.1, 0.2, -0.7])) @ np.diag([1.0, -1.0, -1.0]),
        START_SIGMAS,
        EXACT,
        FLAT,
    )
    state.slope = np.array([0.05, -0.1])
    state.acceleration_site_mps2 = np.array([0.5, -0.4, 1.5])
    return state


def moved(error: Array) -> ErrorState:
    state = some_state()
    state.reinitialise(np.arange(ERRORS), error, np.eye(ERRORS))
    return state


@pytest.mark.parametrize("what", ["ranges", "speeds"])
def test_designs_are_the_derivatives(what: str) -> None:
    def predict(state: ErrorState) -> Array:
        predicted = state.ranges(BEAMS, COUPLING_S2) if what == "ranges" else state.speeds(BEAMS)
        return predicted.value

    design = (
        some_state().ranges(BEAMS, COUPLING_S2) if what == "ranges" else some_state().speeds(BEAMS)
    ).design
    for k in range(ERRORS):
        step = np.zeros(ERRORS)
        step[k] = 1e-6
        slope = (predict(moved(step)) - predict(moved(-step))) / 2e-6
        # What an acceleration turns with the attitude, 0.03 s^2 times 1.5 m/s^2, is left out.
        assert design[:, k] == pytest.approx(slope, abs=0.06 if what == "ranges" else 1e-6)
        assert np.abs(slope).max() > 0.1 or not np.any(design[:, k])


def test_the_covariance_is_carried_as_errors_are() -> None:
    """Pairs of filters, one of them wrong by a little in one thing, fed the same increments."""
    truth = flown(trajectory=TURNING)
    inertial = SimulatedInertial(truth, np.random.default_rng(1), EXACT)

    def after(error: Array) -> ErrorState:
        state = moved(error)
        state.covariance = np.outer(error, error)
        for increment in inertial.between(0, 500_000_000):
            state.propagate(increment)
        return state

    right = after(np.zeros(ERRORS))
    for k in range(ERRORS):
        step = np.zeros(ERRORS)
        step[k] = 1e-4
        wrong = after(step)
        off = np.concatenate(
            [
                wrong.position_site_m - right.position_site_m,
                wrong.velocity_site_mps - right.velocity_site_mps,
                rotation_vectors((wrong.site_from_body @ right.site_from_body.T)[None])[0],
                wrong.accelerometer_bias_mps2 - right.accelerometer_bias_mps2,
                wrong.gyroscope_bias_radps - right.gyroscope_bias_radps,
                wrong.slope - right.slope,
            ]
        )
        assert np.outer(off, off) == pytest.approx(wrong.covariance, abs=1e-11, rel=0.05)


def test_without_errors_the_inertial_unit_finds_the_way() -> None:
    truth = flown(trajectory=TURNING)
    true = truth.at(0)
    state = ErrorState(
        true.position_site_m, true.velocity_site_mps, true.site_from_body, START_SIGMAS, EXACT, MARE
    )
    for increment in SimulatedInertial(truth, np.random.default_rng(1), EXACT).between(0, 5_000_000_000):
        state.propagate(increment)
    off = errors(state, truth.at(5_000_000_000))
    assert np.abs(off).max() < 1e-6


def test_an_inertial_unit_has_the_errors_that_its_grade_states() -> None:
    """Biases appear as scatter among units, random walks as scatter among the ticks of one unit."""
    truth = flown(trajectory=TURNING)
    exact = list(SimulatedInertial(truth, np.random.default_rng(0), EXACT).between(0, 4_000_000_000))
    means, scatters = [], []
    for seed in range(60):
        increment = list(
            SimulatedInertial(truth, np.random.default_rng(seed), TACTICAL).between(0, 4_000_000_000)
        )
        off = np.array(
            [a.velocity_body_mps - b.velocity_body_mps for a, b in zip(increment, exact, strict=True)]
        )
        means.append(off.mean(axis=0) / 0.01)
        scatters.append(off.std(axis=0))
    assert np.mean(scatters) == pytest.approx(TACTICAL.accelerometer_noise * 0.1, rel=0.02)
    assert np.std(means) == pytest.approx(TACTICAL.accelerometer_bias_mps2, rel=0.2)


def test_increments_add_up_however_they_are_cut() -> None:
    inertial = SimulatedInertial(flown(trajectory=TURNING), np.random.default_rng(3), TACTICAL)
    whole = sum(increment.velocity_body_mps for increment in inertial.between(3_000_000, 1_003_000_000))
    cut_ns = [3_000_000, 3_500_001, 20_000_000, 777_777_777, 1_003_000_000]
    parts = [increment.velocity_body_mps for a, b in pairwise(cut_ns) for increment in inertial.between(a, b)]
    assert sum(parts) == pytest.approx(whole)


@cache
def honest_flights() -> list[Log]:
    """Five seconds with the published receiver over flat ground, of which the filter knows that it is flat.

    Each from another height: rounded values of the same flight would be off in the same way for every seed.
    """
    flights = []
    for seed in range(16):
        trajectory = TURNING.replace("0.05, -0.1, 0.2", "0, 0, 0").replace("600", f"{600 + 7.3 * seed}")
        truth = flown(trajectory=trajectory, duration_s="5")
        run = lidar_emu.simulate(truth.scenario, seed=seed)
        navigator = start(truth, int(run.time_ns[0, 0]), seed, CAREFUL, Ground(1e-6, 1e-9))
        flights.append(fly(truth, run, navigator))
    return flights


@pytest.mark.parametrize("at_s", [2.5, 4.9])
def test_errors_are_as_large_as_stated(at_s: float) -> None:
    """Normalised errors of the flights add up to chi-square: between its 0.1 and 99.9 %.

    Of position east and north alone: the receiver reads ranges 1 cm short on average, which over many shots shows.
    """
    predicted = [
        (log.errors[k], log.covariance[k])
        for log in honest_flights()
        for k in [int(np.searchsorted(log.time_s, at_s))]
    ]
    for rows in (slice(0, 2), slice(3, 6), slice(6, 9)):
        squares = normalised(
            np.array([error[rows] for error, _ in predicted]),
            np.array([covariance[rows, rows] for _, covariance in predicted]),
        )
        least, most = chi2.ppf([0.001, 0.999], len(predicted) * len(range(9)[rows]))
        assert least < squares.sum() < most
    assert abs(np.mean([error[2] for error, _ in predicted])) < 0.02


def test_innovations_are_as_large_as_expected() -> None:
    for column in (0, 1):
        nis = sum(log.nis[:, column].sum() for log in honest_flights())
        accepted = sum(log.accepted[:, column].sum() for log in honest_flights())
        assert accepted > 4000
        least, most = chi2.ppf([0.001, 0.999], accepted) / accepted
        assert least < nis / accepted < most


def test_noise_is_judged_by_parity_and_not_by_outliers() -> None:
    rng = np.random.default_rng(5)
    for sigma, outliers, factor in ((1.0, 0.2, 1.0), (30.0, 0.2, 900.0), (1.0, 0.0, 1.0)):
        factors = []
        for _ in range(50):
            monitor = NoiseMonitor(Rules())
            for k in range(60):
                monitor.add(np.array([1e5 if rng.random() < outliers else sigma * rng.standard_normal()]))
                assert monitor.is_ready == (k >= 19)
            factors.append(monitor.variance_factor)
        assert np.median(factors) == pytest.approx(factor, rel=0.9)
        assert min(factors) >= 1.0


def test_the_estimate_is_given_up_only_against_beams_that_agree() -> None:
    """Twenty shots in a row; beams that contradict each other end the row, beams that cannot count for nothing."""
    agree, contradict, unchecked = np.array([0.1]), np.array([50.0]), np.empty(0)

    def gives_up(*parities: Array, accepted: int = 0) -> bool:
        monitor = NoiseMonitor(CAREFUL)
        return [monitor.detects_divergence(accepted, parity) for parity in parities][-1]

    assert gives_up(*[agree] * 20)
    assert not gives_up(*[agree] * 19)
    assert not gives_up(*[agree] * 21)
    assert not gives_up(*[agree] * 10, contradict, *[agree] * 19)
    assert gives_up(*[agree] * 10, unchecked, *[agree] * 10)
    assert not gives_up(*[agree] * 20, accepted=2)


@pytest.mark.parametrize(
    ("name", "override", "names"),
    [
        ("bench", {}, "bench_pattern"),
        ("live", {}, "trajectory.kind"),
        ("descent", {"mounting": "{pitch_deg: 10}"}, "mounting"),
    ],
)
def test_what_the_example_cannot_fly_is_refused(name: str, override: dict[str, str], names: str) -> None:
    with pytest.raises(InputError, match=names):
        Truth(lidar_emu.load(name, override))


def test_shots_that_are_old_or_yet_to_come_change_nothing() -> None:
    truth = flown()
    run = lidar_emu.simulate(truth.scenario.model_copy(update={"duration_s": 1.0}))
    navigator = start(truth, int(run.time_ns[0, 0]), 1)
    shot = from_run(run, 5, truth.sheet)
    assert navigator.take(shot) is not None
    before = navigator.state.covariance.copy()
    assert navigator.take(shot) is None
    assert navigator.take(shot._replace(time_ns=10**18)) is None
    assert (navigator.state.covariance == before).all()
