"""Motion of the beams within measurements: its curvature between the records, and rotation while the light travels.

The beamlets lie on a triangular lattice and their Doppler shifts differ by motion across the beam. The correlation of
the up- and the down-chirp's echoes by these phases alone is the lattice's sum for a Gaussian footprint,

    Σ exp(-|u - b|²/16),    u = 2π (Doppler shift per radius w) (time between the chirps),

over the vectors b of the reciprocal lattice. The term b = 0 is the beam's own, the others are the lattice's: where they
count, both chirps have the same errors, which cancel in the range.
"""

from __future__ import annotations

from math import hypot, pi, sqrt
from typing import NamedTuple, get_args

import numpy as np

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.footprint import beam_radius_m, beamlet_pattern
from lidar_emu.beams.pointing import BeamVectors, ChirpBeams, Pointing
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import cross, dot
from lidar_emu.plan import Decision, LeftOut, at_most
from lidar_emu.plan.beat_errors import BeatErrors
from lidar_emu.plan.spectral_spread import Spread
from lidar_emu.receiver.echoes import LEAST_COSINE
from lidar_emu.receiver.motion_errors import build_motion_errors
from lidar_emu.receiver.returns import TRAVEL, Echoes
from lidar_emu.receiver.speckle import LINE_BIN2
from lidar_emu.receiver.speckle_field import PITCH_W
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument, Optics, Waveform
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_hits import Hits

CURVATURE_SHARE = 0.5
"""Share of the tolerated bias by which the curvature of the motion between the records may be left out."""

LEAST_LAG_DB = 0.01
"""Loss below which the lag of the receiving beam is left out: 0.1 % of a detection probability at most."""

_MOST_SHOTS = 65_536
_SHOTS_AT_ONCE = 4096


class MotionExtremes(NamedTuple):
    """Largest motion of a flight's beams within measurements, absolute values."""

    acceleration_mps2: float
    """Rate of the closing speed."""
    jerk_mps3: float
    """Its second derivative, from record to record."""
    bend_mps: float
    """Change of the closing speed from one record to the next that its rate does not explain."""
    bend_m: float
    """Change of the range from one record to the next that its rate does not explain."""
    turning_radps: float
    """Rate of a beam's direction."""


def sweep_motion(flight: Flight, hits: Hits, least_cosine: float) -> MotionExtremes:
    """Evaluate the beams of all shots, in the patterns as flown; of a long flight, 65 536 shots or more along it.

    Closing speeds are evaluated at each record's time. The ranges there depend on the ground, which is known at the
    sampled `hits` alone: their change is bounded at the farthest of them and the least cosine of incidence by
    (|a| + 2 |R'| |u'| + R |u''|) T² / (2 cos θ), with |R'| at most (|v| + R |u'|) / cos θ.
    """
    segment_s = flight.scenario.instrument.waveform.segment_time_s
    step = max(1, flight.shot_count // _MOST_SHOTS)
    shot, state = np.arange(0, flight.shot_count, step, dtype=np.int64), flight.scanner.initial
    farthest_m = float(np.nanmax(hits.range_m, initial=0.0))
    extremes = np.zeros(len(MotionExtremes._fields))
    for first in range(0, len(shot), _SHOTS_AT_ONCE):
        pointing, state = flight.point(shot[first : first + _SHOTS_AT_ONCE], state, follows_chirps=True)
        motion = _motions(pointing, segment_s, farthest_m, least_cosine)
        extremes = np.maximum(extremes, [largest(values) for values in motion])
    return MotionExtremes(*extremes.tolist())


def _motions(
    pointing: Pointing, segment_s: float, farthest_m: float, least_cosine: float
) -> tuple[FloatArray, ...]:
    beams, chirps = BeamVectors(*pointing.beams), ChirpBeams(*pointing.at_chirps)
    swing = cross(beams.turning_radps, beams.true)
    closing_mps = dot(beams.velocity_mps, beams.true)
    rate_mps2 = dot(beams.acceleration_mps2, beams.true) + dot(beams.velocity_mps, swing)
    before_mps, after_mps = dot(chirps.velocity_mps, chirps.true) - closing_mps
    bend_mps = np.maximum(
        np.abs(after_mps - rate_mps2 * segment_s), np.abs(before_mps + rate_mps2 * segment_s)
    )

    turning_radps = _length(swing)
    accelerating_mps2 = _length(chirps.velocity_mps - beams.velocity_mps).max(axis=0) / segment_s
    swinging_radps2 = _length(chirps.true.sum(axis=0) - 2.0 * beams.true) / segment_s**2
    range_rate_mps = (_length(beams.velocity_mps) + farthest_m * turning_radps) / least_cosine
    curvature_mps2 = accelerating_mps2 + 2.0 * range_rate_mps * turning_radps + farthest_m * swinging_radps2
    return (
        rate_mps2,
        (before_mps + after_mps) / segment_s**2,
        bend_mps,
        0.5 * segment_s**2 * curvature_mps2 / least_cosine,
        turning_radps,
    )


def largest(values: FloatArray) -> float:
    """Largest absolute value; 0 if all are NaN."""
    return float(np.nanmax(np.abs(values), initial=0.0))


def _length(vectors: FloatArray) -> FloatArray:
    return np.sqrt(dot(vectors, vectors))


def least_cosine(pointing: Pointing, hits: Hits) -> float:
    """Cosine of the most grazing incidence of beams at their hits, limited to 89.94 degrees."""
    cosine = -dot(hits.normal_site, pointing.true_site)
    return max(float(np.nanmin(cosine, initial=1.0)), LEAST_COSINE)


def plan_steady_motion(instrument: Instrument, motion: MotionExtremes) -> Decision:
    """State the range error by the steady change of the closing speed from segment to segment."""
    fastest_mps2 = motion.acceleration_mps2
    bias_m = build_motion_errors(instrument).range_per_mps2 * fastest_mps2
    reason = f"{fastest_mps2:.3g} m/s² makes {bias_m:.2g} m of range error, short while decelerating"
    if instrument.detection.compensate == "acceleration":
        reason = f"the instrument compensates {fastest_mps2:.3g} m/s², {bias_m:.2g} m, from shot to shot"
    return Decision("motion in a shot", True, "each segment's own time", reason, "exact for steady rates")


def plan_curvature(
    scenario: FlightScenario, motion: MotionExtremes, least_sigma: tuple[float, float]
) -> tuple[Decision, bool]:
    """Decide whether beams are pointed at each record's time, or continue with their rates, from the least standard
    deviations of range and closing speed.

    A change δv of closing speed between chirp and constant segment changes range by c δv / (λ S), as an acceleration
    does.
    """
    instrument, waveform = scenario.instrument, scenario.instrument.waveform
    # The curves are parabolas: the records of further looks are farther from the time of validity.
    farther = (instrument.furthest_record_s / waveform.segment_time_s) ** 2
    speed_mps = farther * motion.bend_mps
    range_m = farther * motion.bend_m + speed_mps * waveform.range_per_speed_s
    # Within a record the mean speed exceeds the one at its centre by jerk T² / 24.
    within_mps = motion.jerk_mps3 * waveform.record_time_s**2 / 24.0
    reason = (
        f"{motion.jerk_mps3:.3g} m/s³ of jerk, {motion.bend_m:.2g} m of range's curvature to the next record"
    )
    share = CURVATURE_SHARE * scenario.left_out_share
    least_m, least_mps = share * least_sigma[0], share * least_sigma[1]
    follows = share == 0.0 or range_m > least_m or speed_mps > least_mps
    if follows:
        how = "beams at each record's own time"
        within = LeftOut(0.0, within_mps)
        return Decision("curvature of motion", True, how, reason, f"{within}, within records", within), True
    effect = LeftOut(range_m, speed_mps + within_mps)
    return Decision("curvature of motion", False, "-", reason, str(effect), effect), False


def plan_unknown_curvature(waveform: Waveform) -> Decision:
    """Describe what live truth leaves out: the motion after a shot is not known when it is computed."""
    speed_mps = 0.5 * waveform.segment_time_s**2
    bound = (
        f"{at_most(speed_mps * waveform.range_per_speed_s)} m, {at_most(speed_mps)} m/s for each m/s³ of jerk"
    )
    return Decision("curvature of motion", False, "-", "the motion after a shot is unknown", bound)


def plan_delay(echoes: Echoes, motion: MotionExtremes, segment_s: float) -> Decision:
    """State how much the travel time of the light changes echoes sampled along the flight, and its second order."""
    delay_s = echoes.range_m[..., 0] / SPEED_OF_LIGHT_MPS
    closing_mps, rate_mps = echoes.closing_speed_mps[..., 0], echoes.range_rate_mps[..., 0]
    acceleration_mps2 = np.abs(echoes.closing_acceleration_mps2)
    range_m = largest(rate_mps * delay_s)
    speed_mps = largest(closing_mps**2 / SPEED_OF_LIGHT_MPS + acceleration_mps2 * delay_s)
    reason = f"changes ranges by up to {range_m:.2g} m, closing speeds by up to {speed_mps:.2g} m/s"
    farthest_s = largest(delay_s)
    second_m = motion.bend_m * (farthest_s / segment_s) ** 2 + largest(
        rate_mps**2 * delay_s / SPEED_OF_LIGHT_MPS
    )
    slower = range_m / SPEED_OF_LIGHT_MPS
    second_mps = 0.5 * motion.jerk_mps3 * farthest_s**2 + motion.acceleration_mps2 * slower
    effect = LeftOut(second_m, second_mps)
    return Decision("travel time of the light", True, "first order in R/c", reason, str(effect), effect)


def plan_lag(
    scenario: FlightScenario, motion: MotionExtremes, hits: Hits, errors: BeatErrors
) -> tuple[Decision, bool]:
    """Decide whether echoes are dimmed by the rotation of the beam while the light travels; see docs/physics.md."""
    optics, waveform = scenario.instrument.optics, scenario.instrument.waveform
    range_m = np.array(np.nanmax(hits.range_m, initial=0.0))
    apart_m = 2.0 * range_m**2 * motion.turning_radps / SPEED_OF_LIGHT_MPS
    radius_m = beam_radius_m(range_m, optics.waist_radius_m, waveform.wavelength_m)
    loss_db = float(10.0 * np.log10(np.e) * (apart_m / radius_m) ** 2)
    reason = f"beams turn at up to {motion.turning_radps:.3g} rad/s"
    if loss_db > (LEAST_LAG_DB if scenario.left_out_share > 0.0 else 0.0):
        how = f"up to {loss_db:.2g} dB of power"
        return Decision("lag of the receiving beam", True, how, reason, "exact"), True
    bound = f"{at_most(loss_db)} dB of power" if loss_db > 0 else "exact"
    share = 1.0 - 10.0 ** (-0.1 * loss_db)
    # Less power scatters beats by so much more.
    effect = errors.scatter(0.25 * share**2 * errors.variance_bin2, share)
    return Decision("lag of the receiving beam", False, "-", reason, bound, effect), False


def grown_beam_drift_per_s(instrument: Instrument, echoes: Echoes) -> FloatArray:
    """Drift of the speckle (shots, beams) in pitches per second, for beams of several beamlets.

    Their Doppler shifts are their own: the exchange is slower by the growth of the beam.
    """
    waist_m = instrument.optics.waist_radius_m
    radius_m = beam_radius_m(echoes.range_m[..., 0], waist_m, instrument.waveform.wavelength_m)
    drift_per_s: FloatArray = echoes.speckle_motion[..., TRAVEL] * waist_m / radius_m
    return drift_per_s


def exchange_bin2(instrument: Instrument, drift_per_s: FloatArray) -> FloatArray:
    """Variance in bins² of the line by the exchange of scatterers, for drifts in pitches per second."""
    return np.asarray(LINE_BIN2 * drift_per_s**2 * instrument.waveform.record_time_s**2)


ALLOWED_SHARE = 0.1
"""Share of the variance of beats that may be common to both chirps: 5 % of sigma."""

_COUNTS: tuple[int, ...] = get_args(Optics.model_fields["beamlets"].annotation)

_SHELLS = np.sqrt([1.0, 3.0, 4.0, 7.0, 9.0, 12.0, 13.0, 16.0])
"""Lengths of the vectors of the reciprocal lattice over the least one."""


def common_share(
    instrument: Instrument, echoes: Echoes, spread: Spread, variance_bin2: FloatArray, beamlets: int
) -> float:
    """Largest share of the variance of a flight's beats that returning phases make common to both chirps.

    Args:
        instrument: instrument with speckle.
        echoes: echoes of one beamlet per beam, (shots, beams, 1).
        spread: of their footprints.
        variance_bin2: (shots, beams) of a beat, NaN without light.
        beamlets: beamlets per beam, at least 7.
    """
    waveform = instrument.waveform
    between_s = 2.0 * waveform.segment_time_s
    shift_hz = sqrt(8.0) * waveform.bin_width_hz * np.sqrt(spread.variance(0.0, 1.0))
    phases = lattice_correlation(2.0 * pi * between_s * shift_hz, beamlets)
    drift_per_s = grown_beam_drift_per_s(instrument, echoes)
    exchanged = np.exp(-2.0 * (PITCH_W * between_s * drift_per_s) ** 2)
    by_speckle_bin2 = (
        0.5 * exchange_bin2(instrument, echoes.speckle_motion[..., TRAVEL]) / instrument.detection.looks
    )
    share = phases**2 * exchanged * by_speckle_bin2 / variance_bin2
    return float(np.nanmax(share, initial=0.0))


def lattice_correlation(phase_per_w: FloatArray, beamlets: int) -> FloatArray:
    """Correlation that the lattice adds to a Gaussian footprint's, in the worst direction of the motion.

    Args:
        phase_per_w: phases per 1/e² radius of the footprint, in radians.
        beamlets: beamlets of the pattern, at least 7.
    """
    offset_w, _ = beamlet_pattern(beamlets)
    spacing_w = hypot(*offset_w[1])
    shells = 4.0 * pi / (sqrt(3.0) * spacing_w) * _SHELLS
    apart = np.abs(np.asarray(phase_per_w)[..., None] - shells).min(axis=-1)
    return np.asarray(np.exp(-(apart**2) / 16.0))


def enough_beamlets(instrument: Instrument, echoes: Echoes, spread: Spread, variance_bin2: FloatArray) -> int:
    """The instrument's beamlets, or the next larger pattern whose `common_share` is allowed; 127 at most."""
    asked = instrument.optics.beamlets
    for beamlets in (count for count in _COUNTS if count >= asked):
        if common_share(instrument, echoes, spread, variance_bin2, beamlets) <= ALLOWED_SHARE:
            return beamlets
    return _COUNTS[-1]
