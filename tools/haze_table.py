"""Update the table of docs/evidence/accuracy.md on haze as a target: the reference beside the fast levels.

python tools/haze_table.py              rewrites the table between the two markers; an hour
python tools/haze_table.py --print      prints it
python tools/haze_table.py --shots 100  with fewer measurements of the reference than 1000

A single beam at 15 degrees, over the level ground of `mars` in haze, sinking at 5 m/s. The figures are the shares of
measurements that are right (range and closing speed within ten bins of the truth), valid but wrong, and invalid.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from math import cos, radians
from typing import NamedTuple, Protocol

import numpy as np
from page_table import update

import lidar_emu
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.load import load

RATE_HZ, DOWN_MPS, TILT_DEG = 50.0, 5.0, 15.0
SHOTS_PER_RUN = 20
"""A tenth of a metre apart: the speckle of each is new, and the height changes by 2 m."""
FAST_TIMES = 10
"""Measurements of the fast levels for each of the reference."""
LEVELS: dict[str, dict[str, str]] = {
    "reference": {"level": "waveform", "waveform_echo": "scatterers_narrowband"},
    "spectral": {},
    "statistical": {"level": "statistical"},
}


class Scene(NamedTuple):
    """A beam through haze onto the ground."""

    range_m: float
    backscatter_per_m_sr: float
    extinction_per_m: float
    updraft_mps: float = 0.0

    def __str__(self) -> str:
        wind = f", updraft {self.updraft_mps:g} m/s" if self.updraft_mps else ""
        return f"{self.range_m:g} m, {self.backscatter_per_m_sr:g}, {self.extinction_per_m:g}{wind}"

    def settings(self) -> dict[str, str]:
        """Keys of a scenario that flies the scene."""
        down_m = self.range_m * cos(radians(TILT_DEG))
        half_m = 0.51 * DOWN_MPS * SHOTS_PER_RUN / RATE_HZ
        waypoints = ", ".join(
            f"{{altitude_m: {down_m + side * half_m}, speed_mps: {DOWN_MPS}}}" for side in (1, -1)
        )
        atmosphere = (
            f"{{extinction_per_m: {self.extinction_per_m}, backscatter_per_m_sr: {self.backscatter_per_m_sr}, "
            f"wind_mps: [0, 0, {self.updraft_mps}]}}"
        )
        return {
            "timing.rate_hz": str(RATE_HZ),
            "duration_s": str(SHOTS_PER_RUN / RATE_HZ),
            "site": f"{{base: mars, atmosphere: {atmosphere}}}",
            "scanner": f"{{pattern: {{kind: directions, beams: [[{TILT_DEG}, 0]]}}}}",
            "trajectory": f"{{kind: profile, waypoints: [{waypoints}]}}",
        }


class FlownScene(Protocol):
    """A scene of a table of shares."""

    def settings(self) -> dict[str, str]:
        """Keys of a scenario that flies the scene."""


SCENES = (
    Scene(200.0, 3e-4, 1e-2),
    Scene(100.0, 1e-3, 2e-2),
    Scene(1500.0, 3e-5, 1e-3),
    Scene(200.0, 1e-7, 1e-5),
    Scene(200.0, 1e-5, 1e-3, 10.0),
)


def shares(scene: FlownScene, level: str, shots: int) -> FloatArray:
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
    """Largest difference of three shares in Monte Carlo errors; a share of 0 or 1 counts as one measurement off it."""
    variance = np.maximum(reference * (1.0 - reference), 1.0 / shots) * (
        1.0 / shots + 1.0 / (FAST_TIMES * shots)
    )
    return float(np.max(np.abs(fast - reference) / np.sqrt(variance)))


def rows(scenes: Iterable[FlownScene], shots: int) -> Iterator[tuple[str, ...]]:
    """Rows of a table."""
    for scene in scenes:
        reference, *fast = (
            shares(scene, level, shots if level == "reference" else FAST_TIMES * shots) for level in LEVELS
        )
        cells = [" / ".join(f"{share:.3f}" for share in found) for found in (reference, *fast)]
        yield str(scene), *cells, ", ".join(f"{apart(reference, shots, found):.1f}" for found in fast)


if __name__ == "__main__":
    headings = "range, β, α", *LEVELS, "spectral, statistical: errors apart"
    update("haze", headings, partial(rows, SCENES), 1000, FAST_TIMES)
