"""Update the table of docs/accuracy.md on speckle that changes within a record: the reference beside the fast levels.

python tools/speckle_table.py              rewrites the table between the two markers; twenty minutes
python tools/speckle_table.py --print      prints it
python tools/speckle_table.py --shots 300  with fewer measurements than 1000

A single beam over level ground, sub-bin peaks, zero linewidth, a flat receiver and an ideal digitiser. The figures are
robust standard deviations (1.4826 times the median distance from the median) of the valid measurements' errors against
the truth.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, degrees, hypot
from typing import Any, NamedTuple

import numpy as np
from page_table import update

import lidar_emu
from lidar_emu.scenario.load import load

RATE_HZ = 100.0
HEADINGS = "scene", "reference", "within, %", "spectral, 127 beamlets, exact", "spectral, default"
FAST_RUNS = 4
"""Runs of the fast levels, each with as many measurements as the reference and another seed."""


class Scene(NamedTuple):
    """A steady flight over level ground."""

    altitude_m: float
    sideways_mps: float
    down_mps: float
    tilt_deg: float
    """Angle of the beam off nadir, forward."""

    def __str__(self) -> str:
        sideways = f", {self.sideways_mps:g} m/s sideways" if self.sideways_mps else ""
        return f"{self.altitude_m:g} m{sideways}, {self.down_mps:g} m/s down, {self.tilt_deg:g}°"

    def settings(self, shots: int) -> dict[str, str]:
        """Keys of a scenario that flies the scene, sinking through its altitude."""
        speed_mps = hypot(self.sideways_mps, self.down_mps)
        half_m = 0.505 * self.down_mps * shots / RATE_HZ
        # A descent that would sink too far is flown at a higher rate.
        rate_hz = min(1000.0, RATE_HZ * max(1.0, half_m / (0.02 * self.altitude_m)))
        half_m *= RATE_HZ / rate_hz
        waypoints = ", ".join(
            f"{{altitude_m: {self.altitude_m + side * half_m}, speed_mps: {speed_mps}}}" for side in (1, -1)
        )
        path_deg = degrees(atan2(self.down_mps, self.sideways_mps))
        return {
            "timing.rate_hz": str(rate_hz),
            "duration_s": str(shots / rate_hz),
            "instrument": "{base: ndl_fine, waveform: {linewidth_hz: 0}, "
            "receiver: {adc: null, bandwidth_hz: null, ac_coupling_hz: 0}}",
            "site": "{base: flat, surface: {reflectance: 0.18, lommel_seeliger_share: 1}}",
            "scanner": f"{{pattern: {{kind: directions, beams: [[{self.tilt_deg}, 0]]}}}}",
            "trajectory": f"{{kind: profile, path_angle_deg: {path_deg}, waypoints: [{waypoints}]}}",
        }


SCENES = (
    Scene(300.0, 40.0, 2.0, 0.0),
    Scene(100.0, 20.0, 2.0, 7.5),
    Scene(50.0, 10.0, 2.0, 22.5),
    Scene(500.0, 0.0, 30.0, 22.5),
    Scene(2000.0, 0.0, 100.0, 22.5),
)
REFERENCE = {"level": "waveform", "waveform_echo": "scatterers_narrowband"}
FAST: tuple[dict[str, str], ...] = ({"exact": "true", "instrument.optics.beamlets": "127"}, {})


def deviations(scene: Scene, shots: int, level: dict[str, str], runs: int = 1) -> tuple[float, float, float]:
    """Robust standard deviations of range in mm and speed in mm/s, and the relative Monte Carlo error of either."""
    scenario = load("descent", scene.settings(shots) | level)
    range_mm, speed_mm = [], []
    for seed in range(1, 1 + runs):
        run = lidar_emu.simulate(scenario, seed=seed)
        valid = run.range_valid
        range_mm.append(1e3 * (run.range_m - run.true_range_m)[valid])
        speed_mm.append(1e3 * (run.closing_speed_mps - run.true_closing_speed_mps)[valid])
    ranges_mm = np.concatenate(range_mm)
    return _robust(ranges_mm), _robust(np.concatenate(speed_mm)), _relative_error(ranges_mm)


def _robust(values: Any) -> float:
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


def _relative_error(values: Any) -> float:
    """Standard deviation of the robust deviation by bootstrap, relative to it."""
    rng = np.random.default_rng(1)
    resampled = [_robust(rng.choice(values, len(values))) for _ in range(200)]
    return float(np.std(resampled) / _robust(values))


def rows(shots: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table, with range in mm and speed in mm/s."""
    for scene in SCENES:
        *reference, within = deviations(scene, shots, REFERENCE)
        fast = [deviations(scene, shots, level, FAST_RUNS)[:2] for level in FAST]
        cells = [f"{range_mm:.2g} / {speed_mm:.2g}" for range_mm, speed_mm in (reference, *fast)]
        yield str(scene), cells[0], f"{100 * within:.0f}", *cells[1:]


if __name__ == "__main__":
    update("speckle", HEADINGS, rows, 1000, FAST_RUNS)
