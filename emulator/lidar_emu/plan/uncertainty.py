"""Uncertainty of one measurement of a beam by source, as the Guide to the Expression of Uncertainty (GUM) tabulates it.

Uncertainties are combined by Monte Carlo (GUM, supplement 1): noise in a fading echo and speckle have no variance. In
place of a standard deviation such a source has its 68.27 % half-width. A sensitivity is the contribution over the
input's uncertainty, with the correlation of the three segments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidar_emu.beams.flight import Flight, sensor_height_m
from lidar_emu.errors import Finding, InputError
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import dot
from lidar_emu.plan.error_draws import BEAT_SOURCES, Draws, beam_sources, draw_errors
from lidar_emu.plan.expected_error import BeamErrors, errors_of_shots
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.vibration import vibration_variances
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scenario.vibration import Vibration, VibrationSpectrum

DRAWS, _DRAWS_OFF = 100_000, 10_000
"""Draws of all sources that are on, and with one that is off."""
COVERAGE = (0.6827, 0.95)
"""Probabilities of the two half-widths."""

_SAMPLED = 4096
_BEYOND = 0.05
"""Share by which an altitude may be beyond the flight's: its last shot is above its end."""
_LEAST_DETECTED = 0.02

_LINEWIDTH_HZ, _RESIDUAL, _FLICKER_HZ2 = 3e3, 5e-5, 1e6
_ROUGHNESS_M, _ALIGNMENT_RAD, _CLOCK, _TERRAIN_M, _VIBRATION_G = 0.01, 23e-6, 1e-6, 3.5, 1.0
"""Typical sizes for sources that are off: docs/evidence/error-sources.md; heights of SLDEM2015, 3 to 4 m rms, of Barker
et al. (2016); 1 g rms from 20 to 2000 Hz and 1 cm of roughness are assumed."""

_FADING = "Student t"
_TYPES_LAWS = {
    "quantisation": ("B", "uniform"),
    "noise": ("A", _FADING),
    "speckle": ("A", _FADING),
    "roughness": ("A", _FADING),
    "line": ("A", "normal"),
    "sweep": ("A", "normal"),
    "ripple": ("B", "arcsine"),
}
_WIDTHS_95 = {
    "normal": 1.95996,
    "uniform": np.sqrt(3.0) * COVERAGE[1],
    "arcsine": np.sqrt(2.0) * np.sin(0.5 * np.pi * COVERAGE[1]),
    "known": 1.0,
}
"""95 % half-widths of distributions over their standard deviations, and of a systematic error over its size."""


@dataclass(frozen=True)
class Contribution:
    """What a source contributes to the error of range in m or of closing speed in m/s."""

    sensitivity: float
    """Contribution over the input's uncertainty."""
    uncertainty: float
    """Standard uncertainty; the 68.27 % half-width where there is no variance."""
    half_width_95: float


@dataclass(frozen=True)
class UncertaintySource:
    """A row of the sheet."""

    name: str
    on: bool
    """Whether the scenario has it; otherwise its values are those of a typical size."""
    type: str
    """A: random, as repeated shots show it. B: from a bound, a calibration or a model."""
    law: str
    """Distribution of the input; "known" is a systematic error, and Student's t has two degrees of freedom."""
    has_variance: bool
    quantity: str
    """What the input is, and its unit."""
    unit: str
    input_uncertainty: float
    range_m: Contribution
    speed_mps: Contribution


@dataclass(frozen=True)
class CombinedUncertainty:
    """The error of range in m or of closing speed in m/s by all sources that are on."""

    systematic: float
    """Known error, by motion and misalignment."""
    uncertainty: float
    """Root of the sum of the squared contributions of the other sources."""
    half_width_68: float
    """68.27 % of errors less the systematic one."""
    half_width_95: float
    coverage_factor_68: float
    """Half-width over `uncertainty`."""
    coverage_factor_95: float
    reported_68: float
    """68.27 % of errors as reported, the systematic one included."""
    reported_95: float


@dataclass(frozen=True)
class Sheet:
    """Uncertainty of one measurement of one beam."""

    beam: int
    altitude_m: float
    time_s: float
    range_m: float
    closing_speed_mps: float
    incidence_deg: float
    snr_db: float
    detected: float
    """Share of measurements that are valid; the others do not count."""
    sources: tuple[UncertaintySource, ...]
    range_error_m: CombinedUncertainty
    speed_error_mps: CombinedUncertainty


def uncertainty_at(scenario: FlightScenario, altitude_m: float, beam: int) -> Sheet:
    """Compute the sheet of a beam of the first shot nearest to an altitude, without faults.

    Args:
        scenario: a flight without live truth.
        altitude_m: height of the sensor above the points that its beams hit.
        beam: its number.

    Raises:
        InputError: the flight has no shot there, the level reports the truth, or the beam has no measurements there.
    """
    if scenario.level == "geometric":
        raise InputError(scenario.name, "level", scenario.level, "must be spectral or reference")
    detection = scenario.instrument.detection
    if detection.looks > 1:
        raise InputError(
            scenario.name, "instrument.detection.looks", detection.looks, "must be 1 for a sheet"
        )
    if detection.peak == "parabola":
        remedy = "must be bin, jacobsen, hann or aboutanios_mulgrew for a sheet"
        raise InputError(scenario.name, "instrument.detection.peak", detection.peak, remedy)
    flight = Flight(scenario)
    if not 0 <= beam < flight.scanner.beam_count:
        remedy = f"must be a beam of the scanner, 0 to {flight.scanner.beam_count - 1}"
        raise InputError("--beam", None, beam, remedy)
    shot, height_m = shot_at(scenario, flight, altitude_m)
    errors = _errors(scenario, flight, shot)
    if not errors.expected[0, beam]:
        found = Finding(f"beam {beam} meets no ground")
        raise InputError(scenario.name, None, found, "take another --beam or --at")
    draws = _draws(scenario, flight, errors, beam, DRAWS)
    tilt = _tilted(flight, errors, beam)
    sources = (
        *_beat_sources(scenario, flight, errors, beam, draws),
        *_other_sources(scenario, flight, errors, beam, draws.motion.mean(axis=1), tilt),
    )
    combined = []
    for quantity in range(2):
        parts = [
            (source.range_m, source.speed_mps)[quantity].uncertainty
            for source in sources
            if source.on and source.law != "known"
        ]
        systematic = float(draws.motion[quantity].mean() + tilt[quantity])
        combined.append(
            _combined(draws.error[quantity] + tilt[quantity], systematic, float(np.hypot.reduce(parts)))
        )
    return Sheet(
        beam=beam,
        altitude_m=height_m,
        time_s=1e-9 * float(errors.pointing.time_ns[0, beam]),
        range_m=float(errors.truth[0, 0, beam]),
        closing_speed_mps=float(errors.truth[1, 0, beam]),
        incidence_deg=float(np.degrees(np.arccos(_cosine(errors, beam)))),
        snr_db=float(10.0 * np.log10(errors.snr[0, beam])),
        detected=draws.detected,
        sources=sources,
        range_error_m=combined[0],
        speed_error_mps=combined[1],
    )


def shot_at(scenario: FlightScenario, flight: Flight, altitude_m: float) -> tuple[int, float]:
    """Find the shot whose height is nearest to an altitude, and its height in m.

    Raises:
        InputError: the flight has no such height.
    """
    shots = np.unique(np.linspace(0, flight.shot_count - 1, _SAMPLED).astype(np.int64))
    heights_m = _heights_m(flight, shots)
    lowest, highest = float(heights_m.min()), float(heights_m[np.isfinite(heights_m)].max(initial=-np.inf))
    nearest = int(np.argmin(np.abs(heights_m - altitude_m)))
    around = np.arange(shots[max(nearest - 1, 0)], shots[min(nearest + 1, len(shots) - 1)] + 1)
    if len(around) > 3:
        shots, heights_m = around, _heights_m(flight, around)
        nearest = int(np.argmin(np.abs(heights_m - altitude_m)))
    if not (1.0 - _BEYOND) * lowest <= altitude_m <= (1.0 + _BEYOND) * highest:
        found = Finding(f"heights of {lowest:.5g} to {highest:.5g} m over the ground")
        raise InputError(scenario.name, "--at", altitude_m, f"must be within the flight's {found}")
    return int(shots[nearest]), float(heights_m[nearest])


def _heights_m(flight: Flight, shots: Any) -> FloatArray:
    pointing, _ = flight.point(shots, flight.scanner.initial)
    return sensor_height_m(pointing, flight.cast(pointing))


def _errors(scenario: FlightScenario, flight: Flight, shot: int) -> BeamErrors:
    return errors_of_shots(scenario, flight, scenario.instrument.optics.beamlets, np.array([shot]))


def _draws(scenario: FlightScenario, flight: Flight, errors: BeamErrors, beam: int, count: int) -> Draws:
    model = build_receiver(scenario.instrument, scenario.site)
    sources = beam_sources(scenario, flight, errors, beam)
    draws = draw_errors(model, sources, count, seed=int(errors.pointing.shot[0]))
    if draws.detected < _LEAST_DETECTED:
        found = Finding(f"{100.0 * draws.detected:.2g} % of measurements are valid")
        raise InputError(scenario.name, None, found, "a sheet needs 2 %: more light, or another --at")
    return draws


def _combined(error: FloatArray, systematic: float, uncertainty: float) -> CombinedUncertainty:
    halves = [float(each) for each in np.quantile(np.abs(error - systematic), COVERAGE)]
    factors = (half / uncertainty for half in halves)
    reported = (float(each) for each in np.quantile(np.abs(error), COVERAGE))
    return CombinedUncertainty(systematic, uncertainty, *halves, *factors, *reported)


def _tilted(flight: Flight, errors: BeamErrors, beam: int) -> FloatArray:
    """(2,) Range and closing speed on the true axis of a beam less those on the published one."""
    pointing, published = errors.pointing, errors.pointing.published_site[:, beam]
    if np.array_equal(published, pointing.true_site[:, beam]):
        return np.zeros(2)
    hits = flight.cast_rays(pointing.time_ns[:, beam], pointing.sensor_site_m[:, beam], published)
    turned = pointing.true_site[0, beam] - published[0]
    speed_mps = dot(pointing.sensor_velocity_site_mps[0, beam], turned)
    return np.array([errors.hits.range_m[0, beam] - hits.range_m[0], speed_mps])


def _cosine(errors: BeamErrors, beam: int) -> float:
    """Cosine of the angle of incidence."""
    normal, axis = errors.hits.normal_site[0, beam], errors.pointing.true_site[0, beam]
    return float(np.clip(-normal @ axis, 1e-3, 1.0))


def _beat_sources(
    scenario: FlightScenario, flight: Flight, errors: BeamErrors, beam: int, draws: Draws
) -> Iterator[UncertaintySource]:
    """Rows of the sources that move beats: those that are on as drawn together, each other one with all that are on."""
    waveform, surface = scenario.instrument.waveform, scenario.site.surface
    speckle, key = scenario.instrument.optics.speckle, "instrument.waveform"
    ripple_hz = np.sqrt(2.0) * _RESIDUAL * waveform.chirp_slope_hz_per_s * waveform.segment_time_s
    fading = {"instrument.optics.speckle": True}
    random = {f"{key}.slope_scatter": np.sqrt(12.0) * _RESIDUAL, f"{key}.flicker_hz2": _FLICKER_HZ2}
    on_or_typical: tuple[tuple[bool, dict[str, Any]], ...] = (
        (scenario.instrument.detection.peak == "bin", {"instrument.detection.peak": "bin"}),
        (True, {}),
        (speckle, fading),
        (speckle and surface.roughness_m > 0.0, fading | {"site.surface.roughness_m": _ROUGHNESS_M}),
        (waveform.linewidth_hz > 0.0, {f"{key}.linewidth_hz": _LINEWIDTH_HZ}),
        (waveform.slope_scatter > 0.0 or waveform.flicker_hz2 > 0.0, random),
        (waveform.ripple_hz > 0.0, {f"{key}.ripple_hz": ripple_hz}),
    )
    for place, (on, typical) in enumerate(on_or_typical):
        flown, drawn = scenario, draws
        if not on:
            flown = _with_keys(scenario, typical)
            there = _errors(flown, flight, int(errors.pointing.shot[0]))
            drawn = _draws(flown, flight, there, beam, _DRAWS_OFF)
        yield _beat_source(flown, place, on, drawn)


def _with_keys(part: Any, keys: Mapping[str, Any]) -> Any:
    """A scenario, or a part of one, with dotted keys replaced."""
    update: dict[str, Any] = {}
    for key, value in keys.items():
        first, _, rest = key.partition(".")
        below = update.get(first, getattr(part, first))
        update[first] = _with_keys(below, {rest: value}) if rest else value
    return part.model_copy(update=update)


def _beat_source(scenario: FlightScenario, place: int, on: bool, draws: Draws) -> UncertaintySource:
    name = BEAT_SOURCES[place]
    source_type, law = _TYPES_LAWS[name]
    if law == _FADING and not scenario.instrument.optics.speckle:
        law = "normal"
    has_variance = law != _FADING
    # The down-chirp's beat has all of them.
    beat_hz = draws.beats_bin[place, 2] * scenario.instrument.waveform.bin_width_hz
    input_hz = _uncertainty(beat_hz, has_variance)
    contributions = (_drawn(error, input_hz, has_variance) for error in draws.by_source[place])
    return UncertaintySource(name, on, source_type, law, has_variance, "beat", "Hz", input_hz, *contributions)


def _uncertainty(error: FloatArray, has_variance: bool) -> float:
    return float(error.std() if has_variance else np.quantile(np.abs(error), COVERAGE[0]))


def _drawn(error: FloatArray, input_uncertainty: float, has_variance: bool) -> Contribution:
    uncertainty = _uncertainty(error, has_variance)
    sensitivity = uncertainty / input_uncertainty if input_uncertainty > 0.0 else 0.0
    return Contribution(sensitivity, uncertainty, float(np.quantile(np.abs(error), COVERAGE[1])))


def _other_sources(
    scenario: FlightScenario,
    flight: Flight,
    errors: BeamErrors,
    beam: int,
    motion: FloatArray,
    tilt: FloatArray,
) -> Iterator[UncertaintySource]:
    """Rows of the sources in closed form."""
    pointing, axis = errors.pointing, errors.pointing.true_site[0, beam]
    cosine = _cosine(errors, beam)
    range_m, speed_mps = (float(each) for each in np.abs(errors.truth[:, 0, beam]))
    acceleration_mps2 = abs(float(errors.echoes.closing_acceleration_mps2[0, beam]))
    yield _closed("motion", True, "B", "known", "acceleration", "m/s2", acceleration_mps2, motion)

    along = VibrationSpectrum(g_rms=_VIBRATION_G)
    vibration = scenario.vibration or Vibration(along_x=along, along_y=along, along_z=along)
    squares = np.square(flight.published_body(pointing)[0, beam])
    by_range_m, by_speed_mps, _, own_mps = np.sqrt(
        vibration_variances(vibration, scenario.instrument) @ squares
    )
    on, by_vibration = scenario.vibration is not None, (by_range_m, by_speed_mps)
    yield _closed("vibration", on, "A", "normal", "speed of the lidar", "m/s", own_mps, by_vibration)

    angle_rad = float(np.linalg.norm(axis - pointing.published_site[0, beam]))
    if angle_rad > 0.0:
        yield _closed("alignment", True, "B", "known", "angle", "rad", angle_rad, tilt)
    else:
        # Its direction is unknown: the part of the angle along the slope, or along the velocity, has an arcsine law.
        across_mps = np.linalg.norm(np.cross(pointing.sensor_velocity_site_mps[0, beam], axis))
        turned = np.sqrt(0.5) * _ALIGNMENT_RAD * np.array([range_m * np.tan(np.arccos(cosine)), across_mps])
        yield _closed("alignment", False, "B", "arcsine", "angle", "rad", _ALIGNMENT_RAD, turned)

    by_clock = _CLOCK * range_m, _CLOCK * speed_mps
    yield _closed("clock", False, "B", "uniform", "relative error", "", _CLOCK, by_clock)
    by_height = _TERRAIN_M * float(errors.hits.normal_site[0, beam, 2]) / cosine, 0.0
    yield _closed("terrain model", False, "B", "normal", "height", "m", _TERRAIN_M, by_height)


def _closed(
    name: str, on: bool, source_type: str, law: str, quantity: str, unit: str, value: float, sizes: Any
) -> UncertaintySource:
    """A row from its contributions to range and closing speed."""
    contributions = (
        Contribution(abs(size) / value if value > 0.0 else 0.0, abs(size), _WIDTHS_95[law] * abs(size))
        for size in (float(each) for each in sizes)
    )
    return UncertaintySource(name, on, source_type, law, True, quantity, unit, float(value), *contributions)
