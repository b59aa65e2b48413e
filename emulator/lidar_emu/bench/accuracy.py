"""Error and time of every setting of a scenario, relative to level `reference`, by distributions of errors."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.bench.settings import (
    BEAMLETS,
    DEFAULT,
    FAST,
    FINEST,
    REFERENCE,
    DistributionDifference,
    ErrorSpread,
    Setting,
    bias,
    difference,
    light,
    measure,
    median_times_s,
    outcome_noise,
    reseeded,
    rms,
)
from lidar_emu.errors import Finding, InputError
from lidar_emu.receiver.build_level import Level, build_level
from lidar_emu.reference.level import ScattererLevel
from lidar_emu.report.statistics_plots import Mark
from lidar_emu.scenario.load import require_known_flight
from lidar_emu.scenario.schema import FlightScenario

Point = tuple[float, float]
"""Time and error."""


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other point dominates, from fast to slow.

    Points with NaN are beaten by any; of equal points the first is on the front.
    """
    known = [i for i, (time, error) in enumerate(points) if time == time and error == error]
    front: list[int] = []
    for i in sorted(known, key=lambda i: points[i]):
        if not front or points[i][1] < points[front[-1]][1]:
            front.append(i)
    return front


def cheapest(
    times: Sequence[float], errors: Sequence[Sequence[float]], targets: Sequence[float]
) -> int | None:
    """Index of the fastest whose errors are all at most their targets; None if there is none."""
    able = [i for i, found in enumerate(errors) if all(map(operator.le, found, targets))]
    return min(able, key=lambda i: times[i], default=None)


_TIMED_SHOTS = 16
_TIMED_ROUNDS = 9
_SHOTS_PER_REFERENCE = 4

Progress = Callable[[str], None]


@dataclass(frozen=True)
class SettingResult:
    """Time of a setting and its error relative to the reference."""

    setting: Setting
    front_s: float
    """Time per beam measurement for beams, ground and echoes."""
    receiver_s: float
    """Time per beam measurement from echoes to range and speed."""
    spread: ErrorSpread
    """Errors against the ground truth."""
    error: DistributionDifference
    """Errors relative to the reference, whose own are 0."""

    @property
    def time_s(self) -> float:
        """Total time per beam measurement."""
        return self.front_s + self.receiver_s


@dataclass(frozen=True)
class AccuracyReport:
    """The comparison of all settings."""

    scenario: str
    shots: int
    reference_shots: int
    floor: DistributionDifference
    """Sampling noise: the difference between two runs of the reference with different seeds."""
    results: list[SettingResult]

    def times_faster(self, result: SettingResult) -> float:
        """Time of a beam measurement of the reference, which is the last result, over the time of a setting's."""
        return self.results[-1].time_s / result.time_s

    def resolved_error(self, result: SettingResult) -> DistributionDifference:
        """A setting's error, at least the sampling noise."""
        error, floor = result.error, self.floor
        if result.setting == REFERENCE:
            return error
        return DistributionDifference(*map(max, astuple(error), astuple(floor)))

    @property
    def front(self) -> list[int]:
        """Indices of the Pareto front of time and range error, fastest first."""
        return pareto_front([(result.time_s, self.resolved_error(result).range_m) for result in self.results])

    def cheapest(self, target: DistributionDifference) -> SettingResult | None:
        """The fastest setting whose errors are at most these; None if there is none."""
        errors = [astuple(self.resolved_error(result)) for result in self.results]
        chosen = cheapest([result.time_s for result in self.results], errors, astuple(target))
        return None if chosen is None else self.results[chosen]


def measure_accuracy(scenario: FlightScenario, shots: int, progress: Progress) -> AccuracyReport:
    """Compare all settings over `shots` shots spread over the flight.

    Raises:
        InputError: the trajectory is live, level reference does not support the instrument, the instrument has no
            speckle, or no first beam hits the ground.
    """
    require_known_flight(scenario)
    if not scenario.instrument.optics.speckle:
        remedy = "must be true: the scatterers of the reference cause speckle"
        raise InputError(scenario.name, "instrument.optics.speckle", False, remedy)
    flight = Flight(scenario)
    shot = _spaced(flight.shot_count, shots)
    runs = max(1, shots // flight.shot_count)
    seen = _seen(scenario, flight, shot)
    progress("spreads of errors")
    spreads = {setting: measure(setting, scenario, flight, shot, runs) for setting in FAST}
    few = _spaced(flight.shot_count, max(1, shots // _SHOTS_PER_REFERENCE))
    few_runs = max(1, shots // _SHOTS_PER_REFERENCE // flight.shot_count)
    reference, again = (
        measure(REFERENCE, each, flight, few, few_runs, partial(_note_shot, progress, name))
        for name, each in (("the reference", scenario), ("its noise", reseeded(scenario, few_runs)))
    )
    # Sampling noise between two distributions of one setting; for outcomes at least by their binomial variance.
    between = difference(again, reference)
    floor = replace(between, outcome=max(between.outcome, outcome_noise(again, reference)))
    spreads[REFERENCE] = reference
    progress("times")
    fronts, receivers = _fast_times_s(scenario, flight, seen)
    receivers[REFERENCE] = _reference_time_s(scenario, flight, seen)
    results = [
        SettingResult(
            setting, fronts[setting.beamlets], receivers[setting], spread, difference(spread, reference)
        )
        for setting, spread in spreads.items()
    ]
    return AccuracyReport(scenario.name, len(shot) * runs, len(few) * few_runs, floor, results)


def _note_shot(progress: Progress, name: str, done: int, shots: int) -> None:
    progress(f"{name}: {done} of {shots} shots")


def _spaced(available: int, count: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, available - 1, min(count, available)).astype(np.int64))


def _seen(scenario: FlightScenario, flight: Flight, shot: NDArray[np.int64]) -> NDArray[np.int64]:
    echoes = light(scenario, flight, 1, shot)
    seen = echoes.fired[:, 0] & np.isfinite(echoes.range_m[:, 0, 0])
    if not seen.any():
        found = Finding("the first beam never hits the ground")
        raise InputError(scenario.name, None, found, "point it at the ground")
    return shot[seen]


def _fast_times_s(
    scenario: FlightScenario, flight: Flight, shot: NDArray[np.int64]
) -> tuple[dict[int, float], dict[Setting, float]]:
    """Time per beam measurement: up to the echoes by number of beamlets, and of the receiver by setting."""
    shot = shot[_spaced(len(shot), _TIMED_SHOTS)]
    echoes = {count: light(scenario, flight, count, shot) for count in BEAMLETS}
    levels: dict[Setting, Level] = {setting: build_level(setting.of(scenario)) for setting in FAST}
    jobs = [partial(light, scenario, flight, count, shot) for count in BEAMLETS]
    receivers = [partial(levels[setting], echoes[setting.beamlets], shot) for setting in FAST]
    times_s = np.array(median_times_s([*jobs, *receivers], _TIMED_ROUNDS))
    times_s /= echoes[1].fired.sum()
    return (
        dict(zip(BEAMLETS, times_s[: len(jobs)].tolist(), strict=True)),
        dict(zip(FAST, times_s[len(jobs) :].tolist(), strict=True)),
    )


def _reference_time_s(scenario: FlightScenario, flight: Flight, shot: NDArray[np.int64]) -> float:
    """Time per beam measurement of the reference, with the casting of its scatterers."""
    one = shot[len(shot) // 2 : len(shot) // 2 + 1]
    pointing, _ = flight.point(one, flight.scanner.initial)
    level = ScattererLevel(REFERENCE.of(scenario), flight)
    job = partial(level.measure, pointing, flight.cast(pointing), one)
    return median_times_s([job], _TIMED_ROUNDS)[0] / int(pointing.fired.sum())


def document(report: AccuracyReport) -> dict[str, Any]:
    """The report as JSON; None where there is no value."""
    front = set(report.front)
    return {
        "scenario": report.scenario,
        "shots": report.shots,
        "reference": REFERENCE.name,
        "reference_shots": report.reference_shots,
        "floor": asdict(report.floor),
        "settings": [_row(report, result, i in front) for i, result in enumerate(report.results)],
    }


def _row(report: AccuracyReport, result: SettingResult, on_front: bool) -> dict[str, Any]:
    spread, error = result.spread, result.error
    values = {
        "time_s": result.time_s,
        "front_s": result.front_s,
        "receiver_s": result.receiver_s,
        "faster_than_reference": report.times_faster(result),
        "range_bias_m": bias(spread.range_m),
        "range_rms_m": rms(spread.range_m),
        "speed_bias_mps": bias(spread.speed_mps),
        "speed_rms_mps": rms(spread.speed_mps),
        "dropout": spread.dropout,
        "false_lock": spread.false_lock,
        "range_error_m": error.range_m,
        "speed_error_mps": error.speed_mps,
        "outcome_error": error.outcome,
    }
    return {
        "name": result.setting.name,
        **asdict(result.setting),
        **{name: float(value) if math.isfinite(value) else None for name, value in values.items()},
        "pareto": on_front,
    }


def marks(report: AccuracyReport) -> list[list[Mark]]:
    """Points of the plot, for range, speed and outcome; errors below the sampling noise are shown at its level."""
    errors = [astuple(report.resolved_error(result)) for result in report.results]
    return [_marks(report, list(column)) for column in zip(*errors, strict=True)]


def _marks(report: AccuracyReport, errors: list[float]) -> list[Mark]:
    front = set(pareto_front([(r.time_s, error) for r, error in zip(report.results, errors, strict=True)]))
    found = []
    for i, (result, error) in enumerate(zip(report.results, errors, strict=True)):
        setting = result.setting
        family = label = ""
        if setting.level == "spectral":
            family = " without skip rules" if setting.exact else " with skip rules"
            label = str(setting.beamlets) if setting.beamlets in (DEFAULT.beamlets, FINEST) else ""
        if math.isfinite(error):
            found.append(
                Mark(setting.level + family, label, result.time_s, error, i in front, setting == DEFAULT)
            )
    return found
