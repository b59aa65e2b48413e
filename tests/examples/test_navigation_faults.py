"""The shipped fault scenarios: a careful navigator stays within the bounds of docs/navigate.md, others do not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from error_state import VELOCITY
from trials import Log, fly, start
from trust import NAMED
from truth import Truth

import lidar_emu

pytestmark = pytest.mark.slow

LENGTH_S = {"homodyne_sign": "16", "terrain_step_2023": "56", "noisy_descent_2025": "30"}


@cache
def flight(scenario: str, rules: str) -> Log:
    read = lidar_emu.load(scenario, {"duration_s": LENGTH_S[scenario]})
    truth, run = Truth(read), lidar_emu.simulate(read, seed=1)
    return fly(truth, run, start(truth, int(run.time_ns[0, 0]), 1, NAMED[rules]))


def worst(scenario: str, rules: str, from_s: float, to_s: float = np.inf) -> tuple[float, float]:
    """Error of height, m, and of velocity, m/s."""
    log = flight(scenario, rules)
    off = log.errors[(log.time_s >= from_s) & (log.time_s <= to_s)]
    return float(np.abs(off[:, 2]).max()), float(np.linalg.norm(off[:, VELOCITY], axis=1).max())


def test_wrong_signs_of_two_beams_are_refused() -> None:
    """Both flip by 20 m/s and 2 km, for two seconds."""
    height_m, speed_mps = worst("homodyne_sign", "careful", 2)
    assert height_m < 1.5
    assert speed_mps < 0.03
    height_m, speed_mps = worst("homodyne_sign", "credulous", 5)
    assert height_m > 100
    assert speed_mps > 10


def test_ground_that_falls_away_is_believed_in_the_end() -> None:
    """The rim passes below from 26 s on, and from 43 s all beams are on the floor."""
    assert worst("terrain_step_2023", "careful", 2, 20)[0] < 15
    assert worst("terrain_step_2023", "careful", 30, 35)[0] > 500
    height_m, speed_mps = worst("terrain_step_2023", "careful", 53)
    assert height_m < 15
    assert speed_mps < 0.5
    assert worst("terrain_step_2023", "stubborn", 53)[0] > 2000
    assert 1 <= flight("terrain_step_2023", "careful").reinitialised[:, 0].sum() <= 4


def test_noise_that_is_not_admitted_is_found_out() -> None:
    """Eighty metres and two metres a second, where packets state centimetres and tenths of millimetres."""
    height_m, speed_mps = worst("noisy_descent_2025", "careful", 10)
    assert height_m < 15
    assert speed_mps < 1
    height_m, speed_mps = worst("noisy_descent_2025", "stubborn", 10)
    assert height_m > 20
    assert speed_mps > 1.5
    height_m, speed_mps = worst("noisy_descent_2025", "credulous", 10)
    assert height_m > 1000
    assert speed_mps > 10


@pytest.mark.parametrize("scenario", ["homodyne_sign", "terrain_step_2023", "noisy_descent_2025"])
def test_what_is_stated_stays_a_covariance(scenario: str) -> None:
    for covariance in flight(scenario, "careful").covariance[::50]:
        assert np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > 0
