"""The settings that the benchmark compares, and a scenario with each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.receiver.build_level import Level, build_level
from lidar_emu.receiver.echoes import compute_echoes
from lidar_emu.receiver.returns import Echoes, Returns
from lidar_emu.reference.level import ScattererLevel
from lidar_emu.runtime.clock import Clock
from lidar_emu.scenario.schema import FlightScenario

_SHARES = np.arange(0.01, 0.995, 0.01)
"""Quantiles 1 % to 99 %: tails beyond them are not resolved by a thousand measurements."""


_FALSE_LOCK_BINS = 10.0
"""A valid measurement further than this from every beamlet of the footprint is a false lock. Motion between the
segments biases a range by a bin at 12 m/s² with the default instrument; noise peaks lie anywhere."""


@dataclass(frozen=True)
class ErrorSpread:
    """Errors against the truth of the beams that fired and whose axis meets the ground."""

    range_m: FloatArray
    """(99,) Quantiles of the correct locks; NaN where there are none."""
    speed_mps: FloatArray
    """(99,)"""
    dropout: float
    """Fraction without a valid range."""
    false_lock: float
    """Fraction with a valid range that is not the range of the surface."""
    count: int


@dataclass(frozen=True)
class DistributionDifference:
    """Differences of two distributions of errors."""

    range_m: float
    """Root mean square difference of the quantiles."""
    speed_mps: float
    outcome: float
    """Total variation distance of the shares of correct locks, false locks and dropouts."""


def false_locks(returns: Returns, echoes: Echoes, range_bin_m: float, speed_bin_mps: float) -> BoolArray:
    """(shots, beams) Whether a valid measurement lies ten bins or more outside its beamlets' ranges or speeds."""
    far: BoolArray = np.zeros(returns.range_valid.shape, dtype=bool)
    for found, beamlets, bin_width in (
        (returns.range_m, echoes.range_m, range_bin_m),
        (returns.closing_speed_mps, echoes.closing_speed_mps, speed_bin_mps),
    ):
        lowest = np.where(np.isnan(beamlets), np.inf, beamlets).min(axis=-1)
        highest = np.where(np.isnan(beamlets), -np.inf, beamlets).max(axis=-1)
        far |= np.maximum(lowest - found, found - highest) > _FALSE_LOCK_BINS * bin_width
    return returns.range_valid & far


def spread(
    range_error_m: FloatArray, speed_error_mps: FloatArray, false_lock: BoolArray, expected: BoolArray
) -> ErrorSpread:
    """Distribution of errors (shots, beams), NaN where invalid.

    Args:
        range_error_m, speed_error_mps: errors against the truth.
        false_lock: where a valid measurement is not of the surface; its errors are excluded from the quantiles.
        expected: where a measurement was possible.
    """
    count = int(expected.sum())
    valid, false = np.isfinite(range_error_m), false_lock & expected
    correct = valid & expected & ~false
    return ErrorSpread(
        _quantiles(range_error_m[correct]),
        _quantiles(speed_error_mps[correct]),
        float(1.0 - valid[expected].mean()) if count else np.nan,
        float(false.sum() / count) if count else np.nan,
        count,
    )


def _quantiles(error: FloatArray) -> FloatArray:
    known = error[np.isfinite(error)]
    return np.quantile(known, _SHARES) if known.size else np.full(_SHARES.size, np.nan)


def bias(quantiles: FloatArray) -> float:
    """Mean of the central 98 %."""
    return float(quantiles.mean())


def rms(quantiles: FloatArray) -> float:
    """Root mean square of the central 98 %."""
    return float(np.sqrt(np.mean(quantiles**2)))


def difference(one: ErrorSpread, other: ErrorSpread) -> DistributionDifference:
    """Difference of two distributions: for range and speed the 2-Wasserstein distance of the central 98 %."""
    dropout, false_lock = one.dropout - other.dropout, one.false_lock - other.false_lock
    return DistributionDifference(
        rms(one.range_m - other.range_m),
        rms(one.speed_mps - other.speed_mps),
        0.5 * (abs(dropout) + abs(false_lock) + abs(dropout + false_lock)),
    )


def outcome_noise(one: ErrorSpread, other: ErrorSpread) -> float:
    """Standard deviation of a difference of shares by sampling: the largest for dropouts, false locks, and both."""
    # After Laplace: an outcome that was never seen in n is not impossible.
    count = max(one.count, 1)
    shares = [
        (0.5 * count * share + 1.0) / (count + 2.0)
        for share in (one.dropout + other.dropout, one.false_lock + other.false_lock)
    ]
    variance = max(2.0 * share * (1.0 - share) for share in (*shares, min(sum(shares), 1.0)))
    return float((variance / count) ** 0.5)


BEAMLETS = (1, 7, 19, 37, 61, 127)
FINEST = BEAMLETS[-1]

LevelName = Literal["geometric", "spectral", "reference"]


@dataclass(frozen=True)
class Setting:
    """A level with its number of beamlets and skip rules."""

    level: LevelName
    beamlets: int
    exact: bool = True
    """Nothing is left out by the skip rules; other levels than `spectral` have none that matter."""

    @property
    def name(self) -> str:
        """Name in tables and plots."""
        if self.level == "reference":
            return "scatterers"
        if self.level == "geometric":
            return self.level
        skips = ", skips" if not self.exact else ""
        return f"{self.level} {self.beamlets}{skips}"

    def of(self, scenario: FlightScenario) -> FlightScenario:
        """The scenario at this setting."""
        share = 0.0 if self.exact else scenario.left_out_share
        return scenario.model_copy(update={"level": self.level, "left_out_share": share})


FAST = (
    Setting("geometric", 1),
    *(Setting("spectral", count, exact=False) for count in BEAMLETS),
    *(Setting("spectral", count) for count in BEAMLETS),
)
DEFAULT = Setting("spectral", 19, exact=False)
REFERENCE = Setting("reference", FINEST)


def light(scenario: FlightScenario, flight: Flight, beamlets: int, shot: NDArray[np.int64]) -> Echoes:
    """Echoes of shots anywhere in the flight, in ascending order."""
    pointing, _ = flight.point(shot, flight.scanner.initial)
    hits = flight.cast(pointing)
    return compute_echoes(scenario.instrument, scenario.site, flight, beamlets, pointing, hits)


def measure(
    setting: Setting,
    scenario: FlightScenario,
    flight: Flight,
    shot: NDArray[np.int64],
    runs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> ErrorSpread:
    """Errors of shots at a setting, against the truth along the beams' axes.

    Args:
        runs: number of runs, each with the next seed.
        progress: takes the number of shots measured and of all, after each shot of the reference.
    """
    slow = setting == REFERENCE
    blocks = np.array_split(shot, len(shot)) if slow else [shot]
    parts: list[tuple[FloatArray, FloatArray, BoolArray, BoolArray]] = []
    for run in range(runs):
        seeded = reseeded(setting.of(scenario), run)
        level = ScattererLevel(seeded, flight) if slow else build_level(seeded)
        for block in blocks:
            parts.append(_measure_block(setting, scenario, flight, level, block))
            if progress is not None:
                progress(len(parts), runs * len(blocks))
    return spread(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _measure_block(
    setting: Setting,
    scenario: FlightScenario,
    flight: Flight,
    level: ScattererLevel | Level,
    shot: NDArray[np.int64],
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Arguments of `spread`."""
    pointing, _ = flight.point(shot, flight.scanner.initial)
    hits = flight.cast(pointing)
    echoes = compute_echoes(scenario.instrument, scenario.site, flight, setting.beamlets, pointing, hits)
    returns = (
        level.measure(pointing, hits, shot) if isinstance(level, ScattererLevel) else level(echoes, shot)
    )
    true_mps = dot(pointing.sensor_velocity_site_mps, pointing.true_site)
    waveform = scenario.instrument.waveform
    return (
        returns.range_m - hits.range_m,
        returns.closing_speed_mps - true_mps,
        false_locks(returns, echoes, waveform.range_bin_m, waveform.speed_bin_mps),
        pointing.fired & np.isfinite(hits.range_m),
    )


def reseeded(scenario: FlightScenario, by: int) -> FlightScenario:
    """The same scenario with a later seed."""
    return scenario.model_copy(update={"seed": (scenario.seed + by) % 2**63})


def median_times_s(jobs: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Median of `rounds` times of each job, all jobs once in each round; each is called once beforehand."""
    clock = Clock()
    for job in jobs:
        job()
    times = np.empty((rounds, len(jobs)))
    for row in times:
        for i, job in enumerate(jobs):
            start_ns = clock.now_ns()
            job()
            row[i] = (clock.now_ns() - start_ns) * 1e-9
    return [float(time) for time in np.median(times, axis=0)]
