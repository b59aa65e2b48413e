"""Forecast of an instrument's detection probability over a site.

The vehicle hovers upright over a level plane of the site's surface. The forecast follows from the receiver's mean
signal-to-noise ratio (`coherent_power_w`, `build_receiver`), less the losses by window, straddling, poles and the
laser's linewidth. Motion and slopes cause further losses.

In a chirp the surface's echo fades, so that the power of its bin is exponential around its mean m; the bins of the haze
before it are exponential around theirs, and none of them exceeds p with the probability F(p). The highest bin is one of
the haze's, above the threshold T, with the probability

    ∫ from T of (1 - exp(-p/m)) dF(p).

Noise adds to both means.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from lidar_emu.beams.patterns import build_scanner, mounting_rotation, off_axis_rad
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.numerics.vector_arrays import rotate
from lidar_emu.receiver.analog_response import noise_level, tone_gain
from lidar_emu.receiver.laser_phase_noise import line_share
from lidar_emu.receiver.link_budget import coherent_power_w
from lidar_emu.receiver.probability import (
    detection_probability,
    false_lock_probability,
    log_false_alarm,
    nodes_and_weights,
    shared_fade_probability,
)
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Echoes
from lidar_emu.receiver.spectrum import WINDOWS, SpectralWindow, fold
from lidar_emu.receiver.volume_light import haze_snr
from lidar_emu.scenario.instrument import Detection
from lidar_emu.scenario.schema import FlightScenario


@dataclass(frozen=True)
class DetectionForecast:
    """Probabilities per beam angle and altitude; arrays are (angles, altitudes) where no shape is given.

    All are NaN where the beam does not point down, or where the ground is beyond the maximum range. Speckle power is
    exponential and independent from look to look.
    """

    altitude_m: FloatArray
    """(altitudes,)"""
    angle_deg: FloatArray
    """(angles,) Beam angles from nadir in all patterns, ascending and distinct."""
    range_m: FloatArray
    snr_db: FloatArray
    """Mean power of the highest windowed bin over the mean noise power in that bin, for one look."""
    segment_steady: FloatArray
    """Detection probability of one segment without fading."""
    segment_speckle: FloatArray
    """Detection probability of one segment in speckle."""
    measurement_steady: FloatArray
    """Probability that the instrument's detection rule is met, without fading."""
    measurement_shared: FloatArray
    """Probability that the rule is met in speckle that the three segments share, as in hover."""
    measurement_independent: FloatArray
    """Probability that the rule is met in speckle that is independent between segments, as in fast flight."""
    false_lock_steady: FloatArray
    """Probability that a noise bin is the strongest bin of a segment and above the threshold, without fading."""
    false_lock_speckle: FloatArray
    """Probability of a false lock of a segment in speckle."""
    false_alarm: float
    """Probability that noise alone exceeds the threshold in a segment."""
    minus_log_pfa: float
    """Negative logarithm of the false-alarm probability of a single bin."""
    window_loss_db: float
    """Mean loss by window and straddling, relative to a tone centred on a bin without a window."""
    speckle: bool
    """Whether the scenario's echoes fade."""


def forecast_detection(scenario: FlightScenario, altitude_m: FloatArray) -> DetectionForecast:
    """Forecast detection at altitudes (altitudes,) of the sensor above the plane.

    Raises:
        InputError: the instrument's receiver is not realisable (`build_receiver`).
    """
    instrument, site = scenario.instrument, scenario.site
    detection = instrument.detection
    angle_deg = beam_angles_deg(scenario)
    cosine = np.cos(np.radians(angle_deg))[:, None]
    range_m = altitude_m / np.where(cosine > 1e-9, cosine, np.nan)
    range_m[range_m > detection.maximum_range_m] = np.nan
    gain = mean_straddling_gain(WINDOWS[detection.window])
    power_w = coherent_power_w(instrument, site.surface, site.atmosphere, range_m, cosine)
    model = build_receiver(instrument, site)
    kept = np.vectorize(partial(_kept_share, model), otypes=[float])(range_m)
    snr = power_w * model.snr_per_w * gain * kept
    bins = instrument.waveform.fft_length / 2
    minus_log_pfa = -instrument.log_false_alarm_per_bin
    looks = detection.looks
    rule = partial(rule_probability, detection)
    steady = detection_probability("steady", snr, minus_log_pfa, looks)
    speckle = detection_probability("swerling_2", snr, minus_log_pfa, looks)
    with np.errstate(divide="ignore"):
        snr_db = 10.0 * np.log10(snr)
    return DetectionForecast(
        altitude_m=altitude_m,
        angle_deg=angle_deg,
        range_m=range_m,
        snr_db=snr_db,
        segment_steady=steady,
        segment_speckle=speckle,
        measurement_steady=rule(steady),
        measurement_shared=shared_fade_probability(rule, snr, minus_log_pfa, looks),
        measurement_independent=rule(speckle),
        false_lock_steady=false_lock_probability("steady", snr, minus_log_pfa, bins, looks),
        false_lock_speckle=false_lock_probability("swerling_2", snr, minus_log_pfa, bins, looks),
        false_alarm=float(np.exp(log_false_alarm(minus_log_pfa, bins))),
        minus_log_pfa=minus_log_pfa,
        window_loss_db=float(-10.0 * np.log10(gain)),
        speckle=instrument.optics.speckle,
    )


def _kept_share(model: ReceiverModel, range_m: float) -> float:
    """Factor of the SNR by the laser's linewidth and the receiver's poles, at the range's beat frequency alone."""
    beat = model.beat_bin_per_m * range_m
    if not np.isfinite(beat):
        return np.nan
    observed_bin, _, _ = interpreted(fold)(beat, model.fft_length)
    # The Doppler shift moves the three beats, so that a beat below the AC coupling is rare: it is neglected.
    response = model.response._replace(highpass_bin=0.0)
    gain_re, gain_im = interpreted(tone_gain)(response, beat)
    level = interpreted(noise_level)(
        response, 1.0, 1.0, 0.0, observed_bin, np.sin(np.pi * observed_bin / model.fft_length)
    )
    return float(interpreted(line_share)(model, range_m) * (gain_re**2 + gain_im**2) / level)


def rule_probability(detection: Detection, segment: FloatArray) -> FloatArray:
    """Probability that the detection rule is met if the three segments are detected independently."""
    if detection.rule == "any_two":
        return segment**2 * (3.0 - 2.0 * segment)
    return segment**3


def beam_angles_deg(scenario: FlightScenario) -> FloatArray:
    """List the angles of the published beams of all patterns from body z, which is nadir for an upright vehicle.

    A scan contributes its ends and its middle.
    """
    scanner = build_scanner(scenario.scanner)
    sets = scanner.published_sensor.reshape(-1, scanner.steps, scanner.beam_count, 3)
    body = rotate(mounting_rotation(scenario.mounting), sets[:, [0, scanner.steps // 2, -1]])
    angle_deg = np.round(np.degrees(off_axis_rad(body)), 6)
    return np.unique(angle_deg[~np.isnan(angle_deg)])


def mean_straddling_gain(window: SpectralWindow) -> float:
    """Mean gain of the highest windowed bin over tone positions, relative to a centred tone without a window.

    Both powers are relative to their mean noise power. A tone δ bins off centre has the amplitude sinc(δ) [c - 2 s δ² /
    (1 - δ²)] for a window with the centre tap c and the side taps s.
    """
    offset, weight = nodes_and_weights(np.array([0.0, 0.5]))
    amplitude = np.sinc(offset) * (window.centre - 2.0 * window.side * offset**2 / (1.0 - offset**2))
    return float((amplitude**2 * weight).sum() / (0.5 * window.noise_power))


_PARTS, _POWERS = 64, 400
_BEAMS = 64
"""Beams of the sample for which the probability is computed."""


def haze_lock_probability(model: ReceiverModel, range_m: FloatArray, snr: FloatArray) -> FloatArray:
    """Probability (beams,) that haze is the highest target of a chirp, with one look and a flat receiver.

    Args:
        model: constants of the receiver.
        range_m, snr: (beams,) range of the surface, and its mean power in its bin.
    """
    growth = np.log1p(
        20.0 * range_m * (2.0 * model.haze.extinction_per_m + 1.0 / model.haze.rayleigh_range_m)
    )
    place = (np.arange(_PARTS) + 0.5) / _PARTS
    rise_m = range_m / np.expm1(growth)
    r = rise_m[:, None] * np.expm1(growth[:, None] * place)
    bins = (r + rise_m[:, None]) * growth[:, None] / _PARTS * model.beat_bin_per_m * model.independent_share
    spread = 1.0 + np.square(r / model.haze.rayleigh_range_m)
    density = model.haze.snr_per_m / model.beat_bin_per_m * np.exp(-2.0 * model.haze.extinction_per_m * r)
    mean = 1.0 + density / spread
    highest = mean.max(axis=1) * (30.0 + np.log(bins.sum(axis=1)))
    power = model.threshold + np.linspace(0.0, 1.0, _POWERS) * highest[:, None]
    below = np.exp(np.sum(bins[..., None] * np.log1p(-np.exp(-power[:, None, :] / mean[..., None])), axis=1))
    middle = 0.5 * (power[:, 1:] + power[:, :-1])
    stronger = -np.expm1(-middle / (1.0 + snr[:, None]))
    return np.asarray(np.sum(np.diff(below, axis=1) * stronger, axis=1))


def largest_haze_locks(model: ReceiverModel, echoes: Echoes) -> tuple[float, float]:
    """Largest probabilities that haze is the highest target of a chirp and of the constant segment.

    In the constant segment it is one line of exponential power, on the surface's own unless wind parts them.

    Args:
        model: constants of the receiver.
        echoes: sampled along a flight, with one beamlet per beam.
    """
    window = model.window
    lit = (echoes.range_m[..., 0] > 0.0) & (echoes.range_m[..., 0] < model.record_edge_range_m)
    if not lit.any():
        return 0.0, 0.0
    chosen = np.unique(np.linspace(0, np.count_nonzero(lit) - 1, _BEAMS).astype(int))
    range_m, power_w = echoes.range_m[..., 0][lit][chosen], echoes.power_w[..., 0][lit][chosen]
    snr = power_w * model.snr_per_w * mean_straddling_gain(window)
    chirp = float(haze_lock_probability(model, range_m, snr).max())
    line = np.vectorize(partial(interpreted(haze_snr), model), otypes=[float])(range_m)
    apart = np.abs(echoes.air_speed_mps - echoes.closing_speed_mps[..., 0])[lit][chosen] > model.speed_bin_mps
    return chirp, float(np.max(np.where(apart, line / (line + power_w * model.snr_per_w), 0.0)))
