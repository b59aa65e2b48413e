"""Laws by others beside the emulator's scenes of benchmarks/published: speckle, detection, estimates, phase noise.

What the rows of `published_rows` yield.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from math import exp, hypot, pi, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaln
from scipy.stats import kstest, kstwobign

import lidar_emu
from benchmarks.scenes import scanner, trajectory
from benchmarks.speckle_table import Figure, share
from lidar_emu.beams.footprint import beam_radius_m
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.receiver.custom_detection import SegmentSpectrum
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS

SCENES = Path(__file__).parent / "published"

_SEGMENTS = "up", "constant", "down"


class Line(NamedTuple):
    """A published value beside the emulator's."""

    quantity: str
    published: Figure
    """Its error is 0 unless it was measured."""
    ours: Figure
    allowed: float = 0.0
    """Difference that is allowed beside three Monte Carlo errors, relative to the published value."""
    is_bound: bool = False
    """Whether the published value is the largest that a user may expect."""

    @property
    def agrees(self) -> bool:
        """Whether the emulator has the published value, or is within it."""
        if self.is_bound:
            return abs(self.ours.value) <= self.published.value
        allowed = self.allowed * abs(self.published.value)
        return self.ours.over_allowed(self.published, allowed) <= 1.0

    @property
    def verdict(self) -> str:
        """What the page says."""
        if self.agrees:
            return "within" if self.is_bound else "agrees"
        return f"**differs: {abs(self.ours.value / self.published.value):.3g} times**"


def exact(value: float) -> Figure:
    """A value without an error."""
    return Figure(value, 0.0)


def scenario_of(scene: str, settings: dict[str, Any] | None = None) -> Any:
    """A scene of benchmarks/published with some keys changed."""
    return lidar_emu.load(SCENES / f"{scene}.yaml", settings)


def fly(scenario: Any, runs: int, first_seed: int = 1) -> list[lidar_emu.Measurement]:
    """Fly a scenario under successive seeds."""
    return [lidar_emu.simulate(scenario, seed=seed) for seed in range(first_seed, first_seed + runs)]


def mean(values: FloatArray) -> Figure:
    """Mean of independent values."""
    return Figure(float(values.mean()), float(values.std() / sqrt(values.size)))


def deviation(values: FloatArray) -> Figure:
    """Standard deviation, its error by the fourth moment."""
    off = values - values.mean()
    variance = np.mean(off**2)
    error = sqrt((np.mean(off**4) - variance**2) / (4.0 * variance * off.size))
    return Figure(sqrt(variance), error)


def ratio(one: Figure, other: Figure) -> Figure:
    """Ratio of independent figures."""
    value = one.value / other.value
    return Figure(value, abs(value) * hypot(one.error / one.value, other.error / other.value))


# Speckle.


def _slope_errors(
    tilt_deg: float, range_m: float, runs: int, first_seed: int, power_w: float = 1e4
) -> FloatArray:
    """Sizes of the errors of range without noise, over s = w tan θ / √8."""
    altitude_m = range_m * float(np.cos(np.radians(tilt_deg)))
    keys = {
        "scanner": scanner(tilt_deg, 0, 90, 180, 270),
        "trajectory": trajectory(altitude_m, 51.0, 0.5),
        "instrument.optics.laser_power_w": power_w,
    }
    scenario = scenario_of("static_speckle", keys)
    optics, waveform = scenario.instrument.optics, scenario.instrument.waveform
    found = []
    for run in fly(scenario, runs, first_seed):
        radius_m = beam_radius_m(run.true_range_m, optics.waist_radius_m, waveform.wavelength_m)
        spread_m = radius_m * np.tan(np.radians(run.true_incidence_deg)) / sqrt(8.0)
        found.append(np.abs((run.range_m - run.true_range_m) / spread_m)[run.range_valid])
    return np.concatenate(found)


def static_speckle(runs: int) -> Iterator[Line]:
    """Quantiles of the ratio of two Gaussian numbers: P(|error| < q) = q / sqrt(s² + q²)."""
    places = (45.0, 500.0), (22.5, 1000.0), (22.5, 2000.0), (60.0, 500.0), (60.0, 2000.0)
    for place, (tilt_deg, range_m) in enumerate(places):
        errors = _slope_errors(tilt_deg, range_m, runs, 1 + place * runs)
        for probability, allowed in ((0.5, 0.03), (0.95, 0.03), (0.99, 0.0)):
            law = probability / sqrt(1.0 - probability**2)
            error = sqrt(probability * (1.0 - probability) / errors.size) * (1.0 + law**2) ** 1.5
            name = f"{tilt_deg:g}°, {range_m / 1e3:g} km: {100 * probability:g} % of errors within, in s"
            yield Line(name, exact(law), Figure(float(np.quantile(errors, probability)), error), allowed)


def outliers(runs: int) -> Iterator[Line]:
    """Largest errors at 60 degrees and 2 km, with little and with much light."""
    scenario = scenario_of("static_speckle")
    radius_m = beam_radius_m(np.array(2000.0), scenario.instrument.optics.waist_radius_m, 1550e-9)
    resolution = scenario.instrument.waveform.range_bin_m / (float(radius_m) * sqrt(3.0 / 8.0))
    faint, bright = (
        _slope_errors(60.0, 2000.0, runs, first_seed, power_w) / resolution
        for first_seed, power_w in ((1, 1e3), (1 + runs, 1e5))
    )
    name = f"largest of {faint.size} errors over the resolution"
    yield Line(name, exact(1.0), exact(float(faint.max())), is_bound=True)
    yield Line(f"{name}, 20 dB more light", exact(1.0), exact(float(bright.max())), is_bound=True)
    high = [
        mean(np.quantile(errors[: errors.size // 20 * 20].reshape(20, -1), 0.99, axis=1))
        for errors in (bright, faint)
    ]
    yield Line("99 % of errors within, 20 dB more light over less", exact(1.0), ratio(*high))


def moving_speckle(runs: int) -> Iterator[Line]:
    """Width of the mean spectrum of a moving footprint, less a Hann window's."""
    scenario = scenario_of("moving_speckle")
    waveform, optics = scenario.instrument.waveform, scenario.instrument.optics
    found = []
    for seed in range(1, runs + 1):
        powers: dict[float, float] = {}

        def collect(spectrum: SegmentSpectrum, powers: dict[float, float] = powers) -> list[float]:
            if spectrum.segment == "constant":
                for k, power in zip(
                    np.rint(spectrum.frequency_hz / waveform.bin_width_hz), spectrum.power, strict=True
                ):
                    powers[k] = powers.get(k, 0.0) + power
            return []

        run = lidar_emu.simulate(scenario, seed=seed, detector=collect)
        bins, weights = np.array(list(powers)), np.array(list(powers.values()))
        variance = np.cov(bins, aweights=weights, ddof=0) - 1.0 / 3.0
        found.append(sqrt(variance) * waveform.bin_width_hz)
        across_mps = float(np.linalg.norm(run.velocity_site_mps[0, :2]))
    law_hz = across_mps / (pi * sqrt(2.0) * optics.waist_radius_m)
    yield Line("standard deviation of the line, Hz", exact(law_hz), mean(np.array(found)), allowed=0.01)


# Detection and frequency estimates.


@cache
def _snr_per_w(waist_m: float = 0.017, speed_mps: float = 22.6367) -> float:
    """Signal-to-noise ratio in the bin of a steady echo per watt, at a power at which noise does not matter."""
    settings = {
        "instrument.optics.laser_power_w": 1000.0 * (waist_m / 0.017) ** -2,
        "instrument.optics.waist_radius_m": waist_m,
        "trajectory.waypoints": _level_flight(speed_mps),
    }
    run = lidar_emu.simulate(scenario_of("detection", settings), seed=1)
    return float(np.mean(10.0 ** (0.1 * run.snr_db)) / settings["instrument.optics.laser_power_w"])


def _level_flight(speed_mps: float) -> list[dict[str, float]]:
    return [
        {"altitude_m": 1901.57 + side * 0.05 * speed_mps / 22.6367, "speed_mps": speed_mps}
        for side in (1, -1)
    ]


def _detected(power_w: float, speckle: bool, runs: int) -> Figure:
    """Share of records with a detection."""
    keys = {
        "instrument.optics.laser_power_w": power_w,
        "instrument.optics.speckle": speckle,
        "instrument.optics.beamlets": 19 if speckle else 1,
    }
    bits = np.concatenate([run.segments for run in fly(scenario_of("detection", keys), runs)])
    return share(np.stack([bits >> bit & 1 for bit in range(3)]).astype(bool).ravel())


def detection(runs: int) -> Iterator[Line]:
    """Detection of a steady and of a fading echo in one record, and noise alone."""
    threshold = -np.log(1e-6)
    steady_db, fading = 13.183490056794499, -threshold / np.log(0.9) - 1.0
    snr = 10.0 ** (0.1 * steady_db)
    per_w = _snr_per_w()
    yield Line("P_d, steady, 13.183 dB, P_fa 1e-6", exact(0.9), _detected(snr / per_w, False, runs))
    yield Line(
        "P_d, Swerling 1, 13.183 dB", exact(exp(-threshold / (1.0 + snr))), _detected(snr / per_w, True, runs)
    )
    yield Line(
        f"P_d, Swerling 1, {10.0 * np.log10(fading):.2f} dB",
        exact(0.9),
        _detected(fading / per_w, True, runs),
    )
    any_bin = 1.0 - (1.0 - 1e-6) ** 2048
    yield Line("P_fa of 2048 bins", exact(any_bin), _detected(1e-12, False, runs))


_BAD_BINS = 5.0
"""Distance of a bad estimate from the line."""


def _estimates(
    snr: float, waist_m: float, speed_mps: float, seconds: int, seed: int
) -> tuple[FloatArray, FloatArray, float]:
    """Highest bins of whole spectra, their true bins, and the standard deviation Ω of the line in bins."""
    keys = {
        "instrument.optics.laser_power_w": snr / _snr_per_w(waist_m, speed_mps),
        "instrument.optics.waist_radius_m": waist_m,
        "trajectory.waypoints": _level_flight(speed_mps),
        "duration_s": seconds,
    }
    scenario = scenario_of("bad_estimates", keys)
    waveform, highest = scenario.instrument.waveform, []

    def take(spectrum: SegmentSpectrum) -> list[float]:
        highest.append((_SEGMENTS.index(spectrum.segment), 1 + int(spectrum.power[1:-1].argmax())))
        return []

    run = lidar_emu.simulate(scenario, seed=seed, detector=take, progress=lambda _done, _shots: None)
    closing_mps = float(run.true_closing_speed_mps[0, 0])
    doppler, beat = closing_mps / waveform.speed_bin_mps, run.true_range_m[0, 0] / waveform.range_bin_m
    width = sqrt(speed_mps**2 - closing_mps**2) / (pi * sqrt(2.0) * waist_m) / waveform.bin_width_hz
    segment, found = np.array(highest).T
    return found, np.abs(np.array([beat - doppler, doppler, beat + doppler]))[segment], width


def bad_estimates(seconds: int) -> Iterator[Line]:
    """Share of highest bins that are noise, and where they lie, with a still and a moving footprint."""
    bins, strays = 2047, []
    still, moving = (0.017, 22.6367), (0.00067, 199.88)
    cases = (3.0, still), (10.0, still), (30.0, still), (100.0, still), (10.0, moving)
    for seed, (snr, motion) in enumerate(cases, start=1):
        found, true, width = _estimates(snr, *motion, seconds, seed)
        bad = np.abs(found - true) > _BAD_BINS
        strays.append(found[bad])
        # The highest of n exponential bins beside one of the mean 1 + Φ: E[(1 - exp(-z))^n].
        share_of = 1.0 / (1.0 + snr)
        law = 1.0 - exp(gammaln(1.0 + share_of) + gammaln(bins) - gammaln(bins + share_of))
        yield Line(f"share of bad estimates, Φ {snr:g}, Ω {width:.2g}", exact(law), share(bad))
    places = np.concatenate(strays) / (bins + 1)
    limit, distance = float(kstwobign.ppf(0.99)) / sqrt(places.size), kstest(places, "uniform").statistic
    name = "bad estimates: distance from uniform, 1 % limit"
    yield Line(name, exact(limit), exact(float(distance)), is_bound=True)


# Phase noise of the laser.


def phase_noise(runs: int) -> Iterator[Line]:
    """What is left of a line, by its bin less the mean of both neighbours, which hold the pedestal alone."""
    scenario = scenario_of("phase_noise")
    waveform, bin_hz = scenario.instrument.waveform, scenario.instrument.waveform.bin_width_hz
    run = fly(scenario, 1)[0]
    line = round(run.true_closing_speed_mps[0, 0] / waveform.speed_bin_mps)
    delay_s = 2.0 * run.true_range_m[0, 0] / SPEED_OF_LIGHT_MPS

    def left(exponent: float) -> Figure:
        linewidth_hz = exponent / (2.0 * pi * delay_s)
        powers = []

        def take(spectrum: SegmentSpectrum) -> list[float]:
            if spectrum.segment == "constant":
                k = int(np.searchsorted(spectrum.frequency_hz, (line - 0.5) * bin_hz))
                powers.append(spectrum.power[k] - 0.5 * (spectrum.power[k - 1] + spectrum.power[k + 1]))
            return []

        widened = scenario.with_({"instrument.waveform.linewidth_hz": linewidth_hz})
        for seed in range(1, runs + 1):
            lidar_emu.simulate(widened, seed=seed, detector=take)
        return mean(np.array(powers))

    whole = left(0.0)
    for exponent in (0.3, 1.0, 2.0, 3.0):
        found = left(exponent)
        name = f"power in the line, 2πΔντ = {exponent:g}"
        yield Line(name, exact(exp(-exponent)), ratio(found, whole), allowed=0.02)
