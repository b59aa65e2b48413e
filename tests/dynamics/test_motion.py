"""Equations of motion: what is conserved, and closed forms of spin and gravity."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from lander import EXHAUST_MPS, NONE, at_rest, body, coast, sums
from scipy.spatial.transform import Rotation

from lidar_emu.trajectory.powered.dynamics import (
    SIZE,
    ActuatorState,
    Lags,
    mass_after,
    thrust_after,
    torque_after,
)
from lidar_emu.trajectory.powered.integration import StepSizes, next_step_s, runge_kutta_step, set_slope

TUMBLING = Rotation.from_rotvec([0.4, -1.1, 0.7])


def test_free_motion_conserves_momenta_energy_and_lengths() -> None:
    state = at_rest(TUMBLING)
    state[3:6], state[10:13] = (3.0, -2.0, 1.0), (0.6, -0.4, 0.5)
    path = coast(body(), state, 20.0, 10_000)
    total = sums(body(), path)
    np.testing.assert_allclose(total.energy, total.energy[0], rtol=1e-8)
    for conserved in (total.momentum, total.angular_momentum):
        np.testing.assert_allclose(
            conserved,
            np.broadcast_to(conserved[0], conserved.shape),
            rtol=0,
            atol=1e-8 * np.abs(conserved).max(),
        )
    np.testing.assert_allclose(np.sum(path[:, 6:10] ** 2, axis=1), 1, atol=1e-10)
    # and something has moved at all
    assert np.ptp(path[:, 10]) > 0.1


def test_spin_of_an_axisymmetric_body() -> None:
    """The transverse rate turns about the axis at (J3 - J1) / J1 times the spin (Euler)."""
    top = body(inertia_kgm2=[1000, 1000, 1600])
    state = at_rest()
    state[10:13] = 0.3, 0.0, 2.0
    path = coast(top, state, 10.0, 2000)
    angle = 0.6 * 2.0 * np.linspace(0, 10, 2001)
    np.testing.assert_allclose(path[:, 10], 0.3 * np.cos(angle), atol=2e-9)
    np.testing.assert_allclose(path[:, 11], 0.3 * np.sin(angle), atol=2e-9)


def test_gravity_keeps_the_energy_of_an_orbit() -> None:
    radius_m = 1_737_400.0
    orbiting = body(gravity_mps2=1.62, radius_m=radius_m)
    state = at_rest()
    state[2], state[4] = 15_000.0, 1700.0
    path = coast(orbiting, state, 600.0, 600)
    distance_m = np.sqrt(path[:, 0] ** 2 + path[:, 1] ** 2 + (radius_m + path[:, 2]) ** 2)
    energy = np.sum(path[:, 3:6] ** 2, axis=1) / 2 - 1.62 * radius_m**2 / distance_m
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)
    assert np.ptp(distance_m) > 100


@pytest.mark.parametrize("lag_s", [0.0, 5e-5, 1e-3, 0.3])
def test_rocket_equation(lag_s: float) -> None:
    """Speed gained in free space is the exhaust's times the logarithm of the masses, whatever the valve does."""
    free, lags = body(), Lags(lag_s, 0.0, EXHAUST_MPS)
    actuators = ActuatorState(500.0, 1500.0, NONE, 5000.0, NONE)
    step_sizes = StepSizes(min(0.01, lag_s / 4) if lag_s else 0.01, 0.5, 0.01, 0.01)
    state, stepped, slopes = at_rest(), np.empty(SIZE), np.empty((4, SIZE))
    since_s = 0.0
    while since_s < 20.0:
        step_s = next_step_s(step_sizes, step_sizes.longest_s, since_s, 20.0 - since_s)
        set_slope(free, lags, actuators, since_s, state, slopes[0])
        runge_kutta_step(free, lags, actuators, since_s, step_s, state, slopes, stepped)
        state, since_s = stepped.copy(), since_s + step_s
    gained = EXHAUST_MPS * np.log(1500.0 / mass_after(actuators, lags, since_s))
    np.testing.assert_allclose(state[3:6], [0, 0, -gained], atol=1e-7)
    assert gained > 60


def test_actuators_solve_their_differential_equation() -> None:
    lags = Lags(0.03, 0.05, EXHAUST_MPS)
    actuators = ActuatorState(1000.0, 1200.0, (5.0, 0.0, -7.0), 4000.0, (-50.0, 20.0, 0.0))
    time_s, step_s = 0.04, 1e-5

    def around(of: Callable[..., Any]) -> tuple[Any, Any]:
        ahead, behind = (np.array(of(actuators, lags, time_s + sign * step_s)) for sign in (1, -1))
        return (ahead - behind) / (2 * step_s), np.array(of(actuators, lags, time_s))

    slope, thrust = around(thrust_after)
    assert slope == pytest.approx((4000 - thrust) / 0.03, rel=1e-6)
    slope, _ = around(mass_after)
    assert slope == pytest.approx(-thrust / EXHAUST_MPS, rel=1e-6)
    slope, torque = around(torque_after)
    np.testing.assert_allclose(slope, (np.array([-50.0, 20.0, 0.0]) - torque) / 0.05, rtol=1e-6)
    assert (thrust_after(actuators, lags, 0.0), mass_after(actuators, lags, 0.0)) == (1000.0, 1200.0)


def test_feet_give_back_no_more_than_they_took() -> None:
    """Dropped askew: energy with the springs' never rises, and the vehicle comes to rest at its weight's depth."""
    gear = {"stiffness_npm": 40_000, "damping_spm": 0.8, "friction": 0.4}
    standing = body(gravity_mps2=1.62, ground_m=0.0, gear=gear)
    state = at_rest(Rotation.from_rotvec([np.pi, 0, 0]) * Rotation.from_rotvec([0.05, 0.03, 0]))
    state[2], state[3], state[5] = 1.6, 0.3, -1.2
    path = coast(standing, state, 12.0, 6000)
    turn = Rotation.from_quat(np.roll(path[:, 6:10], -1, axis=1))
    depth = np.stack([np.maximum(0, -path[:, 2] - turn.apply(foot)[:, 2]) for foot in standing.feet_m])
    energy = sums(standing, path).energy + 1500 * 1.62 * path[:, 2] + 20_000 * np.sum(depth**2, axis=0)
    assert np.diff(energy).max() < 1e-3
    assert energy[-1] < energy[0] - 1000
    np.testing.assert_allclose(depth[:, -1], 1500 * 1.62 / 4 / 40_000, rtol=0.02)
    assert np.abs(path[-1, 3:6]).max() < 5e-3


def test_feet_without_friction_and_damping_give_back_all() -> None:
    gear = {"stiffness_npm": 40_000, "damping_spm": 0.0, "friction": 0.0}
    bouncing = body(gravity_mps2=1.62, ground_m=0.0, gear=gear)
    state = at_rest(Rotation.from_rotvec([np.pi, 0, 0]))
    state[2] = 2.0
    path = coast(bouncing, state, 6.0, 6000)
    tops = path[1:-1, 2][(path[1:-1, 2] > path[:-2, 2]) & (path[1:-1, 2] > path[2:, 2])]
    np.testing.assert_allclose(tops, 2.0, atol=1e-4)
    assert len(tops) >= 2
