"""Uncertainty of one measurement of a beam by source, as the Guide to the Expression of Uncertainty (GUM) tabulates it.

Uncertainties are combined by Monte Carlo (GUM, supplement 1): noise in a fading echo and speckle have no variance. In
place of a standard deviation such a source has its 68.27 % half-width, and coverage factors are relative to that of the
combined error. A sensitivity is the contribution over the input's uncertainty, with the correlation of the three
segments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

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

DRAWS = 100_000
COVERAGE = (0.6827, 0.95)
"""Probabilities of the two half-widths."""

_SAMPLED = 4096
_DRAWS_OFF = 20_000
_LEAST_DETECTED = 0.02

_LINEWIDTH_HZ, _RESIDUAL, _FLICKER_HZ2 = 3e3, 5e-5, 1e6
_RIPPLE_SHARE = _RESIDUAL * np.sqrt(2.0)
_ROUGHNESS_M, _ALIGNMENT_RAD, _CLOCK, _TERRAIN_M = 0.01, 23e-6, 1e-6, 3.5
_VIBRATION_G = 1.0
"""Typical sizes for sources that are off: docs/evidence/error-sources.md; heights of SLDEM2015, 3 to 4 m rms, of Barker
et al. (2016); 1 g rms from 20 to 2000 Hz and 1 cm of roughness are assumed."""

_NO_VARIANCE = frozenset({"noise", "speckle", "roughness"})
_STUDENT = "Student t, 2 degrees of freedom: no variance"
_LAWS = {
    "quantisation": "uniform in a bin",
    "noise": _STUDENT,
    "speckle": _STUDENT,
    "roughness": _STUDENT,
    "line": "normal",
    "sweep": "normal",
    "ripple": "arcsine",
}


class Contribution(NamedTuple):
    """What a source contributes to the error of range in m or of closing speed in m/s."""

    sensitivity: float
    """Contribution over the input's uncertainty."""
    uncertainty: float
    """Standard uncertainty; the 68.27 % half-width where there is no variance."""
    half_width_95: float


@dataclass(frozen=True)
class Source:
    """A row of the sheet."""

    name: str
    on: bool
    """Whether the scenario has it; otherwise its values are those of a typical size."""
    quantity: str
    unit: str
    input_uncertainty: float
    law: str
    has_variance: bool
    range_m: Contribution
    speed_mps: Contribution


class Combined(NamedTuple):
    """The error of range in m or of closing speed in m/s by all sources that are on."""

    systematic: float
    """Known error, by motion and misalignment."""
    half_width_68: float
    """68.27 % of errors less the systematic one."""
    half_width_95: float
    coverage_factor_95: float
    """The latter over the former."""
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
    sources: tuple[Source, ...]
    range_error_m: Combined
    speed_error_mps: Combined


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
    flight = Flight(scenario)
    if not 0 <= beam < flight.scanner.beam_count:
        remedy = f"must be a beam of the scanner, 0 to {flight.scanner.beam_count - 1}"
        raise InputError("--beam", None, beam, remedy)
    shot, height_m = shot_at(scenario, flight, altitude_m)
    errors = _errors(scenario, flight, shot)
    if not errors.expected[0, beam]:
        raise InputError(
            scenario.name, None, Finding(f"beam {beam} meets no ground"), "take another --beam or --at"
        )
    draws = _draws(scenario, flight, shot, beam, DRAWS, errors)
    sources = tuple(_sources(scenario, flight, shot, beam, errors, draws))
    tilt = _tilted(flight, errors, beam)
    systematic = draws.motion.mean(axis=1) + tilt
    cosine = float(-dot(errors.hits.normal_site, errors.pointing.true_site)[0, beam])
    return Sheet(
        beam=beam,
        altitude_m=height_m,
        time_s=1e-9 * float(errors.pointing.time_ns[0, beam]),
        range_m=float(errors.truth[0, 0, beam]),
        closing_speed_mps=float(errors.truth[1, 0, beam]),
        incidence_deg=float(np.degrees(np.arccos(min(cosine, 1.0)))),
        snr_db=float(10.0 * np.log10(errors.snr[0, beam])),
        detected=draws.detected,
        sources=sources,
        range_error_m=_combined(draws.error[0] + tilt[0], float(systematic[0])),
        speed_error_mps=_combined(draws.error[1] + tilt[1], float(systematic[1])),
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
    if not 0.999 * lowest <= altitude_m <= 1.001 * highest:
        found = Finding(f"heights of {lowest:.5g} to {highest:.5g} m over the ground")
        raise InputError(scenario.name, "--at", altitude_m, f"must be within the flight's {found}")
    return int(shots[nearest]), float(heights_m[nearest])


def _heights_m(flight: Flight, shots: Any) -> FloatArray:
    pointing, _ = flight.point(shots, flight.scanner.initial)
    return sensor_height_m(pointing, flight.cast(pointing))


def _errors(scenario: FlightScenario, flight: Flight, shot: int) -> BeamErrors:
    return errors_of_shots(scenario, flight, scenario.instrument.optics.beamlets, np.array([shot]))


def _draws(
    scenario: FlightScenario,
    flight: Flight,
    shot: int,
    beam: int,
    count: int,
    errors: BeamErrors | None = None,
) -> Draws:
    model = build_receiver(scenario.instrument, scenario.site)
    errors = errors or _errors(scenario, flight, shot)
    draws = draw_errors(model, beam_sources(scenario, flight, errors, beam), count, seed=shot)
    if draws.detected < _LEAST_DETECTED:
        found = Finding(f"{100.0 * draws.detected:.2g} % of measurements are valid")
        raise InputError(scenario.name, None, found, "a sheet needs 2 %: more light, or another --at")
    return draws


def _combined(error: FloatArray, systematic: float) -> Combined:
    half, wide = (float(each) for each in np.quantile(np.abs(error - systematic), COVERAGE))
    as_reported, wide_as_reported = (float(each) for each in np.quantile(np.abs(error), COVERAGE))
    return Combined(systematic, half, wide, wide / half, as_reported, wide_as_reported)


def _tilted(flight: Flight, errors: BeamErrors, beam: int) -> FloatArray:
    """(2,) Range and closing speed on the true axis of a beam less those on the published one."""
    pointing, published = errors.pointing, errors.pointing.published_site[:, beam]
    if np.array_equal(published, pointing.true_site[:, beam]):
        return np.zeros(2)
    hits = flight.cast_rays(pointing.time_ns[:, beam], pointing.sensor_site_m[:, beam], published)
    turned = pointing.true_site[0, beam] - published[0]
    speed_mps = dot(pointing.sensor_velocity_site_mps[0, beam], turned)
    return np.array([errors.hits.range_m[0, beam] - hits.range_m[0], speed_mps])


def _sources(
    scenario: FlightScenario, flight: Flight, shot: int, beam: int, errors: BeamErrors, draws: Draws
) -> Iterator[Source]:
    """Rows of the sheet: sources that move the beats, then those in closed form."""
    for name, (on, typical) in _beat_sources(scenario).items():
        changed = scenario if on else _with_keys(scenario, typical)
        drawn = draws if on else _draws(changed, flight, shot, beam, _DRAWS_OFF)
        yield _beat_source(changed, name, on, drawn)
    yield _motion(errors, beam, draws)
    yield _vibration(scenario, flight, errors, beam)
    yield _alignment(flight, errors, beam)
    range_m, speed_mps = np.abs(errors.truth[:, 0, beam])
    by_clock = (_uniform(_CLOCK, value) for value in (float(range_m), float(speed_mps)))
    yield Source("clock", False, "relative error", "", _CLOCK, "uniform", True, *by_clock)
    cosine = float(-dot(errors.hits.normal_site, errors.pointing.true_site)[0, beam])
    along = float(errors.hits.normal_site[0, beam, 2]) / max(cosine, 1e-3)
    by_height = _normal(_TERRAIN_M, along), _normal(_TERRAIN_M, 0.0)
    yield Source("terrain model", False, "height", "m", _TERRAIN_M, "normal", True, *by_height)


def _beat_sources(scenario: FlightScenario) -> dict[str, tuple[bool, dict[str, Any]]]:
    """Whether a scenario has each source that moves beats, and otherwise the keys of its typical size."""
    waveform, detection = scenario.instrument.waveform, scenario.instrument.detection
    speckle, roughness_m = scenario.instrument.optics.speckle, scenario.site.surface.roughness_m
    ripple_hz = _RIPPLE_SHARE * waveform.chirp_slope_hz_per_s * waveform.segment_time_s
    key = "instrument.waveform"
    fading = {"instrument.optics.speckle": True}
    random = {f"{key}.slope_scatter": np.sqrt(12.0) * _RESIDUAL, f"{key}.flicker_hz2": _FLICKER_HZ2}
    values: tuple[tuple[bool, dict[str, Any]], ...] = (
        (detection.peak == "bin", {"instrument.detection.peak": "bin"}),
        (True, {}),
        (speckle, fading),
        (speckle and roughness_m > 0.0, fading | {"site.surface.roughness_m": _ROUGHNESS_M}),
        (waveform.linewidth_hz > 0.0, {f"{key}.linewidth_hz": _LINEWIDTH_HZ}),
        (waveform.slope_scatter > 0.0 or waveform.flicker_hz2 > 0.0, random),
        (waveform.ripple_hz > 0.0, {f"{key}.ripple_hz": ripple_hz}),
    )
    return dict(zip(BEAT_SOURCES, values, strict=True))


def _with_keys(part: Any, keys: Mapping[str, Any]) -> Any:
    """A scenario, or a part of one, with dotted keys replaced."""
    update: dict[str, Any] = {}
    for key, value in keys.items():
        first, _, rest = key.partition(".")
        below = update.get(first, getattr(part, first))
        update[first] = _with_keys(below, {rest: value}) if rest else value
    return part.model_copy(update=update)


def _beat_source(scenario: FlightScenario, name: str, on: bool, draws: Draws) -> Source:
    place = BEAT_SOURCES.index(name)
    fades = name in _NO_VARIANCE and scenario.instrument.optics.speckle
    looks = scenario.instrument.detection.looks
    has_variance = not fades or looks > 1
    law = _LAWS[name] if fades or name not in _NO_VARIANCE else "normal"
    if fades and looks > 1:
        law = f"mean of {looks} looks, close to Student t"
    # The down-chirp's beat has all of them.
    beat_hz = draws.beats_bin[place, 2] * scenario.instrument.waveform.bin_width_hz
    input_hz = _uncertainty(beat_hz, has_variance)
    contributions = (_drawn(error, input_hz, has_variance) for error in draws.by_source[place])
    return Source(name, on, "beat", "Hz", input_hz, law, has_variance, *contributions)


def _uncertainty(error: FloatArray, has_variance: bool) -> float:
    return float(error.std() if has_variance else np.quantile(np.abs(error), COVERAGE[0]))


def _drawn(error: FloatArray, input_uncertainty: float, has_variance: bool) -> Contribution:
    uncertainty = _uncertainty(error, has_variance)
    sensitivity = uncertainty / input_uncertainty if input_uncertainty > 0.0 else 0.0
    return Contribution(sensitivity, uncertainty, float(np.quantile(np.abs(error), COVERAGE[1])))


def _motion(errors: BeamErrors, beam: int, draws: Draws) -> Source:
    acceleration_mps2 = abs(float(errors.echoes.closing_acceleration_mps2[0, beam]))
    contributions = (_known(float(error.mean()), acceleration_mps2) for error in draws.motion)
    law = "systematic: known from the motion"
    return Source("motion", True, "acceleration", "m/s2", acceleration_mps2, law, True, *contributions)


def _known(error: float, value: float) -> Contribution:
    return Contribution(abs(error) / value if value > 0.0 else 0.0, abs(error), abs(error))


def _vibration(scenario: FlightScenario, flight: Flight, errors: BeamErrors, beam: int) -> Source:
    along = VibrationSpectrum(g_rms=_VIBRATION_G)
    vibration = scenario.vibration or Vibration(along_x=along, along_y=along, along_z=along)
    axis = flight.published_body(errors.pointing)[0, beam]
    variances = vibration_variances(vibration, scenario.instrument) @ np.square(axis)
    range_m, speed_mps, _, own_mps = (float(each) for each in np.sqrt(variances))
    contributions = (_normal(own_mps, error / own_mps) for error in (range_m, speed_mps))
    on = scenario.vibration is not None
    return Source("vibration", on, "speed of the lidar", "m/s", own_mps, "normal", True, *contributions)


def _alignment(flight: Flight, errors: BeamErrors, beam: int) -> Source:
    pointing = errors.pointing
    axis, published = pointing.true_site[0, beam], pointing.published_site[0, beam]
    angle_rad = float(np.linalg.norm(axis - published))
    if angle_rad > 0.0:
        tilt = _tilted(flight, errors, beam)
        contributions = (_known(float(error), angle_rad) for error in tilt)
        law = "systematic: misalignment_mrad"
        return Source("alignment", True, "angle", "rad", angle_rad, law, True, *contributions)
    cosine = max(float(-errors.hits.normal_site[0, beam] @ axis), 1e-3)
    velocity_mps = pointing.sensor_velocity_site_mps[0, beam]
    across_mps = float(np.linalg.norm(velocity_mps - (velocity_mps @ axis) * axis))
    tilted_m = float(errors.hits.range_m[0, beam]) * np.sqrt(max(1.0 / cosine**2 - 1.0, 0.0))
    by_angle = (_arcsine(_ALIGNMENT_RAD, value / np.sqrt(2.0)) for value in (tilted_m, across_mps))
    law = "arcsine: direction unknown"
    return Source("alignment", False, "angle", "rad", _ALIGNMENT_RAD, law, True, *by_angle)


def _normal(uncertainty: float, sensitivity: float) -> Contribution:
    return Contribution(sensitivity, sensitivity * uncertainty, 1.95996 * sensitivity * uncertainty)


def _uniform(uncertainty: float, sensitivity: float) -> Contribution:
    reach = np.sqrt(3.0) * COVERAGE[1]
    return Contribution(sensitivity, sensitivity * uncertainty, float(reach * sensitivity * uncertainty))


def _arcsine(uncertainty: float, sensitivity: float) -> Contribution:
    reach = np.sqrt(2.0) * np.sin(0.5 * np.pi * COVERAGE[1])
    return Contribution(sensitivity, sensitivity * uncertainty, float(reach * sensitivity * uncertainty))
