"""Tables of docs/evidence/accuracy.md on haze and on a plume's dust as targets: the reference beside the fast levels.

Shares of measurements that are right (range and closing speed within ten bins of the truth), valid but wrong, and
invalid, of a single beam: at 15 degrees through haze onto the level ground of `mars`, sinking at 5 m/s; and 8 m over
level ground, sinking at 1 m/s, through the dust of `dusty_landing.yaml` except for the keys of the scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import cos, radians
from typing import NamedTuple, Protocol

import numpy as np

import lidar_emu
from benchmarks.scenes import FAST_LEVELS, REFERENCE, scanner, trajectory
from benchmarks.tables import TABLES
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.load import load

RATE_HZ = 50.0
SHOTS_PER_RUN = 20
"""The speckle of each shot is new: shots are at least 2 cm apart."""
FLOWN_S = SHOTS_PER_RUN / RATE_HZ
FAST_TIMES = TABLES["haze"].fast_times
HAZE_DOWN_MPS, HAZE_TILT_DEG = 5.0, 15.0
PLUME_HEIGHT_M, PLUME_DOWN_MPS = 8.0, 1.0
LEVELS = {"reference": REFERENCE, **FAST_LEVELS}


class Scene(Protocol):
    """A scene of a table."""

    def settings(self) -> dict[str, str]:
        """Keys of a scenario that flies the scene."""


class Haze(NamedTuple):
    """A beam through haze onto the ground."""

    range_m: float
    backscatter_per_m_sr: float
    extinction_per_m: float
    updraft_mps: float = 0.0

    def __str__(self) -> str:
        wind = f", updraft {self.updraft_mps:g} m/s" if self.updraft_mps else ""
        return f"{self.range_m:g} m, {self.backscatter_per_m_sr:g}, {self.extinction_per_m:g}{wind}"

    def settings(self) -> dict[str, str]:
        altitude_m = self.range_m * cos(radians(HAZE_TILT_DEG))
        atmosphere = (
            f"{{extinction_per_m: {self.extinction_per_m}, backscatter_per_m_sr: {self.backscatter_per_m_sr}, "
            f"wind_mps: [0, 0, {self.updraft_mps}]}}"
        )
        return {
            "timing.rate_hz": str(RATE_HZ),
            "duration_s": str(FLOWN_S),
            "site": f"{{base: mars, atmosphere: {atmosphere}}}",
            "scanner": scanner(HAZE_TILT_DEG),
            "trajectory": trajectory(altitude_m, 0.51 * HAZE_DOWN_MPS * FLOWN_S, HAZE_DOWN_MPS),
        }


class Dust(NamedTuple):
    """A beam onto dust."""

    tilt_deg: float
    optical_depth: float
    streak_optical_depth: float = 0.0
    """Optical depth of a streak in each beam; 0: no streak."""

    def __str__(self) -> str:
        streak = f", streaks of {self.streak_optical_depth:g}" if self.streak_optical_depth else ""
        return f"{self.tilt_deg:g}\N{DEGREE SIGN}, depth {self.optical_depth:g}{streak}"

    def settings(self) -> dict[str, str]:
        streaks = (
            f"streak_share: {float(self.streak_optical_depth > 0.0)}, "
            f"streak_optical_depth: {self.streak_optical_depth}"
        )
        return {
            "timing.rate_hz": str(RATE_HZ),
            "duration_s": str(FLOWN_S),
            "site": "flat",
            "scanner": scanner(self.tilt_deg),
            "trajectory": trajectory(PLUME_HEIGHT_M, 0.51 * PLUME_DOWN_MPS * FLOWN_S, PLUME_DOWN_MPS),
            "plume": f"{{optical_depth: {self.optical_depth}, {streaks}}}",
        }


SCENES: dict[str, tuple[Scene, ...]] = {
    "haze": (
        Haze(200.0, 3e-4, 1e-2),
        Haze(100.0, 1e-3, 2e-2),
        Haze(1500.0, 3e-5, 1e-3),
        Haze(200.0, 1e-7, 1e-5),
        Haze(200.0, 1e-5, 1e-3, 10.0),
    ),
    "plume": (Dust(22.5, 1.5), Dust(22.5, 0.5, 2.0), Dust(0.2, 1.0)),
}


def shares(scene: Scene, level: str, shots: int) -> FloatArray:
    """Shares (3,) of measurements that are right, valid but wrong, and invalid."""
    scenario = load("descent", scene.settings() | LEVELS[level])
    waveform = scenario.instrument.waveform
    valid, right = [], []
    for seed in range(1, 1 + -(-shots // SHOTS_PER_RUN)):
        run = lidar_emu.simulate(scenario, seed=seed)
        near = np.abs(run.range_m - run.true_range_m) < 10.0 * waveform.range_bin_m
        near &= np.abs(run.closing_speed_mps - run.true_closing_speed_mps) < 10.0 * waveform.speed_bin_mps
        valid.append(run.range_valid)
        right.append(run.range_valid & near)
    good, any_valid = float(np.mean(right)), float(np.mean(valid))
    return np.array([good, any_valid - good, 1.0 - any_valid])


def apart(reference: FloatArray, shots: int, fast: FloatArray) -> float:
    """Largest difference of three shares in Monte Carlo errors, of both together; 1 measurement at least."""
    pooled = (reference + FAST_TIMES * fast) / (1.0 + FAST_TIMES)
    variance = np.maximum(pooled * (1.0 - pooled), 1.0 / shots) * (1.0 / shots + 1.0 / (FAST_TIMES * shots))
    return float(np.max(np.abs(fast - reference) / np.sqrt(variance)))


def parts(shots: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table on haze."""
    return _rows("range, β, α", SCENES["haze"], shots)


def plume_parts(shots: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table on dust."""
    return _rows("beam off nadir, dust", SCENES["plume"], shots)


def _rows(heading: str, scenes: Iterable[Scene], shots: int) -> Iterator[tuple[str, ...]]:
    yield heading, *LEVELS, f"{', '.join(FAST_LEVELS)}: errors apart"
    for scene in scenes:
        reference, *fast = (
            shares(scene, level, shots if level == "reference" else FAST_TIMES * shots) for level in LEVELS
        )
        cells = [" / ".join(f"{share:.3f}" for share in found) for found in (reference, *fast)]
        yield str(scene), *cells, ", ".join(f"{apart(reference, shots, found):.1f}" for found in fast)
