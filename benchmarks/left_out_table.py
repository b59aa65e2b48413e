"""Table of docs/evidence/accuracy.md on what is left out: the default beside the reference in random scenes.

A single scene is known to a tenth or two, so that the scenes are pooled: each against as many measurements of the
default, several times, whose scatter is the Monte Carlo error. A scene more than four errors away is measured again
with four times as many.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np

import lidar_emu
from benchmarks.scenes import REFERENCE, scanner, trajectory
from benchmarks.tables import TABLES
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.load import load

SCENES = 200
HEADINGS = (
    "receiver", "ground", "altitude", "scenes", "range scatter, default / reference", "bias / sigma",
    "speed scatter, default / reference", "bias / sigma", "right, default - reference, %",
    "beyond 2, 3 errors, %",
)  # fmt: skip
REPEATS = TABLES["left out"].fast_times
"""Measurements of the default for each of the reference."""

IDEAL = "{adc: null, bandwidth_hz: null, ac_coupling_hz: 0}"
NEAR_M = 3.4
"""Range errors of correct locks: ten bins."""

FAR_M = 300.0
_MOST_ERRORS, _AGAIN = 4.0, 4
_BEAMS, _MOST_SHOTS_HZ = 2, 1100.0


class Scene(NamedTuple):
    """Two beams over smooth or rough ground, near or far, slow or fast, rounded to bins or not."""

    altitude_m: float
    speed_mps: float
    path_deg: float
    tilt_deg: float
    linewidth_hz: float
    receiver: str
    quantised: bool
    smooth: bool

    @classmethod
    def draw(cls, seed: int) -> Scene:
        """Draw a scene."""
        rng = np.random.default_rng(seed)
        altitude_m, speed_mps = 10 ** rng.uniform(1.5, 3.4), 10 ** rng.uniform(0.0, 2.0)
        path_deg, tilt_deg = rng.choice([0.5, 3.0, 10.0]), rng.uniform(0.0, 25.0)
        linewidth_hz, receiver = rng.choice([0, 3000]), rng.choice(["{}", IDEAL])
        quantised = rng.choice(["ndl_four_beam", "ndl_fine"]) == "ndl_four_beam"
        smooth = bool(rng.integers(2) == 0)
        return cls(
            altitude_m, speed_mps, float(path_deg), tilt_deg, linewidth_hz, str(receiver), quantised, smooth
        )

    @property
    def half_m(self) -> float:
        """Half of the way down."""
        return min(0.05 * self.altitude_m, 2.0)

    @property
    def flown_s(self) -> float:
        """Duration of the measurements. A tenth of the flight is left for the rounding of its length."""
        return 0.9 * 2.0 * self.half_m / (self.speed_mps * float(np.sin(np.radians(self.path_deg))))

    def settings(self, shots: int) -> dict[str, str]:
        """Keys of a scenario that flies the scene."""
        # Range and speed change by many bins, so that quantised ones are anywhere in theirs.
        path = f"path_angle_deg: {self.path_deg}"
        base = "ndl_four_beam" if self.quantised else "ndl_fine"
        return {
            "timing.rate_hz": str(shots / self.flown_s),
            "duration_s": str(self.flown_s),
            "instrument": f"{{base: {base}, waveform: {{linewidth_hz: {self.linewidth_hz}}}, "
            f"receiver: {self.receiver}}}",
            "site": "{base: flat, surface: {lommel_seeliger_share: 1}}" if self.smooth else "mare",
            "scanner": scanner(self.tilt_deg, 0, 120),
            "trajectory": trajectory(self.altitude_m, self.half_m, self.speed_mps, 0.05, path),
        }


class Errors(NamedTuple):
    """Errors of correct locks."""

    error: FloatArray
    """(2, n) of range in metres and closing speed in metres per second."""
    right: float
    """Share of correct locks."""

    def scatter(self, quantised: bool) -> FloatArray:
        """Scatter of range and speed: root mean squares of quantised errors, robust deviations of others."""
        if quantised:
            return np.asarray(np.sqrt(np.mean(self.error**2, axis=1)))
        middle = np.median(self.error, axis=1, keepdims=True)
        return np.asarray(1.4826 * np.median(np.abs(self.error - middle), axis=1))

    def middle(self, quantised: bool) -> FloatArray:
        """Bias of range and speed."""
        return np.asarray(self.error.mean(axis=1) if quantised else np.median(self.error, axis=1))


class Difference(NamedTuple):
    """Default less reference, each with its Monte Carlo error: (5,) of the logarithms of both scatters, of both biases
    in standard deviations, and of the share of correct locks."""

    value: FloatArray
    error: FloatArray

    @property
    def errors_apart(self) -> FloatArray:
        """Differences in Monte Carlo errors."""
        return np.asarray(self.value / self.error)


def measure(scene: Scene, level: dict[str, str], shots: int, seed: int) -> tuple[Any, Any]:
    """Errors (2, shots, beams) of range and closing speed, and where they are of a correct lock."""
    run = lidar_emu.simulate(load("descent", scene.settings(shots) | level), seed=seed)
    error = np.array([run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps])
    return error, run.range_valid & (np.abs(error[0]) < NEAR_M)


def compare(scene: Scene, seed: int, measurements: int, repeats: int = REPEATS) -> Difference | None:
    """Compare the default with the reference; None where fewer than half of the measurements are right.

    Each scene needs a seed of its own: with the same random numbers the errors of all scenes have the same sign.
    """
    first_seed = seed * (repeats + 1)
    shots = measurements // _BEAMS
    error, right = measure(scene, REFERENCE, shots, first_seed + repeats)
    reference = _errors(error, right)
    at_once = min(repeats, int(_MOST_SHOTS_HZ * scene.flown_s / shots))
    defaults = []
    for k in range(repeats // at_once):
        error, right = measure(scene, {}, shots * at_once, first_seed + k)
        defaults += [_errors(error[:, i::at_once], right[i::at_once]) for i in range(at_once)]
    if min(reference.right, np.mean([each.right for each in defaults])) < 0.5:
        return None
    scatter = [np.log(np.maximum(each.scatter(scene.quantised), 1e-9)) for each in (reference, *defaults)]
    sigma = np.exp(np.mean(scatter, axis=0))
    figures = np.array(
        [
            [*log_scatter, *(each.middle(scene.quantised) / sigma), each.right]
            for log_scatter, each in zip(scatter, (reference, *defaults), strict=True)
        ]
    )
    scatter = figures[1:].std(axis=0, ddof=1) * np.sqrt(1.0 + 1.0 / len(defaults))
    # Errors that are the same in all repeats are known to this, a share in them to one measurement.
    least = np.array([0.01, 0.01, 0.01, 0.01, 0.5 / measurements])
    return Difference(figures[1:].mean(axis=0) - figures[0], np.maximum(scatter, least))


def _errors(error: Any, right: Any) -> Errors:
    return Errors(error[:, right], float(right.mean()))


def differences(measurements: int) -> list[tuple[Scene, Difference]]:
    """Compare all scenes, those far apart once more."""
    compared = []
    for seed in range(SCENES):
        scene = Scene.draw(seed)
        found = compare(scene, seed, measurements)
        if found and (np.abs(found.errors_apart) > _MOST_ERRORS).any():
            print(f"again: {seed} {scene} {np.round(found.errors_apart, 1)}", flush=True)
            found = compare(scene, seed, _AGAIN * measurements, REPEATS // _AGAIN)
            if found:
                print(f"  now {np.round(found.errors_apart, 1)} {np.round(found.value, 3)}", flush=True)
        if found:
            compared.append((scene, found))
    return compared


def parts(measurements: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table: scenes pooled by receiver, ground and altitude, then by receiver alone."""
    yield HEADINGS
    compared = differences(measurements)
    for quantised, smooth, far in product((False, True), (True, False, None), (False, True, None)):
        if (smooth is None) != (far is None):
            continue
        pooled = [
            found
            for scene, found in compared
            if scene.quantised == quantised
            and smooth in (None, scene.smooth)
            and far in (None, scene.altitude_m > FAR_M)
        ]
        names = (
            "quantised" if quantised else "sub-bin",
            "all" if smooth is None else "smooth" if smooth else "rough",
            "all" if far is None else f"{'above' if far else 'below'} {FAR_M:g} m",
        )
        yield *names, str(len(pooled)), *_pooled(pooled)


def _pooled(found: list[Difference]) -> Iterator[str]:
    """Means over scenes with their standard errors, and shares of differences beyond their Monte Carlo errors."""
    values = np.array([each.value for each in found])
    mean, error = values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(found))
    for i in (0, 1):
        ratio = np.exp(mean[i])
        yield f"{ratio:.3f} ± {ratio * error[i]:.3f}"
        yield f"{mean[2 + i]:+.3f} ± {error[2 + i]:.3f}"
    yield f"{100 * mean[4]:+.1f} ± {100 * error[4]:.1f}"
    apart = np.abs([each.errors_apart for each in found])
    yield f"{100 * np.mean(apart > 2.0):.1f}, {100 * np.mean(apart > 3.0):.1f}"
