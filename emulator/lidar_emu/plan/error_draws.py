"""Draws of one beam's errors by source, by Monte Carlo over the sources' distributions.

Scatterers with circular Gaussian amplitudes E fill a Gaussian footprint. Beside the axis's, a scatterer has the beat β
of range and the Doppler shift δ; both are normal, by the slope, the motion and the roughness of the ground. At the
time t, in records, and the optical frequency o, in sweeps of a record, a beam receives

    a = Σ E exp(2πj (o β - t δ)),

a circular Gaussian process, whose covariance follows from those of β and δ: the three records of a measurement are
drawn from it. A record has 16 samples of it around its beat, with white noise. In a narrow footprint its frequency is
off by a ratio of Gaussian numbers, Student's t with two degrees of freedom, which has no variance; so is noise in a
fading record. What is not detected, and the width of a bin, limit them. The laser's line turns the phase of
each sample by its change within the light's delay; the sweep's random errors move a record's beat, and its ripple turns
the phase periodically.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.beams.flight import Flight
from lidar_emu.numerics.arrays import BoolArray, ComplexArray, FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.numerics.random_streams import generator
from lidar_emu.plan.expected_error import BeamErrors
from lidar_emu.plan.motion import exchange_bin2
from lidar_emu.receiver.echoes import compute_echoes
from lidar_emu.receiver.motion_smear import smear_bins
from lidar_emu.receiver.peak_interpolation import (
    ABOUTANIOS_MULGREW,
    BIN_CENTRE,
    CRAMER_RAO_BIN2,
    EFFICIENCY,
    HANN,
    JACOBSEN,
)
from lidar_emu.receiver.range_speed_estimation import LEAST_SQUARES
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import TRAVEL
from lidar_emu.receiver.speckle_variance import COMMON_LINE_BINS, EXCESS_FACTOR, LEAST_EXCESS, NOISE_SHARE
from lidar_emu.receiver.spectrum import BIN_VARIANCE
from lidar_emu.receiver.stated_variance import line_bin2, line_noise, sweep_bin2_at
from lidar_emu.receiver.sweep_error import ripple_index
from lidar_emu.receiver.vibration import vibration_variances
from lidar_emu.scenario.schema import FlightScenario

BEAT_SOURCES = "quantisation", "noise", "speckle", "roughness", "line", "sweep", "ripple"
"""Sources that move the three beats, in the order of `Draws.by_source`."""

_BEATS = np.array([[1.0, -1.0], [0.0, 1.0], [1.0, 1.0]])
"""Signed beats of the segments in terms of the beat of range and the Doppler shift."""
_SWEEPS = np.array([1.0, 0.0, -1.0])[:, None]
"""Direction of the laser's sweep in the segments."""
_SAMPLES = 16
_TIME = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
"""Times of the samples in a record."""
_BINS = np.arange(-3, 4)
"""Bins around a tone in which its peak is sought."""
_SINE, _COSINE = np.sin(2.0 * np.pi * _TIME), np.cos(2.0 * np.pi * _TIME)
_THREE_BINS = {
    JACOBSEN: (_SINE, 1.0 + _COSINE),
    HANN: (_SINE * (1.0 + _COSINE), _SINE**2),
}
"""Weights of the difference of the two bins beside the highest one, and of the sum of all three with their signs."""
_HALF_BINS = np.sin(np.pi * _TIME), np.cos(np.pi * _TIME)
"""The same of the transforms half a bin to either side."""
_SLOPE = _HALF_BINS[1].sum() / (2.0 * np.pi * _TIME @ _HALF_BINS[0])
"""Frequency of a tone per ratio of the latter."""
_ITERATIONS = 2
_HALF_BIN_EFFICIENCY = np.pi**4 / 96.0
"""Variance of a frequency by half bins over the Cramér-Rao bound (Aboutanios and Mulgrew, 2005)."""
_PLACES_BIN = 64.0
"""Bins over which the places of the beats are drawn."""
_UNSEEN = 1e9
"""Variance in bins squared of a beat that is not detected."""
_LEAST_VARIANCE = 1e-9
"""Variance of a component of the records below which it is left out."""
_BEAMLETS = 7
_AT_ONCE = 5_000


class BeamSources(NamedTuple):
    """What the draws of a beam need; frequencies in bins."""

    snr: FloatArray
    """(3,) Mean power of a tone over the noise."""
    beats_bin: FloatArray
    """(3,) Beats on the axis."""
    truth_bin: FloatArray
    """(2,) Range and closing speed in bins."""
    compensated_bin: FloatArray
    """(2,) Systematic error that the instrument subtracts."""
    smear_bin: FloatArray
    """(3,) Change of the beats during a record."""
    beat_bin: FloatArray
    """(4,) β of an rms footprint along each of its axes; the last one is the exchange of scatterers by motion."""
    doppler_bin: FloatArray
    """(4,) δ, likewise."""
    rough_bin: float
    """Standard deviation of β by roughness."""
    centre: tuple[FloatArray, FloatArray]
    """(3,) Optical frequency o and time t at the centre of each record."""
    line_rad2: FloatArray
    """(samples, samples) Covariance of the phases of a record's samples by the laser's line."""
    line_bin2: float
    """Variance of the beats by the line, as the instrument knows it."""
    sweep_bin: FloatArray
    """(3,) Standard deviation of the beats by random errors of the sweep."""
    sweep_bin2: FloatArray
    """(3,) Variance of the beats by these and the ripple, as the instrument knows it."""
    ripple_rad: float
    """Amplitude of the chirps' phase by the ripple."""
    ripple_turns: float
    """Periods of the ripple in a record."""
    vibration: FloatArray
    """(2,) Standard deviations of range in m and closing speed in m/s."""


class Draws(NamedTuple):
    """Errors (2, n) of range in m and closing speed in m/s, of the measurements that are detected."""

    error: FloatArray
    """By all sources and motion."""
    motion: FloatArray
    """Systematic ones by motion within a measurement, chirp slope and the light's travel time."""
    by_source: FloatArray
    """(sources, 2, n)"""
    beats_bin: FloatArray
    """(sources, 3, n) The same in the three beats, in bins."""
    detected: float
    """Share of all draws."""


def beam_sources(scenario: FlightScenario, flight: Flight, errors: BeamErrors, b: int) -> BeamSources:
    """Collect the sources of beam `b` from the errors of one shot."""
    instrument = scenario.instrument
    model = build_receiver(instrument, scenario.site)
    echoes, law, range_m = errors.echoes, model.variance_law, float(errors.hits.range_m[0, b])
    range_bin = range_m / model.range_bin_m
    # Several beamlets have Doppler shifts of their own: what moves is the footprint over the ground.
    moving = compute_echoes(instrument, scenario.site, flight, _BEAMLETS, errors.pointing, errors.hits)
    exchange_bin = float(np.sqrt(exchange_bin2(instrument, moving.speckle_motion[..., TRAVEL])[0, b]))
    drift = law.line_rate * law.delay_per_bin * range_bin
    units = np.array([model.range_bin_m, model.speed_bin_mps])
    motion = float(echoes.closing_speed_mps[0, b, 0]), float(echoes.closing_acceleration_mps2[0, b])
    segment = model.segment_records
    variances = vibration_variances(scenario.vibration, instrument)[:2]
    return BeamSources(
        snr=errors.segment_snr[:, 0, b],
        beats_bin=errors.beats_bin[:, 0, b],
        truth_bin=errors.truth[:, 0, b] / units,
        compensated_bin=errors.compensated[:, 0, b] / units,
        smear_bin=np.array([interpreted(smear_bins)(model, each, *motion) for each in range(3)]),
        beat_bin=np.array([*errors.spread.beat[0, b], 0.0]),
        doppler_bin=np.array([*errors.spread.doppler[0, b], exchange_bin]),
        rough_bin=float(np.asarray(errors.spread.rough_bin)[0, b]),
        centre=(np.array([-0.5, 0.0, 0.5 - segment]), np.array([-segment, 0.0, segment])),
        line_rad2=_line_covariance(law.line_rate, law.delay_per_bin * range_bin),
        line_bin2=float(interpreted(line_bin2)(law, *interpreted(line_noise)(law.line_rate, drift))),
        sweep_bin=range_bin * np.array(law.sweep_share),
        sweep_bin2=np.array([interpreted(sweep_bin2_at)(law, each, range_bin) for each in range(3)]),
        ripple_rad=float(interpreted(ripple_index)(model, range_m, 0.0)),
        ripple_turns=model.ripple.frequency_bin,
        vibration=np.sqrt(variances @ np.square(flight.published_body(errors.pointing)[0, b])),
    )


def _line_covariance(rate: float, delay: float) -> FloatArray:
    """The phase of the laser walks with 2πΔν = `rate`: its change within the delay has a triangular covariance, here of
    means over the samples' intervals."""
    step = 1.0 / _SAMPLES

    def mean_distance(apart: FloatArray) -> FloatArray:
        cubes = [np.abs(apart + shift) ** 3 for shift in (-step, 0.0, step)]
        return np.asarray((cubes[0] - 2.0 * cubes[1] + cubes[2]) / (6.0 * step**2))

    apart = _TIME[:, None] - _TIME
    ends = mean_distance(apart + delay) + mean_distance(apart - delay)
    return 0.5 * rate * (ends - 2.0 * mean_distance(apart))


def draw_errors(model: ReceiverModel, beam: BeamSources, count: int, seed: int) -> Draws:
    """Draw `count` measurements of a beam, as many as are detected of them."""
    random = generator(seed)
    mixing = record_mixing(beam) if model.speckle else None
    sizes = [min(_AT_ONCE, count - first) for first in range(0, count, _AT_ONCE)]
    blocks = [_draw_block(model, beam, mixing, size, random) for size in sizes]
    error, motion, by_source, beats, detected = (
        np.concatenate(parts, axis=-1) for parts in zip(*blocks, strict=True)
    )
    return Draws(error, motion, by_source, beats, float(detected.mean()))


def record_mixing(beam: BeamSources) -> FloatArray:
    """Matrix that makes the samples (fields, samples, 3) of all records, on smooth and, if it is rough, on rough
    ground, of as many independent circular numbers as it has columns.

    The covariance of two samples is exp(-d²/2), d² the variance of the difference of their phases.
    """
    optical, time = beam.centre[0] + _TIME[:, None] * _SWEEPS.T, beam.centre[1] + _TIME[:, None]
    spread = np.multiply.outer(optical, beam.beat_bin) - np.multiply.outer(time, beam.doppler_bin)
    depths_bin = (0.0, beam.rough_bin) if beam.rough_bin > 0.0 else (0.0,)
    phases = [np.concatenate([spread, depth * optical[..., None]], axis=-1) for depth in depths_bin]
    phase_rad = 2.0 * np.pi * np.concatenate(phases).reshape(-1, spread.shape[-1] + 1)
    product = phase_rad @ phase_rad.T
    square = product.diagonal()
    variances, vectors = np.linalg.eigh(np.exp(product - 0.5 * (square + square[:, None])))
    used = variances > _LEAST_VARIANCE
    return np.asarray(vectors[:, used] * np.sqrt(variances[used]))


def _draw_block(
    model: ReceiverModel,
    beam: BeamSources,
    mixing: FloatArray | None,
    count: int,
    random: np.random.Generator,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
    """The arrays of `Draws`, and whether a measurement is detected."""
    places = random.uniform(-0.5 * _PLACES_BIN, 0.5 * _PLACES_BIN, (2, count))
    tone = beam.beats_bin[:, None] + _BEATS @ places
    variances, vectors = np.linalg.eigh(beam.line_rad2)
    line_mixing = vectors * np.sqrt(np.maximum(variances, 0.0))
    line_rad = np.tensordot(line_mixing, random.standard_normal((_SAMPLES, 3, count)), axes=1)
    ripple = np.multiply.outer(beam.ripple_turns * _TIME, np.ones((3, count))) + random.random((3, count))
    ripple_rad = beam.ripple_rad * np.abs(_SWEEPS) * np.sin(2.0 * np.pi * ripple)
    by_laser = {
        "line": _by_phase(line_rad),
        "sweep": beam.sweep_bin[:, None] * random.standard_normal((3, count)),
        "ripple": _by_phase(ripple_rad),
    }
    turns = np.multiply.outer(_TIME, tone - np.rint(tone) + by_laser["sweep"])
    smear_rad = np.pi * np.multiply.outer(_TIME**2, beam.smear_bin)[..., None]
    # The loss by the line is in the signal-to-noise ratio.
    loss = 0.5 * beam.line_rad2[0, 0]
    fields = _fields(mixing, count, random) * np.exp(
        1j * (2.0 * np.pi * turns + smear_rad + line_rad + ripple_rad) + loss
    )
    smooth, rough = fields[0], fields[-1]
    noise = _circular((_SAMPLES, 3, count), random) * np.sqrt(_SAMPLES / beam.snr)[:, None]
    # Half bins here are of the whole record: those of 13 bins have more noise.
    method = ABOUTANIOS_MULGREW if model.peak_method == BIN_CENTRE else model.peak_method
    efficiency = EFFICIENCY[method]
    extra = np.sqrt(efficiency / _HALF_BIN_EFFICIENCY) if method == ABOUTANIOS_MULGREW else 1.0
    highest, above = _highest(model, beam, rough + noise)
    found, rate, power = _peak(method, rough + extra * noise, highest)
    without_noise, _, _ = _peak(method, rough, highest)
    on_smooth = without_noise if len(fields) == 1 else _peak(method, smooth, highest)[0]

    parts = dict(by_laser)
    parts["noise"] = found - without_noise
    parts["roughness"] = without_noise - on_smooth
    parts["speckle"] = on_smooth - (tone - np.rint(tone)) - sum(by_laser.values())
    parts["quantisation"] = highest - found if model.peak_method == BIN_CENTRE else np.zeros_like(found)
    moved = np.stack([parts[name] for name in BEAT_SOURCES])

    noise_bin2 = efficiency * CRAMER_RAO_BIN2 / (beam.snr[:, None] * power)
    noise_bin2 = np.where(np.abs(found - highest) > 0.75, np.maximum(noise_bin2, BIN_VARIANCE), noise_bin2)
    variance = np.where(above, _stated_bin2(beam, rate, noise_bin2), _UNSEEN)
    weights = _weights(model, tone + moved.sum(axis=0), variance)
    units = np.array([model.range_bin_m, model.speed_bin_mps])[:, None]
    by_source = units * np.einsum("qsn,psn->pqn", weights, moved)
    truth = beam.truth_bin[:, None] + places
    motion = units * ((weights * tone).sum(axis=1) - truth - beam.compensated_bin[:, None])
    shaken = beam.vibration[:, None] * random.standard_normal((2, count))
    detected = above.sum(axis=0) >= model.least_segments
    error = motion + by_source.sum(axis=0) + shaken
    return error[:, detected], motion[:, detected], by_source[..., detected], moved[..., detected], detected


def _fields(mixing: FloatArray | None, count: int, random: np.random.Generator) -> ComplexArray:
    """Samples (fields, samples, 3, n) on smooth and on rough ground, by the phase of signed beats."""
    if mixing is None:
        return np.ones((1, _SAMPLES, 3, count), dtype=np.complex128)
    drawn = mixing @ _circular((mixing.shape[1], count), random)
    fields = drawn.reshape(-1, _SAMPLES, 3, count)
    # The beats of the constant segment and of the down-chirp are those of falling phases.
    fields[:, :, 1:] = fields[:, :, 1:].conj()
    return fields


def _circular(shape: tuple[int, ...], random: np.random.Generator) -> ComplexArray:
    """Circular Gaussian numbers of unit power."""
    return np.asarray(np.sqrt(0.5) * (random.standard_normal(shape) + 1j * random.standard_normal(shape)))


def _by_phase(phase_rad: FloatArray) -> FloatArray:
    """Frequencies (3, n) by half bins of phases (samples, 3, n), to first order."""
    return np.asarray(_SLOPE / _HALF_BINS[1].sum() * np.tensordot(_HALF_BINS[0], phase_rad, axes=1))


def _highest(model: ReceiverModel, beam: BeamSources, records: ComplexArray) -> tuple[FloatArray, BoolArray]:
    """Highest bin (3, n) from the one nearest to the beat, and whether its power exceeds the threshold."""
    window = model.window.centre - 2.0 * model.window.side * np.cos(2.0 * np.pi * _TIME)
    filters = window * np.exp(-2j * np.pi * np.outer(_BINS, _TIME)) / _SAMPLES
    power = np.square(np.abs(np.tensordot(filters, records, axes=1)))
    over_noise = power.max(axis=0) * beam.snr[:, None] / model.noise_power
    return _BINS[power.argmax(axis=0)].astype(float), over_noise > model.threshold


def _peak(
    method: int, records: ComplexArray, highest: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequency (3, n) by three bins and, with that method, by half bins from there; the rate of the logarithm of the
    amplitude there in bins, and its power; see `receiver.peak_interpolation`."""
    ratio, power = _ratio(records, highest, *_THREE_BINS[JACOBSEN if method == JACOBSEN else HANN])
    offset = q = ratio.imag
    rate = ratio.real
    if method != JACOBSEN:
        offset = 4.0 * q / (3.0 + np.sqrt(9.0 + 16.0 * q * q))
        rate = rate * (1.0 - offset**2) ** 2 / (1.5 * (1.0 + offset**2))
    found = np.clip(highest + offset, highest - 1.0, highest + 1.0)
    for _ in range(_ITERATIONS if method == ABOUTANIOS_MULGREW else 0):
        ratio, power = _ratio(records, found, *_HALF_BINS)
        found = np.clip(found + _SLOPE * ratio.imag, highest - 1.0, highest + 1.0)
        rate = _SLOPE * ratio.real
    return found, rate, power


def _ratio(
    records: ComplexArray, around: FloatArray, top: FloatArray, low: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    """Ratio (3, n) of two filters around a frequency, and the power of the second."""
    turned = records * np.exp(-2j * np.pi * np.multiply.outer(_TIME, around))
    total = np.tensordot(low, turned, axes=1)
    return np.tensordot(top, turned, axes=1) / total, np.square(np.abs(total / low.sum()))


def _stated_bin2(beam: BeamSources, rate_bin: FloatArray, noise_bin2: FloatArray) -> FloatArray:
    """(3, n) Variances of the beats by which the instrument weighs them: of its laser, of noise, and of what the rates
    of the logarithm of the amplitude (3, n) show of speckle; see `receiver.speckle_variance.one_look`."""

    def beyond_noise(*weights: float) -> FloatArray:
        square = np.square(np.tensordot(weights, rate_bin, axes=1))
        by_noise = np.tensordot(np.square(weights), noise_bin2, axes=1)
        return np.asarray(np.maximum(square - by_noise, 0.0))

    harmonic = 3.0 / (1.0 / noise_bin2).sum(axis=0)
    line_bin2 = 2.0 * (beyond_noise(1 / 3, 1 / 3, 1 / 3) + beyond_noise(1.0, -2.0, 1.0) / 6.0)
    common = COMMON_LINE_BINS**2 / (COMMON_LINE_BINS**2 + line_bin2)
    over_noise = (rate_bin**2 / noise_bin2).mean(axis=0)
    by_motion = over_noise - common * beyond_noise(-0.5, 0.0, 0.5) / (1.5 * harmonic)
    excess = EXCESS_FACTOR * (1.0 - common) * np.maximum(by_motion - LEAST_EXCESS, 0.0)
    return np.asarray((NOISE_SHARE + excess) * noise_bin2 + beam.line_bin2 + beam.sweep_bin2[:, None])


def _weights(model: ReceiverModel, found: FloatArray, variance: FloatArray) -> FloatArray:
    """(2, 3, n) weights of the signed beats in range and Doppler shift, from beats (3, n) and their variances."""
    up, constant, down = variance
    zero, one = np.zeros_like(up), np.ones_like(up)
    if model.combine_method != LEAST_SQUARES:
        receding = np.abs(found[0]) > np.abs(found[2])
        return np.stack([np.where(receding, [one, one, zero], [zero, -one, one]), [zero, one, zero]])
    spread = up + 4.0 * constant + down
    residual = np.stack([-one, -2.0 * one, one])
    beat = np.stack([0.5 * one, zero, 0.5 * one]) + 0.5 * (up - down) / spread * residual
    return np.stack([beat, np.stack([zero, one, zero]) + 2.0 * constant / spread * residual])
