"""Whole descents: order, events, stiff valves against scipy, what lies between the steps, and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from lander import RIGID, Floats, descent
from scipy.integrate import solve_ivp

from lidar_emu.beams.flight import build_trajectory
from lidar_emu.errors import InputError
from lidar_emu.trajectory.powered.control import attitude_torque, specific_thrust_at, throttle
from lidar_emu.trajectory.powered.dynamics import SIZE, gravity_at, inertia_at, lowest_foot_m, set_derivative
from lidar_emu.trajectory.powered.integration import LANDED, NOT_LANDED, StepSizes
from lidar_emu.trajectory.powered.solution import Descent, DescentTrajectory, prepare, solve

MOON_M = 1_737_400.0
THRUST, MASS, TORQUE = SIZE, SIZE + 1, slice(SIZE + 2, SIZE + 5)
GRAVITY_TURN = {"kind": "gravity_turn"}


def shortened(flight: Descent, factor: float, longest_s: float | None = None) -> Descent:
    """With all steps shorter by a factor."""
    first, growth, longest, standing = flight.step_sizes
    schedule = flight.schedule if longest_s is None else flight.schedule._replace(longest_s=longest_s)
    return flight._replace(step_sizes=StepSizes(first / factor, growth / factor, longest / factor, standing / factor),
                           schedule=schedule)  # fmt: skip


def at(flight: Descent, time_s: Floats) -> Floats:
    """States at instants that are ends of steps."""
    _, record = solve(flight)
    place = np.searchsorted(record.time_s, time_s - 1e-9)
    np.testing.assert_allclose(record.time_s[place], time_s, atol=1e-9)
    return record.state[place]


def test_error_falls_with_the_fourth_power_of_the_step() -> None:
    lags = {"engine": RIGID["engine"] | {"valve_lag_s": 0.2}, "attitude_control": {"lag_s": 0.2}}
    flight = prepare(descent(lags, control_rate_hz=10, step_s=0.05), MOON_M)
    ticks = np.arange(1, 100) * 0.1
    coarse, middle, fine = (at(shortened(flight, factor, 10.0), ticks)[:, 3:6] for factor in (1, 2, 4))
    ratio = np.abs(coarse - middle).max() / np.abs(middle - fine).max()
    assert 10 < ratio < 26
    assert np.abs(middle - fine).max() > 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [5e-5, 1e-3, 0.02])
def test_stiff_valve_against_an_implicit_solver(lag_s: float) -> None:
    """Radau on thrust, mass and torque as states, begun anew at each tick, as anybody would write it."""
    parts = {"engine": RIGID["engine"] | {"valve_lag_s": lag_s}}
    flight = prepare(descent(parts, control_rate_hz=20), MOON_M)
    ticks = np.arange(1, 13) * 0.05
    theirs = as_anybody(flight, ticks)
    own, finer = (at(shortened(flight, factor, 0.6), ticks) for factor in (1, 4))
    np.testing.assert_allclose(own[:, 3:6], theirs[:, 3:6], rtol=0, atol=2e-8)
    np.testing.assert_allclose(own, theirs, rtol=0, atol=3e-6)
    np.testing.assert_allclose(finer, theirs, rtol=0, atol=2e-8)


def as_anybody(flight: Descent, ticks: Floats) -> Floats:
    body, lags, guide, actuators = flight.body, flight.lags, flight.guide, flight.actuators
    y = np.concatenate([flight.state, [actuators.thrust_n, actuators.mass_kg], actuators.torque_nm])
    states, now_s = [], 0.0
    for tick_s in ticks:
        state = y[:SIZE].copy()
        thrust_mps2 = specific_thrust_at(guide, now_s, gravity_at(body, tuple(state[:3])), state)
        torque = np.array(attitude_torque(guide, inertia_at(body, y[MASS]), thrust_mps2, state))
        thrust = throttle(guide, y[MASS], thrust_mps2, state)

        def slope(_t: float, y: Floats, thrust: float = thrust, torque: Floats = torque) -> Floats:
            derivative = np.empty(SIZE)
            set_derivative(body, y[MASS], y[THRUST], tuple(y[TORQUE]), y[:SIZE].copy(), derivative)
            valve = (thrust - y[THRUST]) / lags.valve_s
            return np.concatenate(
                [derivative, [valve, -y[THRUST] / lags.exhaust_mps], (torque - y[TORQUE]) / lags.torque_s]
            )

        y = solve_ivp(slope, (now_s, tick_s), y, method="Radau", rtol=1e-10, atol=1e-11).y[:, -1]
        states.append(y[:SIZE])
        now_s = tick_s
    return np.array(states)


def test_events_lie_where_they_happen_whatever_the_step() -> None:
    flight = prepare(descent(cut_off_height_m=0.7), MOON_M)
    coarse, record = solve(flight)
    fine, _ = solve(shortened(flight, 4))
    assert coarse.status == LANDED
    assert coarse.cut_off_s == pytest.approx(fine.cut_off_s, abs=1e-7)
    assert coarse.touchdown_s == pytest.approx(fine.touchdown_s, abs=1e-7)
    cut_off = int(np.flatnonzero(record.time_s == coarse.cut_off_s)[0])
    assert lowest_foot_m(flight.body, record.state[cut_off]) == pytest.approx(0.7, abs=1e-12)
    assert lowest_foot_m(flight.body, record.state[-1]) == pytest.approx(0.0, abs=1e-12)
    off_grid = coarse.touchdown_s / 0.01
    assert abs(off_grid - round(off_grid)) > 1e-3
    # Free fall from one to the other, but for what the valve lets through after it.
    fall_s = coarse.touchdown_s - coarse.cut_off_s
    assert record.mass_and_thrust[-1, 1] == pytest.approx(
        record.mass_and_thrust[cut_off, 1] * np.exp(-fall_s / 0.02), rel=1e-9
    )


def test_engine_may_burn_until_the_feet_touch() -> None:
    outcome, record = solve(prepare(descent(cut_off_height_m=0), MOON_M))
    assert outcome.cut_off_s == outcome.touchdown_s == record.time_s[-1]
    assert record.state[-1, 5] == pytest.approx(-1.5, abs=0.02)


def test_polynomial_lands_on_its_target_upright_and_slow() -> None:
    target = {"east_m": 40, "north_m": -25, "up_m": 7}
    flight = build_trajectory(descent(target=target, heading_deg=30), MOON_M)
    end = flight.state(np.array([flight.duration_s]))
    assert end.position_site_m[0, :2] == pytest.approx([40, -25], abs=0.1)
    assert end.position_site_m[0, 2] == pytest.approx(7 + 1.2, abs=1e-2)
    assert end.velocity_site_mps[0, 2] == pytest.approx(-np.sqrt(1.5**2 + 2 * 1.62 * 0.5), abs=0.05)
    assert end.site_from_body[0, 2, 2] < -0.9999
    assert end.site_from_body[0, :2, 0] == pytest.approx([0.5, np.sqrt(0.75)], abs=1e-2)


def test_gravity_turn_pushes_against_the_velocity_and_comes_to_rest() -> None:
    flight = DescentTrajectory(descent(guidance=GRAVITY_TURN, maximum_tilt_deg=80), MOON_M)
    time_s = np.linspace(8, 20, 20)
    state = flight.state(time_s)
    backward = -state.velocity_site_mps / np.linalg.norm(state.velocity_site_mps, axis=1)[:, None]
    up = -state.site_from_body[:, :, 2]
    assert np.sum(up * backward, axis=1).min() > np.cos(np.radians(6))
    end = flight.state(np.array([flight.duration_s]))
    assert abs(end.velocity_site_mps[0, 1]) < 0.05
    assert flight.outcome.status == LANDED


@pytest.mark.slow
def test_between_the_steps_as_exact_as_the_steps() -> None:
    """At instants of no step, against the flight integrated in steps sixteen times as short."""
    part = descent({"engine": RIGID["engine"] | {"valve_lag_s": 5e-5}})
    flight = build_trajectory(part, MOON_M)
    fine, record = solve(shortened(prepare(part, MOON_M), 16))
    chosen = np.arange(100, fine.steps, 997)
    state = flight.state(record.time_s[chosen])
    np.testing.assert_allclose(state.position_site_m, record.state[chosen, :3], atol=1e-8)
    np.testing.assert_allclose(state.velocity_site_mps, record.state[chosen, 3:6], atol=1e-8)
    np.testing.assert_allclose(state.body_rate_radps, record.state[chosen, 10:13], atol=1e-7)
    np.testing.assert_allclose(state.acceleration_site_mps2, record.start[chosen, 7:10], atol=1e-4)
    middle_s = (record.time_s[chosen] + record.time_s[chosen + 1]) / 2
    step_s = np.diff(record.time_s)[chosen, None]
    by_difference = (record.state[chosen + 1, 10:13] - record.state[chosen, 10:13]) / step_s
    found = flight.state(middle_s).angular_acceleration_body_radps2
    np.testing.assert_allclose(found, by_difference, atol=1e-4)
    assert np.abs(found).max() > 0.01


def test_velocity_belongs_to_the_positions_and_an_instant_to_itself() -> None:
    flight = build_trajectory(descent(), MOON_M)
    time_s = np.random.default_rng(5).uniform(0.1, flight.duration_s - 0.1, 300)
    step_s = 1e-4
    ahead, behind = flight.state(time_s + step_s), flight.state(time_s - step_s)
    slope = (ahead.position_site_m - behind.position_site_m) / (2 * step_s)
    whole = flight.state(time_s)
    np.testing.assert_allclose(slope, whole.velocity_site_mps, atol=1e-6)
    for k in (0, 17, 299):
        one = flight.state(time_s[k : k + 1])
        for together, alone in zip(whole, one, strict=True):
            assert np.array_equal(together[k], alone[0])


def test_stands_on_its_feet_after_touchdown() -> None:
    flight = build_trajectory(descent(after_touchdown_s=15), MOON_M)
    end = flight.state(np.array([flight.duration_s - 5, flight.duration_s, flight.duration_s + 1e-3]))
    assert np.abs(end.velocity_site_mps).max() < 0.01
    assert np.abs(end.velocity_site_mps[0]).max() < 0.05
    # gravity on what is left of 1500 kg, on four springs of 40 kN/m
    assert np.all((end.position_site_m[:, 2] > 1.2 - 0.02) & (end.position_site_m[:, 2] < 1.2 - 0.008))
    assert end.site_from_body[-1, 2, 2] < -0.999


def test_attitude_and_spin_at_the_start_are_the_scenarios() -> None:
    attitude = {"yaw_deg": 90, "body_rate_radps": [0.1, -0.05, 0.2]}
    start = {"position_site_m": [0, 0, 500], "velocity_site_mps": [0, 0, -20], "attitude": attitude}
    state = build_trajectory(descent(start=start), MOON_M).state(np.array([0.0]))
    np.testing.assert_allclose(state.site_from_body[0], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-15)
    np.testing.assert_allclose(state.body_rate_radps[0], [0.1, -0.05, 0.2], atol=1e-15)


def test_fast_attitude_control_shortens_the_steps() -> None:
    assert prepare(descent(), MOON_M).step_sizes.longest_s == 0.01
    fast = descent({"attitude_control": {"bandwidth_radps": 40}})
    assert prepare(fast, MOON_M).step_sizes.longest_s == pytest.approx(0.2 / 40)


def test_a_spin_at_the_start_is_followed_and_taken_out() -> None:
    """5 rad/s about an axis between the principal ones: steps of 0.2 rad / 5 rad/s do, and lose no length."""
    spin = {"attitude": {"body_rate_radps": [3.0, -2.5, 3.1]}, "position_site_m": [0, 0, 900]}
    start = spin | {"velocity_site_mps": [0, 0, -20]}
    flight = prepare(descent(start=start, step_s=0.1), MOON_M)
    assert flight.step_sizes.longest_s == pytest.approx(0.2 / np.linalg.norm([3.0, -2.5, 3.1]))
    outcome, record = solve(flight)
    assert outcome.status == LANDED
    np.testing.assert_allclose(np.sum(record.state[:, 6:10] ** 2, axis=1), 1, atol=1e-5)
    assert np.abs(record.state[-1, 10:13]).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "keys", "line"),
    [
        ({"dry_mass_kg": 1490}, {}, r"trajectory: vehicle.dry_mass_kg: out of propellant .*; shorten the flight"),
        ({"engine": {"maximum_thrust_n": 9000, "minimum_thrust_n": 8000}}, {}, "not on the ground|out of propellant"),
        ({}, {"longest_s": 10.0}, r"trajectory: longest_s: not on the ground after 10.00 s; raise it"),
        ({"gear": {"damping_spm": 1e9}}, {"after_touchdown_s": 1}, "step_s: motion no longer finite after"),
        ({"gear": {"stiffness_npm": 1e12}}, {"after_touchdown_s": 60}, "step_s: 500000 steps after"),
        ({}, {"step_s": 1e-5}, "step_s: 500000 steps after"),
    ],
    ids=["dry", "cannot sink", "never lands", "not finite", "crawling", "too many steps"],
)  # fmt: skip
def test_refuses_in_one_line(vehicle: dict[str, Any], keys: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError, match=line) as refused:
        build_trajectory(descent(vehicle, **keys), MOON_M)
    assert "\n" not in str(refused.value)


def test_without_curvature_gravity_is_uniform() -> None:
    outcome, _ = solve(shortened(prepare(descent()), 1, 5.0))
    assert outcome.status == NOT_LANDED
    flat = prepare(descent()).body
    assert gravity_at(flat, (1e5, 2e5, 3e5)) == (-0.0, -0.0, -1.62)
