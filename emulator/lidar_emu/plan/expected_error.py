"""Expected errors of a flight's measurements, from closed forms.

For sampled shots along the flight and each beam, the model computes the mean signal-to-noise ratio; the bias by motion
within a measurement and by a chirp slope error, from the three segments' beats combined as the instrument does; and the
variance of each segment's frequency by bin width, noise, laser phase drift over the delay, and speckle, which moves the
peak within a footprint that spreads over part of a bin, and weighs the looks. It neglects false locks and relief within
a footprint.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.beams.pointing import Pointing
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.plan.detection_forecast import mean_straddling_gain, rule_probability
from lidar_emu.plan.motion import exchange_bin2, grown_beam_drift_per_s
from lidar_emu.plan.spectral_spread import Spread, no_spread, rough_bins, spread_bins
from lidar_emu.receiver.analog_response import noise_level, tone_gain
from lidar_emu.receiver.beat_tones import signed_bin
from lidar_emu.receiver.echoes import compute_echoes
from lidar_emu.receiver.laser_phase_noise import line_share
from lidar_emu.receiver.link_budget import snr_per_w
from lidar_emu.receiver.motion_errors import build_motion_errors, motion_error
from lidar_emu.receiver.peak_interpolation import PEAK_METHODS, noise_bin2, rounding_bin2
from lidar_emu.receiver.probability import (
    Fading,
    detection_probability,
    gamma_tail,
    shared_fade_probability,
)
from lidar_emu.receiver.range_speed_estimation import BEAT_WEIGHTS, COMBINE_METHODS
from lidar_emu.receiver.received_echoes import delay_echoes
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import TRAVEL, Echoes
from lidar_emu.receiver.speckle_field import PITCH_W
from lidar_emu.receiver.speckle_variance import BENT_OFFSET, centre_wander, record_correlation
from lidar_emu.receiver.spectrum import BIN_VARIANCE, WINDOWS, fold
from lidar_emu.receiver.stated_variance import line_bin2, line_noise, sweep_bin2_at
from lidar_emu.receiver.vibration import vibration_variances
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.scene.ray_hits import Hits

_SAMPLED_SHOTS = 128
_NODES = 33


@dataclass(frozen=True)
class ExpectedError:
    """Errors of a flight's valid measurements without false locks."""

    range_rms_m: float
    range_bias_m: float
    speed_rms_mps: float
    speed_bias_mps: float
    dropout: float
    """Share of the beams that fire at the ground without a valid measurement."""

    def to_json(self) -> dict[str, float | None]:
        """Convert to JSON values, with null for unknown errors."""
        return {name: value if np.isfinite(value) else None for name, value in asdict(self).items()}


class BeamErrors(NamedTuple):
    """Errors of the beams of sampled shots without false locks; arrays are (shots, beams) where no shape is given."""

    pointing: Pointing
    hits: Hits
    echoes: Echoes
    """Echoes of the axes, one beamlet a beam."""
    beats_bin: FloatArray
    """(3, shots, beams) Signed beats at the centres of the three records."""
    segment_snr: FloatArray
    """(3, shots, beams) Mean power of each segment's tone over the noise at its bin."""
    snr: FloatArray
    """Their geometric mean."""
    spread: Spread
    truth: FloatArray
    """(2, shots, beams) Range in metres and closing speed in metres per second on the axis."""
    compensated: FloatArray
    """(2, shots, beams) Errors that the instrument subtracts."""
    bias: FloatArray
    """(2, shots, beams) Mean errors of range in metres and of closing speed in metres per second."""
    sigma: FloatArray
    """(2, shots, beams) Standard deviations, likewise."""
    detected: FloatArray
    """Probability of a valid measurement."""
    expected: BoolArray
    """Whether the beam fires at the ground."""


def beam_errors(
    scenario: FlightScenario, flight: Flight, beamlets: int, sampled_shots: int = _SAMPLED_SHOTS
) -> BeamErrors:
    """Compute the errors of the beams of shots sampled along a flight, with this number of beamlets per beam."""
    count = min(sampled_shots, flight.shot_count)
    shot = np.linspace(0, flight.shot_count - 1, count).astype(np.int64)
    return errors_of_shots(scenario, flight, beamlets, shot)


def errors_of_shots(
    scenario: FlightScenario, flight: Flight, beamlets: int, shot: NDArray[np.int64]
) -> BeamErrors:
    """Compute the errors of the beams of these shots, with this number of beamlets per beam."""
    instrument, site = scenario.instrument, scenario.site
    pointing, _ = flight.point(shot, flight.scanner.initial)
    hits = flight.cast(pointing)
    echoes = compute_echoes(instrument, site, flight, 1, pointing, hits)
    truth = np.stack([echoes.range_m[..., 0], echoes.closing_speed_mps[..., 0]])
    delay_echoes(echoes)
    model = build_receiver(instrument, site, scenario.left_out_share)
    spread = spread_bins(instrument, pointing, hits) if beamlets > 1 else no_spread(hits)
    spread = spread._replace(rough_bin=rough_bins(instrument, site, pointing, hits))

    beats = _beats_bin(instrument, model, echoes)
    segment_snr = _segment_snr(model, hits, echoes, beats)
    with np.errstate(divide="ignore"):
        snr: FloatArray = np.exp(np.log(segment_snr).mean(axis=0))
    segments = _segment_variances_bin2(instrument, model, hits, snr)
    weights = _beat_weights(model, echoes, segments)
    units = np.array([model.range_bin_m, model.speed_bin_mps])[:, None, None]
    vibrating = vibration_variances(scenario.vibration, instrument)[:2]
    by_vibration = np.moveaxis(np.square(flight.published_body(pointing)) @ vibrating.T, -1, 0)
    compensated = np.zeros_like(truth)
    if instrument.detection.compensate == "acceleration":
        motion = echoes.range_m[..., 0], echoes.closing_speed_mps[..., 0], echoes.closing_acceleration_mps2
        compensated = np.stack(interpreted(motion_error)(build_motion_errors(instrument), *motion))
    return BeamErrors(
        pointing=pointing,
        hits=hits,
        echoes=echoes,
        beats_bin=beats,
        segment_snr=segment_snr,
        snr=snr,
        spread=spread,
        truth=truth,
        compensated=compensated,
        bias=units * (weights * beats).sum(axis=1) - truth - compensated,
        sigma=np.sqrt(
            units**2
            * (
                (weights**2 * segments).sum(axis=1)
                + _wander_bin2(instrument, model, echoes, snr, spread, weights)
            )
            + by_vibration
        ),
        detected=_detection_probability(instrument, model, echoes, snr, spread),
        expected=pointing.fired & np.isfinite(hits.range_m) & ~hits.inside,
    )


def expected_error(scenario: FlightScenario, flight: Flight, beamlets: int) -> ExpectedError:
    """Compute the expected errors of a flight with this number of beamlets per beam."""
    if scenario.level == "geometric":
        return ExpectedError(0.0, 0.0, 0.0, 0.0, 0.0)
    beams = beam_errors(scenario, flight, beamlets)
    weight = np.where(beams.expected, beams.detected, 0.0)
    bias = [_mean(values, weight) for values in beams.bias]
    rms = [float(np.sqrt(_mean(b**2 + s**2, weight))) for b, s in zip(beams.bias, beams.sigma, strict=True)]
    dropout = 1.0 - _mean(beams.detected, beams.expected.astype(float))
    return ExpectedError(rms[0], bias[0], rms[1], bias[1], dropout)


def _mean(values: FloatArray, weight: FloatArray) -> float:
    known = weight > 0.0
    return float(np.average(values[known], weights=weight[known])) if known.any() else np.nan


def _beats_bin(instrument: Instrument, model: ReceiverModel, echoes: Echoes) -> FloatArray:
    beats = np.empty((3, *echoes.fired.shape))
    for segment in range(3):
        time_s = (segment - 1) * instrument.waveform.segment_time_s
        then_m = echoes.range_m[..., 0] + echoes.range_rate_mps[..., 0] * time_s
        then_mps = echoes.closing_speed_mps[..., 0] + echoes.closing_acceleration_mps2 * time_s
        for place in np.ndindex(then_m.shape):
            beats[segment][place] = interpreted(signed_bin)(
                model, segment, float(then_m[place]), float(then_mps[place])
            )
    return beats


def _segment_snr(model: ReceiverModel, hits: Hits, echoes: Echoes, beats: FloatArray) -> FloatArray:
    gain = np.full(beats.shape, np.nan)
    for place in zip(*np.nonzero(np.isfinite(beats)), strict=True):
        re, im = interpreted(tone_gain)(model.response, beats[place])
        k, _, _ = interpreted(fold)(beats[place], model.fft_length)
        level = interpreted(noise_level)(
            model.response, 1.0, 1.0, 0.0, k, np.sin(np.pi * k / model.fft_length)
        )
        gain[place] = max(re * re + im * im, 1e-30) / max(level, 1e-30)
    kept = np.vectorize(partial(interpreted(line_share), model), otypes=[float])(hits.range_m)
    return np.asarray(echoes.power_w[..., 0] * model.snr_per_w * kept * gain)


def _same_fade(instrument: Instrument, echoes: Echoes) -> FloatArray:
    """Squared correlation of the echo's field in neighbouring segments, exp(-2 d²/w0²)."""
    moved = echoes.speckle_motion[..., TRAVEL] * PITCH_W * instrument.waveform.segment_time_s
    return np.asarray(np.exp(-2.0 * moved**2))


def _detection_probability(
    instrument: Instrument, model: ReceiverModel, echoes: Echoes, snr: FloatArray, spread: Spread
) -> FloatArray:
    """Probability of a valid measurement.

    Two segments whose fields have the squared correlation ρ² fade below the threshold together with probability
    p²/(1 - ρ²), if each does so with a small probability p: the share of common losses is p/(p + 1 - ρ²).
    """
    detection = instrument.detection
    # The peak of a line of rms width s falls as 1 - π² s²/3, and as 1/s for wide lines.
    wide = np.sqrt(1.0 + 2.0 * np.pi * spread.variance(1.0, 1.0))
    seen = np.maximum(np.nan_to_num(snr * mean_straddling_gain(WINDOWS[detection.window]) / wide), 1e-6)
    segment, own, shared = _segment_probabilities(instrument, model.speckle, np.log(seen))
    lost = 1.0 - segment
    common = lost / (lost + 1.0 - _same_fade(instrument, echoes) + 1e-12)
    near: BoolArray = echoes.range_m[..., 0] <= detection.maximum_range_m
    return np.where(near, common * shared + (1.0 - common) * own, 0.0)


def _segment_probabilities(
    instrument: Instrument, speckle: bool, log_snr: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Detection probability of a segment, and of a measurement with independent and with shared fading of its segments.

    The probabilities are interpolated in a table, since each takes a millisecond to compute.
    """
    detection, minus_log_pfa = instrument.detection, -instrument.log_false_alarm_per_bin
    nodes = np.linspace(log_snr.min(), log_snr.max() + 1e-9, _NODES)
    snr = np.exp(nodes)
    rule = partial(rule_probability, detection)
    fading: Fading = "swerling_2" if speckle else "steady"
    segment = detection_probability(fading, snr, minus_log_pfa, detection.looks)
    own = rule(segment)
    shared = shared_fade_probability(rule, snr, minus_log_pfa, detection.looks) if speckle else own
    one, apart, together = (np.interp(log_snr, nodes, table) for table in (segment, own, shared))
    return one, apart, together


def _segment_variances_bin2(
    instrument: Instrument, model: ReceiverModel, hits: Hits, snr: FloatArray
) -> FloatArray:
    """(3, shots, beams) variances of the three beats that are independent from segment to segment, in bins squared."""
    looks = instrument.detection.looks
    with np.errstate(divide="ignore", over="ignore"):
        noise = interpreted(noise_bin2)(model.peak_method, snr)
    # Deep fades are not detected, and noise moves a detected peak by a bin at most.
    faintest = _faintest(instrument, snr)
    noise = _faded(noise, np.ones_like(noise), faintest, looks) if model.speckle else noise / looks
    alike = noise + interpreted(rounding_bin2)(model.peak_method)
    law, range_bin = model.variance_law, np.nan_to_num(hits.range_m) / model.range_bin_m
    swept = np.vectorize(partial(interpreted(sweep_bin2_at), law), otypes=[float])
    noise_of_line = np.vectorize(partial(interpreted(line_noise), law.line_rate), otypes=[float, float])
    line = np.vectorize(partial(interpreted(line_bin2), law), otypes=[float])
    alike = alike + line(*noise_of_line(law.line_rate * law.delay_per_bin * range_bin))
    return np.stack([alike + swept(segment, range_bin) for segment in range(3)])


def _faintest(instrument: Instrument, snr: FloatArray) -> FloatArray:
    """Intensity over its mean below which an echo is not detected."""
    with np.errstate(divide="ignore", over="ignore"):
        faintest = -instrument.log_false_alarm_per_bin / instrument.detection.looks / snr
    return np.asarray(np.minimum(faintest, 50.0))


def _wander_bin2(
    instrument: Instrument,
    model: ReceiverModel,
    echoes: Echoes,
    snr: FloatArray,
    spread: Spread,
    weights: FloatArray,
) -> FloatArray:
    """(2, shots, beams) variances of range and speed by speckle, in bins squared: within the footprint, and exchanged
    within the record."""
    faintest = _faintest(instrument, snr)
    exchange = exchange_bin2(instrument, grown_beam_drift_per_s(instrument, echoes))

    if not model.speckle:
        return np.zeros((2, *snr.shape))

    def line(beat: float, doppler: float) -> FloatArray:
        variance: FloatArray = spread.variance(beat, doppler) + doppler**2 * exchange
        return variance

    def wander(beat: float, doppler: float) -> FloatArray:
        variance = line(beat, doppler)
        most = np.maximum(variance, BIN_VARIANCE)
        return _faded(0.5 * variance, most, faintest, instrument.detection.looks)

    # Two of the three pairs of segments are neighbours.
    looks = float(instrument.detection.looks)
    decay = -np.log(np.maximum(_same_fade(instrument, echoes), 1e-300))
    alike, beside, apart = (
        interpreted(record_correlation)(looks, decay, segments) for segments in (0.0, 1.0, 2.0)
    )
    same = (2.0 * beside + apart) / 3.0
    own = np.array([wander(1.0, -1.0), wander(0.0, 1.0), wander(1.0, 1.0)])
    shared = np.array([wander(1.0, 0.0), wander(0.0, 1.0)])
    variances: FloatArray = same * shared + (alike - same) * (weights**2 * own).sum(axis=1)
    if looks == 1.0:
        return variances
    bent = BENT_OFFSET * np.array([line(1.0, -1.0), line(0.0, 1.0), line(1.0, 1.0)]) ** 2
    variances += (weights**2 * bent).sum(axis=1) + _drift_bin2(instrument, model, echoes, decay)
    return variances


def _drift_bin2(
    instrument: Instrument, model: ReceiverModel, echoes: Echoes, decay: FloatArray
) -> FloatArray:
    """(2, shots, beams) variances of range and speed that change from look to look, in bins squared, as speckle weighs
    the looks: of the mean of both chirps, and of all segments."""
    looks = float(instrument.detection.looks)
    alike, beside, apart = (
        interpreted(centre_wander)(looks, decay, segments) for segments in (0.0, 1.0, 2.0)
    )
    look_s = instrument.waveform.cycle_time_s
    range_bin = echoes.range_rate_mps[..., 0] * look_s / model.range_bin_m
    doppler_bin = echoes.closing_acceleration_mps2 * look_s / model.speed_bin_mps
    return np.stack(
        [
            0.5 * (alike + apart) * range_bin**2,
            (3.0 * alike + 4.0 * beside + 2.0 * apart) / 9.0 * doppler_bin**2,
        ]
    )


def _faded(at_mean: FloatArray, most: FloatArray, faintest: FloatArray, looks: int) -> FloatArray:
    """Mean of min(`at_mean` / z, `most`) over gamma-distributed powers z > `faintest` of mean 1 and order `looks`.

    For one look ∫ exp(-z)/z dz = E1. For M looks the mean of 1/z is M Γ(M-1, Mx) / Γ(M, Mx), and the variance is
    divided by M.
    """
    if looks > 1:
        inverse: FloatArray = (
            looks
            / (looks - 1)
            * gamma_tail(looks - 1, looks * faintest)
            / gamma_tail(looks, looks * faintest)
        )
        return np.asarray(np.minimum(at_mean / looks * inverse, most))
    with np.errstate(invalid="ignore", divide="ignore"):
        knee = np.maximum(faintest, np.nan_to_num(at_mean / most, posinf=50.0))
        below = most * -np.expm1(faintest - knee)
        mean = below + at_mean * exponential_integral(knee) * np.exp(faintest)
    return np.where(at_mean > 0.0, np.minimum(mean, most), 0.0)


_NEAR = (0.00107857, -0.00976004, 0.05519968, -0.24991055, 0.99999193, -0.57721566)
_FAR = (1.0, 8.5733287401, 18.0590169730, 8.6347608925, 0.2677737343)
_BELOW_FAR = (1.0, 9.5733223454, 25.6329561486, 21.0996530827, 3.9584969228)


def exponential_integral(x: FloatArray) -> FloatArray:
    """E1 within 2e-7 by Abramowitz and Stegun, 5.1.53 and 5.1.56: to load `scipy.special` takes as long as a run."""
    near, far = np.minimum(x, 1.0), np.maximum(x, 1.0)
    beyond = np.exp(-far) / far * np.polyval(_FAR, far) / np.polyval(_BELOW_FAR, far)
    return np.where(x < 1.0, np.polyval(_NEAR, near) - np.log(near), beyond)


def _beat_weights(model: ReceiverModel, echoes: Echoes, variances: FloatArray) -> FloatArray:
    """(2, 3, shots, beams) weights of the three signed beats, of these variances, in range and speed."""
    receding = (echoes.closing_speed_mps[..., 0] < 0.0).astype(int)
    weights = np.moveaxis(BEAT_WEIGHTS[model.combine_method][receding], (-2, -1), (0, 1)).copy()
    if model.combine_method == COMBINE_METHODS["least_squares"]:
        # The Doppler shift is the line's and half the difference of the chirps, by their variances.
        _, constant, chirp = variances
        line = chirp / (chirp + 2.0 * constant)
        weights[1] = np.array([0.5 * (line - 1.0), line, 0.5 * (1.0 - line)])
    return np.asarray(weights)


def beat_variance_bin2(scenario: FlightScenario, echoes: Echoes) -> FloatArray:
    """Variance of a beat in bins squared, (shots, beams), from echoes of one beamlet; NaN without light.

    Speckle that changes within a record makes a line of variance s², whose peak wanders by s²/2 at the mean power and
    by more in a fade. The laser's line and the slope of the ground add to the variance.
    """
    instrument = scenario.instrument
    method = PEAK_METHODS[instrument.detection.peak]
    power_w = np.where(echoes.power_w[..., 0] > 0.0, echoes.power_w[..., 0], np.nan)
    with np.errstate(divide="ignore"):
        noise = interpreted(noise_bin2)(method, snr_per_w(instrument, scenario.site) * power_w)
    variance = noise + interpreted(rounding_bin2)(method)
    if instrument.optics.speckle:
        variance += 0.5 * exchange_bin2(instrument, echoes.speckle_motion[..., TRAVEL])
    return np.asarray(variance / instrument.detection.looks)


def least_sigma(instrument: Instrument, variance_bin2: FloatArray) -> tuple[float, float]:
    """Least standard deviations of range in m and closing speed in m/s of beams whose beats have these variances; 0
    without light."""
    least = float(np.nanmin(variance_bin2, initial=np.inf))
    weights = BEAT_WEIGHTS[COMBINE_METHODS[instrument.detection.combine]]
    range_m, speed_mps = np.sqrt(least * (weights**2).sum(axis=-1).min(axis=0))
    if not np.isfinite(least):
        return 0.0, 0.0
    return float(range_m * instrument.waveform.range_bin_m), float(
        speed_mps * instrument.waveform.speed_bin_mps
    )
