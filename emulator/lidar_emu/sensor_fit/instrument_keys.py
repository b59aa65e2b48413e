"""Keys of an instrument that behaves as the sensor of a log, by simulated flights.

Approximate Bayesian computation: keys are drawn by a Sobol sequence between physical bounds, each instrument is flown,
and the figures of its flight are taken as those of the log. The summaries of a flight are the keys that a regression on
its figures states (Fearnhead and Prangle, J. R. Statist. Soc. B 74, 419, 2012); the flights with the nearest ones are
moved to the log's by local regressions (Beaumont, Zhang and Balding, Genetics 162, 2025, 2002).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.sensor_fit.flight_log import FlightLog
from lidar_emu.sensor_fit.noise_law import LEVEL, Interval
from lidar_emu.sensor_fit.reference import Errors, errors_of
from lidar_emu.sensor_fit.validation import Characterised
from lidar_emu.shots.model import build_model, measure_whole

FLIGHTS, CHECKING_FLIGHTS = 512, 40
PEAKS = ("bin", "parabola", "jacobsen", "hann", "aboutanios_mulgrew")
_RANGE_BINS, _LEAST_VALUES = 4, 20
_NEAREST_SHARE, _RIDGE = 0.25, 0.03
_TELLS_PEAK = 0.5
_TELLS_NOTHING = 0.75
"""Width of an interval, in parts of the prior's, from which on the log does not tell."""


class FreeKey(NamedTuple):
    """A key that is drawn, and its bounds; evenly by its logarithm, or from 0 on evenly by its value."""

    key: str
    low: float
    high: float

    def value(self, part: FloatArray) -> FloatArray:
        """Values at parts (...) of the way from the lower to the upper bound."""
        if self.low == 0.0:
            return part * self.high
        return np.asarray(self.low * (self.high / self.low) ** part)


class Problem(NamedTuple):
    """What is flown, and how its measurements become a log like the one that is fitted."""

    flown: FlightScenario
    keys: tuple[FreeKey, ...]
    peaks: tuple[str, ...]
    edges_m: FloatArray
    steps: tuple[float, float]
    """Steps of range and speed in the log; NaN: none."""
    limits_mps: tuple[float, float]
    has_truth: bool
    block_s: float


class KeyEstimate(NamedTuple):
    """A key with its 90 % interval."""

    key: str
    estimate: Interval
    tells: bool
    """Whether the log narrows the interval that was searched."""


class FittedKeys(NamedTuple):
    """Keys of the instrument, and how well it matches the half of the log that was held out."""

    problem: Problem
    estimates: list[KeyEstimate]
    peak_shares: dict[str, float]
    """Probability of each peak method."""
    inside: int
    figures: int
    """Figures of the held-out half, and how many are inside the 90 % band of flights by the fitted keys."""
    beyond: int
    """Figures of the fitted half that no flight shows, which are left out."""


def free_keys(instrument: Instrument) -> tuple[FreeKey, ...]:
    """The drawn keys. The last two are noise that is white and stands for all that no key gives."""
    power_w, optics = instrument.optics.laser_power_w, instrument.optics
    mode_rad = instrument.waveform.wavelength_m / (np.pi * optics.waist_radius_m)
    return (
        FreeKey("instrument.waveform.linewidth_hz", 100.0, 3e4),
        FreeKey("instrument.detection.false_alarm_probability", 1e-6, 0.1),
        FreeKey("instrument.optics.laser_power_w", 0.01 * power_w, 10.0 * power_w),
        FreeKey("instrument.optics.alignment_error_rad", 0.0, 2.0 * mode_rad),
        FreeKey("noise.range_m", 1e-3, 1.0),
        FreeKey("noise.closing_speed_mps", 1e-4, 1.0),
    )


def problem_of(log: FlightLog, sensor: Characterised, flown: FlightScenario, block_s: float) -> Problem:
    """The problem of a log: bins of range by the scenario's flight, steps and limits by the log."""
    found = {row.what: row.estimate for row in sensor.rows if row.beam is None}
    steps = found["range step"].value, found["speed step"].value
    low, high = found["lowest speed"], found["highest speed"]
    limits_mps = low.value if low.is_known else -np.inf, high.value if high.is_known else np.inf
    noise = [[each.noise.sigma.value for each in sensor.noise_bins[what]] for what in ("range", "speed")]
    peaks: tuple[str, ...] = PEAKS
    changes: dict[str, float] = {}
    if not np.isfinite(steps).all():
        # Bins would show as steps.
        peaks = PEAKS[1:]
    elif all(values and min(values) < step for values, step in zip(noise, steps, strict=True)):
        peaks, changes = PEAKS[:1], _bins_by_steps(flown.instrument, steps)
    flown = flown.with_(changes)
    true_m = measure_whole(build_model(flown)).truth.range_m
    edges_m = np.nanquantile(true_m, np.linspace(0, 1, _RANGE_BINS + 1)) * (1 + 1e-9)
    edges_m[0] = 0.0
    keys = free_keys(flown.instrument)
    return Problem(flown, keys, peaks, edges_m, steps, limits_mps, log.has_truth, block_s)


def _bins_by_steps(instrument: Instrument, steps: tuple[float, float]) -> dict[str, float]:
    """Keys of the waveform whose bins are the steps of the published detector."""
    waveform = instrument.waveform
    bin_hz = 2.0 * steps[1] / waveform.wavelength_m
    slope_hz_per_s = SPEED_OF_LIGHT_MPS * bin_hz / (2.0 * steps[0])
    return {
        "instrument.waveform.sample_rate_hz": float(f"{bin_hz * waveform.fft_length:.6g}"),
        "instrument.waveform.chirp_slope_hz_per_s": float(f"{slope_hz_per_s:.6g}"),
    }


def changes_of(problem: Problem, parts: FloatArray, peak: str) -> dict[str, Any]:
    """Changed keys of the scenario for parts (keys,) of the bounds."""
    values = {key.key: float(key.value(part)) for key, part in zip(problem.keys, parts, strict=True)}
    noise = {key.partition(".")[2]: values.pop(key) for key in list(values) if key.startswith("noise.")}
    return values | {
        "instrument.detection.peak": peak,
        "faults": [*problem.flown.faults, {"kind": "noise", **noise}],
    }


def as_logged(measured: Measurement, problem: Problem) -> FlightLog:
    """A simulated flight as the log has it: by its steps, and with truth if it has truth."""
    nothing = np.full(measured.range_m.shape, np.nan)

    def logged(value: FloatArray, valid: BoolArray, step: float) -> FloatArray:
        rounded = np.rint(value / step) * step if np.isfinite(step) else value
        return np.where(valid, rounded, np.nan)

    shot_s = (measured.time_ns - measured.time_ns.min()) * 1e-9
    range_m = logged(measured.range_m, measured.range_valid, problem.steps[0])
    speed_mps = logged(measured.closing_speed_mps, measured.speed_valid, problem.steps[1])
    truth = measured.truth.range_m, measured.truth.closing_speed_mps
    true_m, true_mps = truth if problem.has_truth else (nothing, nothing)
    return FlightLog("simulated", shot_s, range_m, speed_mps, measured.snr_db, true_m, true_mps)


def figures(log: FlightLog, errors: Errors, used: BoolArray, problem: Problem) -> FloatArray:
    """(figures,) By range: half-widths of noise, shares of values and of false locks, signal-to-noise ratio."""
    found = []
    # The model has no limits of speed: what the log does beyond its own says nothing of the keys.
    lowest_mps, highest_mps = problem.limits_mps
    within = ~((errors.speed.reference <= lowest_mps) | (errors.speed.reference >= highest_mps))
    values = (log.range_m, errors.range, used), (log.closing_speed_mps, errors.speed, used & within)
    for low_m, high_m in pairwise(problem.edges_m):
        in_bin = (errors.range.reference >= low_m) & (errors.range.reference < high_m)
        for value, quantity, wanted in values:
            inside = in_bin & wanted
            known = np.abs(quantity.residual[inside & np.isfinite(quantity.residual)])
            half = np.quantile(known, (0.5, 0.95)) if len(known) >= _LEAST_VALUES else np.full(2, np.nan)
            found += [*np.log(np.maximum(half, 1e-6))]
            found += [_log_odds(hit, inside) for hit in (np.isfinite(value), quantity.is_false)]
        snr_db = log.snr_db[in_bin & used & np.isfinite(log.snr_db)]
        found.append(np.median(snr_db) if len(snr_db) else np.nan)
    # Shares of all shots need no reference, which flights of many dropouts lack.
    return np.array([*found, *(_log_odds(np.isfinite(value), wanted) for value, _, wanted in values)])


def _log_odds(hit: BoolArray, inside: BoolArray) -> float:
    hits, of = np.count_nonzero(hit & inside), np.count_nonzero(inside)
    return float(np.log((hits + 0.5) / (of - hits + 0.5))) if of else np.nan


def fly(problem: Problem, parts: FloatArray, peak: str, seed: int) -> tuple[FloatArray, FloatArray]:
    """Figures of the fitted and of the held-out half of a flight by parts (keys,) of the bounds."""
    flown = problem.flown.with_(changes_of(problem, parts, peak), seed=seed)
    return halves(as_logged(measure_whole(build_model(flown)), problem), problem)


def halves(log: FlightLog, problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Figures of the fitted and of the held-out half of a log."""
    errors = errors_of(log, problem.block_s)
    fitted, held_out = (
        figures(log, errors, used, problem) for used in (~errors.is_held_out, errors.is_held_out)
    )
    return fitted, held_out


class Flights(NamedTuple):
    """Flights of drawn keys."""

    parts: FloatArray
    """(flights, keys) Parts of the bounds."""
    peak: IntArray
    """(flights,) Number of the peak method."""
    figures: FloatArray
    """(flights, figures) Of the fitted half."""


def fly_design(problem: Problem, count: int, seed: int, progress: Callable[[int], object]) -> Flights:
    """Fly `count` instruments, a power of two, drawn by a Sobol sequence."""
    from scipy.stats import qmc

    drawn = qmc.Sobol(len(problem.keys) + 1, seed=generator(seed, 1)).random(count)
    seeds = generator(seed, 2).integers(2**31, size=count)
    parts, peak = drawn[:, :-1], (drawn[:, -1] * len(problem.peaks)).astype(np.int64)
    found = []
    for k in range(count):
        found.append(fly(problem, parts[k], problem.peaks[peak[k]], int(seeds[k]))[0])
        progress(k + 1)
    return Flights(parts, peak, np.array(found))


class Posterior(NamedTuple):
    """Accepted flights, moved to the log's figures, with weights (accepted,) of sum 1."""

    parts: FloatArray
    peak: IntArray
    weight: FloatArray


def reached(flights: Flights, observed: FloatArray) -> BoolArray:
    """(figures,) Whether most flights have the figure, and the log's is within what they show.

    A regression does not hold beyond; what the model cannot show says nothing of its keys.
    """
    common = np.isfinite(flights.figures).mean(axis=0) > 0.5
    lowest, highest = np.full((2, len(observed)), np.nan)
    lowest[common] = np.nanmin(flights.figures[:, common], axis=0)
    highest[common] = np.nanmax(flights.figures[:, common], axis=0)
    return np.asarray((observed >= lowest) & (observed <= highest))


def posterior_of(flights: Flights, observed: FloatArray) -> Posterior:
    """Keys of a log by its figures (figures,)."""
    said = reached(flights, observed)
    of_flights = flights.figures[:, said]
    of_flights = np.where(np.isfinite(of_flights), of_flights, np.nanmedian(of_flights, axis=0))
    centre, spread = of_flights.mean(axis=0), np.maximum(of_flights.std(axis=0), 1e-9)
    part = flights.parts.clip(1e-6, 1 - 1e-6)
    odds = np.log(part / (1 - part))
    target = np.concatenate([odds, np.eye(flights.peak.max() + 1)[flights.peak]], axis=1)
    target -= target.mean(axis=0)
    # Linear: squares of figures that contradict each other, as a model's may, would extrapolate far.
    rows, of_log = (of_flights - centre) / spread, (observed[said] - centre) / spread
    gram = np.linalg.inv(rows.T @ rows + _RIDGE * len(rows) * np.eye(rows.shape[1]))
    solved, leverage = gram @ rows.T @ target, np.einsum("ni,ij,nj->n", rows, gram, rows)
    # Each flight is predicted by the others, as the log is.
    off = (target - rows @ solved) / (1 - leverage)[:, None]
    away = (target - off - of_log @ solved) / off.std(axis=0).clip(1e-9)
    distance = np.linalg.norm(away, axis=1)
    nearest = np.argsort(distance)[: max(int(_NEAREST_SHARE * len(distance)), 4 * target.shape[1])]
    weight = 1.0 - (distance[nearest] / (distance[nearest].max() * (1 + 1e-9))) ** 2
    # Each key along its own summary: a plane through all of them would be extrapolated to a log at the edge.
    near, moved = away[nearest, : odds.shape[1]], odds[nearest]
    centred = near - weight @ near / weight.sum()
    moved = moved - near * (weight @ (centred * moved) / np.maximum(weight @ centred**2, 1e-300))
    return Posterior(1 / (1 + np.exp(-moved)), flights.peak[nearest], weight / weight.sum())


def estimates_of(problem: Problem, posterior: Posterior) -> list[KeyEstimate]:
    """Medians and 90 % intervals of the keys."""
    found = []
    for key, parts in zip(problem.keys, posterior.parts.T, strict=True):
        order = np.argsort(parts)
        at = np.cumsum(posterior.weight[order]) - 0.5 * posterior.weight[order]
        middle, low, high = np.interp((0.5, (1 - LEVEL) / 2, (1 + LEVEL) / 2), at, parts[order])
        estimate = Interval(*(float(key.value(part)) for part in (middle, low, high)))
        found.append(KeyEstimate(key.key, estimate, bool(high - low < _TELLS_NOTHING * LEVEL)))
    return found


def fit_keys(
    log: FlightLog, problem: Problem, seed: int, count: int, progress: Callable[[int], object]
) -> FittedKeys:
    """Fit the keys to one half of a log, and predict the other half by further flights.

    Args:
        log: the log.
        problem: see `problem_of`.
        seed: of the drawn keys and of all flights.
        count: flights by drawn keys, a power of two; `CHECKING_FLIGHTS` follow.
        progress: called with the number of flights that are done.
    """
    fitted, held_out = halves(log, problem)
    flights = fly_design(problem, count, seed, progress)
    posterior = posterior_of(flights, fitted)
    rng = generator(seed, 3)
    expected = []
    for k, at in enumerate(rng.choice(len(posterior.weight), size=CHECKING_FLIGHTS, p=posterior.weight)):
        peak = problem.peaks[posterior.peak[at]]
        expected.append(fly(problem, posterior.parts[at], peak, int(rng.integers(2**31)))[1])
        progress(count + k + 1)
    table = np.array(expected)
    said = np.isfinite(held_out) & np.isfinite(table).all(axis=0)
    low, high = np.quantile(table[:, said], ((1 - LEVEL) / 2, (1 + LEVEL) / 2), axis=0)
    shares = np.bincount(posterior.peak, posterior.weight, len(problem.peaks))
    of_model = np.isfinite(flights.figures).any(axis=0) & np.isfinite(fitted)
    return FittedKeys(
        problem, estimates_of(problem, posterior), dict(zip(problem.peaks, map(float, shares), strict=True)),
        int(np.count_nonzero((held_out[said] >= low) & (held_out[said] <= high))), int(said.sum()),
        int(np.count_nonzero(of_model & ~reached(flights, fitted))),
    )  # fmt: skip


def key_text(found: KeyEstimate) -> str:
    """An estimate with its interval, or that the log cannot say."""
    value, low, high = (f"{each:.3g}" for each in found.estimate)
    text = f"{value} ({low} to {high})"
    return text if found.tells else f"{text}: the log cannot say, this is what was searched"


def instrument_text(fitted: FittedKeys, name: str, source: str) -> str:
    """Text of an instrument's file with the fitted keys, and their 90 % intervals as comments.

    Args:
        fitted: the keys.
        name: name of the instrument.
        source: one line on the log and the flights.
    """
    tree = fitted.problem.flown.instrument.model_dump(mode="json", exclude_defaults=True) | {"name": name}
    peak, share = max(fitted.peak_shares.items(), key=lambda item: item[1])
    comments = {("detection", "peak"): f"probability {share:.2f}"}
    if share < _TELLS_PEAK:
        peak = fitted.problem.flown.instrument.detection.peak
        comments["detection", "peak"] = "as in the scenario: the log cannot say"
    tree.setdefault("detection", {})["peak"] = peak
    noise = {}
    for each in fitted.estimates:
        first, section, key = (*each.key.split("."), "")[:3]
        if first == "noise":
            noise[section] = each
            continue
        tree.setdefault(section, {})[key] = float(f"{each.estimate.value:.4g}")
        comments[section, key] = key_text(each).partition(" ")[2]
    fault = ", ".join(f"{key}: {each.estimate.value:.3g}" for key, each in noise.items())
    lines = [
        f"# {source}",
        "# In parentheses 90 % intervals. Of the half that was not used, "
        f"{fitted.inside} of {fitted.figures} figures are inside the 90 % band",
        f"# of flights with these keys; {fitted.beyond} figures of the used half are beyond all flights, and left out.",
        f"# Noise that no key gives, for the scenario: faults: [{{kind: noise, {fault}}}]",
        *(f"#   {key}: {key_text(each)}" for key, each in noise.items()),
        *_steps_and_limits(fitted.problem),
        f"name: {json.dumps(name)}",
    ]
    for section, keys in tree.items():
        if section == "name":
            continue
        lines.append(f"{section}:")
        for key, value in keys.items():
            comment = comments.get((section, key))
            lines.append(f"  {key}: {json.dumps(value)}" + (f"  # {comment}" if comment else ""))
    return "\n".join(lines) + "\n"


def _steps_and_limits(problem: Problem) -> list[str]:
    lines = []
    if np.isfinite(problem.steps).all() and len(problem.peaks) > 1:
        steps = "{:.6g} m and {:.6g} m/s".format(*problem.steps)
        lines.append(f"# Steps of {steps} are finer than the noise: of packets, not of bins.")
    if limits := [f"{each:.6g} m/s" for each in problem.limits_mps if np.isfinite(each)]:
        lines.append(f"# Speeds in the log end at {' and '.join(limits)}; the model has no key for this.")
    return lines
