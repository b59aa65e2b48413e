"""Errors of whole flights over their stated sigma, with and without the systematic part.

The systematic part is the mean error that the plan expects of each beam and shot: the motion within a measurement, the
light's travel time and the optical frequencies of the three segments (`plan.expected_error.beam_errors`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lidar_emu import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.plan.expected_error import beam_errors
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario, Scenario
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import measure_whole

FLIGHTS: dict[str, tuple[str, dict[str, str]]] = {
    "descent.yaml": ("descent", {}),
    "descent.yaml, `ndl_fine`": ("descent", {"instrument": "ndl_fine"}),
    "descent.yaml, `ndl_fine`, `compensate: acceleration`": (
        "descent",
        {"instrument": "{base: ndl_fine, detection: {compensate: acceleration}}"},
    ),
    "powered_descent.yaml, `ndl_fine`": ("powered_descent", {"instrument": "ndl_fine"}),
    "paper_fig5.yaml at 20 Hz, `ndl_fine`": (
        "paper_fig5",
        {"instrument": "ndl_fine", "timing.rate_hz": "20"},
    ),
}
_NEAR_M, _NEAR_MPS = 3.4, 0.035
"""Errors of correct locks: ten bins."""


class FlightScores(NamedTuple):
    """Errors over their stated sigma: range, then closing speed, each (2,)."""

    whole: FloatArray
    """Root mean square with the systematic part."""
    systematic: FloatArray
    """Root mean square of the systematic part."""
    root_mean_square: FloatArray
    """Without the systematic part, as what follows."""
    robust: FloatArray
    beyond_two: FloatArray
    beyond_three: FloatArray


class FlownErrors(NamedTuple):
    """A flight, and errors of range and closing speed, (2, shots, beams) each."""

    run: Measurement
    error: FloatArray
    bias: FloatArray
    """The systematic part of the errors."""
    sigma: FloatArray


def fly(scenario: Scenario) -> FlownErrors:
    """Fly once."""
    assert isinstance(scenario, FlightScenario)
    model = FlightModel(scenario)
    run = measure_whole(model)
    expected = beam_errors(scenario, model.flight, model.plan.beamlets, sampled_shots=model.shot_count)
    error = np.array([run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps])
    return FlownErrors(run, error, expected.bias, np.array([run.sigma_range_m, run.sigma_speed_mps]))


def correct_locks(run: Measurement, error: FloatArray) -> BoolArray:
    """Where a range is valid and both errors are below ten bins, (shots, beams)."""
    return np.asarray(run.range_valid & (np.abs(error[0]) < _NEAR_M) & (np.abs(error[1]) < _NEAR_MPS))


def flight_scores(scenario_name: str, settings: dict[str, str]) -> FlightScores:
    """Fly once, and score the correct locks."""
    run, error, bias, sigma = fly(load(scenario_name, settings))
    right = correct_locks(run, error)
    error, sigma, bias = error[:, right], sigma[:, right], bias[:, right]
    score = (error - bias) / sigma
    middle = np.median(score, axis=1, keepdims=True)
    return FlightScores(
        _root_mean_square(error / sigma),
        _root_mean_square(bias / sigma),
        _root_mean_square(score),
        1.4826 * np.median(np.abs(score - middle), axis=1),
        *(np.mean(np.abs(score) > limit, axis=1) for limit in (2.0, 3.0)),
    )


def _root_mean_square(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


def parts() -> Iterator[tuple[str, ...]]:
    """Rows of the table."""
    yield "flight", "", "rms", "systematic part", "rms without it", "robust", "beyond 2, 3 %"
    for name, flight in FLIGHTS.items():
        for quantity, *figures, two, three in zip(("range", "speed"), *flight_scores(*flight), strict=True):
            cells = (f"{figure:.2f}" for figure in figures)
            yield name, quantity, *cells, f"{100 * two:.1f}, {100 * three:.1f}"
