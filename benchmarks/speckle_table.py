"""Table of docs/evidence/accuracy.md that compares the fast levels with the reference, from 20 m to 5 km.

A single beam over level ground. Errors are against the truth, in runs of a few shots, each with a different seed. The
number behind each figure is its difference from the reference over the difference that is allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import atan2, cos, degrees, hypot, pi, radians, sin
from typing import NamedTuple

import numpy as np

import lidar_emu
from benchmarks.scenes import FAST_LEVELS as LEVELS
from benchmarks.scenes import REFERENCE, scanner, trajectory
from benchmarks.tables import TABLES
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.scenario.instrument import Optics, Waveform
from lidar_emu.scenario.load import load

HEADINGS = (
    "scene", "level", "range mm", "speed mm/s", "mean range %", "mean speed %", "valid %", "false %", "correlation",
)  # fmt: skip
FAST_LEVELS: dict[str, dict[str, str]] = {
    "127 beamlets, exact": {"left_out_share": "0", "instrument.optics.beamlets": "127"},
    **{name.replace("spectral", "default"): keys for name, keys in LEVELS.items()},
}
FAST_TIMES = TABLES["speckle"].fast_times
TOLERANCE, MONTE_CARLO_ERRORS = 0.05, 3.0
"""Allowed differences: of deviations, relative to them; of means, over the deviation; of the correlation. Shares are
allowed the Monte Carlo errors alone."""
NEAR_BINS = 10.0
"""Errors of correct locks in bins."""
WAVEFORM, WAIST_M = Waveform(), Optics().waist_radius_m
"""Of all instruments."""

_SHOTS_PER_RUN, _SINK_SHARE = 20, 0.02
"""Most shots of a run, and share of its altitude by which it sinks."""
_APART_M, _FASTEST_HZ = 0.04, 1000.0
"""Way across the beam from shot to shot in which speckle changes, where the rate allows."""
_FADE_SHOTS = 6000
"""Measurements of the correlation of intensity."""

SUB_BIN = (
    "{base: ndl_fine, detection: {peak: hann}, waveform: {linewidth_hz: 0}, "
    "receiver: {adc: null, bandwidth_hz: null, ac_coupling_hz: 0}}"
)
QUANTISED = "{base: ndl_four_beam}"


class Scene(NamedTuple):
    """A steady flight over level ground."""

    altitude_m: float
    sideways_mps: float
    down_mps: float
    tilt_deg: float
    """Angle of the beam off nadir, forward at the start."""
    spin_radps: float = 0.0
    """Rate about the vertical."""
    instrument: str = SUB_BIN

    def __str__(self) -> str:
        sideways = f", {self.sideways_mps:g} m/s sideways" if self.sideways_mps else ""
        spin = f", {self.spin_radps:g} rad/s" if self.spin_radps else ""
        bins = ", quantised" if self.quantised else ""
        return f"{self.altitude_m:g} m{sideways}, {self.down_mps:g} m/s down, {self.tilt_deg:g}°{spin}{bins}"

    @property
    def quantised(self) -> bool:
        """Whether the detector rounds to bins."""
        return self.instrument == QUANTISED

    @property
    def across_mps(self) -> float:
        """Speed across the beam at the start."""
        tilt = radians(self.tilt_deg)
        return abs(self.sideways_mps * cos(tilt) - self.down_mps * sin(tilt))

    def run(self, rate_hz: float, shots: int) -> dict[str, str]:
        """Keys of a scenario that flies the scene, sinking through its altitude."""
        half_m = 0.51 * self.down_mps * shots / rate_hz
        speed_mps = hypot(self.sideways_mps, self.down_mps)
        # A quantised speed is anywhere in its bin.
        slower_mps = 0.02 if self.quantised else 0.0
        more = f"path_angle_deg: {degrees(atan2(self.down_mps, self.sideways_mps))}, "
        more += f"attitude: {{body_rate_radps: [0, 0, {self.spin_radps}]}}"
        return {
            "timing.rate_hz": str(rate_hz),
            "duration_s": str(shots / rate_hz),
            "instrument": self.instrument,
            "site": "{base: flat, surface: {reflectance: 0.18, lommel_seeliger_share: 1}}",
            "scanner": scanner(self.tilt_deg),
            "trajectory": trajectory(self.altitude_m, half_m, speed_mps, slower_mps, more),
        }

    def independent_run(self) -> tuple[dict[str, str], int]:
        """Keys of a run whose shots fade independently, and its shots."""
        rate_hz = min(_FASTEST_HZ, self.across_mps / _APART_M)
        most = int(_SINK_SHARE * self.altitude_m * rate_hz / self.down_mps)
        shots = max(1, min(_SHOTS_PER_RUN, most))
        return self.run(rate_hz, shots), shots


SCENES = (
    Scene(300.0, 40.0, 2.0, 0.0),
    Scene(100.0, 20.0, 2.0, 7.5),
    Scene(50.0, 10.0, 2.0, 22.5),
    Scene(500.0, 0.0, 30.0, 22.5),
    Scene(2000.0, 0.0, 100.0, 22.5),
    Scene(20.0, 0.0, 0.2, 22.5),
    Scene(20.0, 5.0, 1.0, 7.5),
    Scene(300.0, 100.0, 5.0, 0.0),
    Scene(1000.0, 0.0, 0.2, 7.5, 0.2),
    Scene(5000.0, 100.0, 10.0, 7.5),
    Scene(2000.0, 0.0, 20.0, 7.5, 1.0),
    Scene(300.0, 0.0, 5.0, 15.0, 3.0),
    Scene(1000.0, 40.0, 5.0, 22.5, instrument=QUANTISED),
    Scene(5000.0, 0.0, 100.0, 7.5, 0.2, QUANTISED),
)


class Figure(NamedTuple):
    """A statistic with its Monte Carlo error."""

    value: float
    error: float

    def over_allowed(self, reference: Figure, tolerance: float) -> float:
        """Difference from the reference over what is allowed."""
        allowed = tolerance + MONTE_CARLO_ERRORS * hypot(self.error, reference.error)
        return abs(self.value - reference.value) / allowed if allowed > 0.0 else 0.0


class Errors(NamedTuple):
    """Errors of measurements against the truth, (n,)."""

    range_m: FloatArray
    speed_mps: FloatArray
    valid: BoolArray

    @property
    def correct(self) -> BoolArray:
        """Whether a measurement is valid and near the truth."""
        near = np.abs(self.range_m) < NEAR_BINS * WAVEFORM.range_bin_m
        near &= np.abs(self.speed_mps) < NEAR_BINS * WAVEFORM.speed_bin_mps
        return np.asarray(self.valid & near)


class Scores(NamedTuple):
    """Figures of a level in a scene."""

    deviations: tuple[Figure, Figure]
    """Deviations of the errors of correct locks in m and m/s: robust (1.4826 times the median distance from the
    median), or standard deviations of a quantised receiver."""
    means: tuple[Figure, Figure]
    """Means of the middle 80 % of the errors of correct locks over the deviation."""
    valid: Figure
    false: Figure

    def over_allowed(self, reference: Scores) -> Iterator[float]:
        """Differences from the reference over what is allowed, in the order of the table."""
        for mine, other in zip(self.deviations, reference.deviations, strict=True):
            yield mine.over_allowed(other, TOLERANCE * other.value)
        for mine, other in zip(self.means, reference.means, strict=True):
            yield mine.over_allowed(other, TOLERANCE)
        for mine, other in (self.valid, reference.valid), (self.false, reference.false):
            yield mine.over_allowed(other, 0.0)


def measure(scene: Scene, level: dict[str, str], shots: int) -> Errors:
    """Measure a scene at a level."""
    settings, per_run = scene.independent_run()
    scenario = load("descent", settings | level)
    found = []
    for seed in range(1, 1 + -(-shots // per_run)):
        run = lidar_emu.simulate(scenario, seed=seed)
        speed_mps = run.closing_speed_mps - run.true_closing_speed_mps
        found.append(Errors(run.range_m - run.true_range_m, speed_mps, run.range_valid))
    return Errors(*(np.concatenate(column).ravel() for column in zip(*found, strict=True)))


def score(scene: Scene, errors: Errors) -> Scores:
    """Figures of measurements."""
    correct, spread = errors.correct, _standard_deviation if scene.quantised else _robust
    deviations, means = [], []
    for values in (errors.range_m[correct], errors.speed_mps[correct]):
        deviation = _bootstrapped(values, spread)
        mean = _bootstrapped(values, _trimmed_mean)
        deviations.append(deviation)
        means.append(Figure(mean.value / deviation.value, mean.error / deviation.value))
    false = errors.valid & ~correct
    return Scores((deviations[0], deviations[1]), (means[0], means[1]), share(errors.valid), share(false))


def _standard_deviation(values: FloatArray) -> FloatArray:
    return np.asarray(values.std(axis=-1))


def _robust(values: FloatArray) -> FloatArray:
    """Robust standard deviations along the last axis."""
    middle = np.median(values, axis=-1, keepdims=True)
    return np.asarray(1.4826 * np.median(np.abs(values - middle), axis=-1))


def _trimmed_mean(values: FloatArray) -> FloatArray:
    """Means of the middle 80 % along the last axis."""
    count = values.shape[-1]
    ordered = np.sort(values, axis=-1)
    return np.asarray(ordered[..., count // 10 : count - count // 10].mean(axis=-1))


def _bootstrapped(values: FloatArray, statistic: Callable[[FloatArray], FloatArray]) -> Figure:
    """Statistic of values with its error by bootstrap."""
    rng = np.random.default_rng(1)
    resampled = statistic(rng.choice(values, (100, len(values))))
    return Figure(float(statistic(values)), float(np.std(resampled)))


def share(which: BoolArray) -> Figure:
    """Share of measurements; a share of 0 or 1 is uncertain by one measurement."""
    part, count = float(which.mean()), len(which)
    return Figure(part, float(np.sqrt(max(part * (1.0 - part), 1.0 / count) / count)))


def fade_correlation(scene: Scene, level: dict[str, str]) -> tuple[Figure, Figure]:
    """Correlation of intensity from shot to shot, and what exp(-2 D²/w0²) gives for the mean of three records.

    The beam moves by half a waist from shot to shot, or as far as it does at the highest rate.
    """
    rate_hz = min(_FASTEST_HZ, scene.across_mps / (0.5 * WAIST_M))
    per_run = max(2, min(200, int(2 * _SINK_SHARE * scene.altitude_m * rate_hz / scene.down_mps)))
    scenario = load("descent", scene.run(rate_hz, per_run) | level)
    products, squares = [], []
    for seed in range(1, 1 + -(-_FADE_SHOTS // per_run)):
        intensity = np.nan_to_num(10.0 ** (0.1 * lidar_emu.simulate(scenario, seed=seed).snr_db[:, 0]))
        products.append(intensity[1:] * intensity[:-1])
        squares.append(intensity)
    # Moments of all runs: a run may be shorter than a fade.
    every, product = np.concatenate(squares), np.concatenate(products)
    mean, variance = every.mean(), every.var()
    blocks = np.array([each.mean() for each in np.array_split(product, 40)])
    found = Figure(
        float((product.mean() - mean**2) / variance), float(blocks.std() / np.sqrt(40.0) / variance)
    )
    turn_radps = scene.spin_radps * sin(radians(scene.tilt_deg))
    rate2 = (scene.across_mps / WAIST_M) ** 2 + (pi * WAIST_M * turn_radps / WAVEFORM.wavelength_m) ** 2
    between_s = WAVEFORM.segment_time_s * np.subtract.outer(range(3), range(3))
    later, same = (np.exp(-2.0 * rate2 * (between_s + lag_s) ** 2).sum() for lag_s in (1.0 / rate_hz, 0.0))
    return found, Figure(float(later / same), 0.0)


def parts(shots: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table: of each scene the reference, and each fast level."""
    yield HEADINGS
    for scene in SCENES:
        yield from _scene_rows(scene, shots)


def _scene_rows(scene: Scene, shots: int) -> Iterator[tuple[str, ...]]:
    reference = score(scene, measure(scene, REFERENCE, shots))
    yield str(scene), "reference", *_figures(reference), ""
    for name, level in FAST_LEVELS.items():
        scores = score(scene, measure(scene, level, FAST_TIMES * shots))
        found, expected = fade_correlation(scene, level)
        figures = *_figures(scores), f"{found.value:.2f}, {expected.value:.2f}"
        ratios = *scores.over_allowed(reference), found.over_allowed(expected, TOLERANCE)
        yield "", name, *(_judged(*each) for each in zip(figures, ratios, strict=True))


def _figures(scores: Scores) -> tuple[str, ...]:
    ranges, speeds = (1e3 * each.value for each in scores.deviations)
    means = (f"{100 * each.value:+.0f}" for each in scores.means)
    return f"{ranges:.3g}", f"{speeds:.3g}", *means, *(f"{100 * each.value:.1f}" for each in scores[2:])


def _judged(figure: str, over_allowed: float) -> str:
    judged = f"{figure} ({over_allowed:.1f})"
    return f"**{judged}**" if over_allowed > 1.0 else judged
