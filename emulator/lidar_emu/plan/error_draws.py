"""Draws of one beam's errors by source, by Monte Carlo over the sources' distributions.

Scatterers with circular Gaussian amplitudes E fill a Gaussian footprint. Beside the axis's, a scatterer has the beat β of
range and the Doppler shift δ; both are normal, by the slope, the motion and the roughness of the ground. At the time t,
in records, and the optical frequency o, in sweeps of a record, a beam receives

    a = Σ E exp(2πj (o β - t δ)),

from which all records of a measurement follow, with their correlation. A record has 16 samples of it around its beat,
with white noise. In a narrow footprint its frequency is off by a ratio of Gaussian numbers, Student's t with two degrees
of freedom, which has no variance; so is noise in a fading record. What is not detected, and the width of a bin, limit
them. The laser's line turns the
phase of each sample by white noise of 2πΔντ², as it does where the delay τ is short against a record; sweep and ripple
move a record's beat by their variances.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.beams.flight import Flight
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.plan.expected_error import BeamErrors
from lidar_emu.plan.motion import exchange_bin2
from lidar_emu.receiver.echoes import compute_echoes
from lidar_emu.receiver.peak_interpolation import ABOUTANIOS_MULGREW, BIN_CENTRE, CRAMER_RAO_BIN2, EFFICIENCY
from lidar_emu.receiver.range_speed_estimation import LEAST_SQUARES
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import TRAVEL
from lidar_emu.receiver.speckle_variance import COMMON_LINE_BINS, EXCESS_FACTOR, LEAST_EXCESS, NOISE_SHARE
from lidar_emu.receiver.stated_variance import line_bin2, line_noise
from lidar_emu.receiver.vibration import vibration_variances
from lidar_emu.scenario.schema import FlightScenario

BEAT_SOURCES = "quantisation", "noise", "speckle", "roughness", "line", "sweep", "ripple"
"""Sources that move the three beats, in the order of `Draws.by_source`."""

ComplexArray = NDArray[np.complex128]

_BEATS = np.array([[1.0, -1.0], [0.0, 1.0], [1.0, 1.0]])
"""Signed beats of the segments in terms of the beat of range and the Doppler shift."""
_SWEEPS = np.array([1.0, 0.0, -1.0])[:, None, None]
"""Direction of the laser's sweep in the segments."""
_CHIRPS = np.abs(_SWEEPS)
_SAMPLES = 16
_TIME = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
"""Times of the samples in a record."""
_BINS = np.arange(-3, 4)
"""Bins around a tone in which its peak is sought."""
_ITERATIONS = 3
_SINE, _COSINE = np.sin(np.pi * _TIME) / _SAMPLES, np.cos(np.pi * _TIME) / _SAMPLES
_SLOPE = _COSINE.sum() / (2.0 * np.pi * _TIME @ _SINE)
"""Frequency of a tone per ratio of its transforms half a bin to either side, their difference over their sum."""
_HALF_BIN_EFFICIENCY = np.pi**4 / 96.0
"""Variance of a frequency by half bins over the Cramér-Rao bound (Aboutanios and Mulgrew, 2005)."""
_PLACES_BIN = 64.0
"""Bins over which the places of the beats are drawn."""
_UNSEEN = 1e9
"""Variance in bins squared of a beat that is not detected."""
_BEAMLETS = 7
_AT_ONCE = 5_000


class BeamSources(NamedTuple):
    """What the draws of a beam need; frequencies in bins."""

    looks: int
    snr: FloatArray
    """(3,) Mean power of a tone over the noise, one look."""
    beats_bin: FloatArray
    """(3,) Beats on the axis."""
    truth_bin: FloatArray
    """(2,) Range and closing speed in bins."""
    compensated_bin: FloatArray
    """(2,) Systematic error that the instrument subtracts."""
    drift_bin: FloatArray
    """(3,) Change of the beats from look to look."""
    beat_bin: FloatArray
    """(4,) β of an rms footprint along each of its axes; the last one is the exchange of scatterers by motion."""
    doppler_bin: FloatArray
    """(4,) δ, likewise."""
    rough_bin: float
    """Standard deviation of β by roughness."""
    place: tuple[FloatArray, FloatArray]
    """(3, looks) Optical frequency o and time t at the centre of each record."""
    line_rad: float
    """Standard deviation of a sample's phase by the laser's line."""
    line_bin: float
    """Standard deviation of the beats by the line, as the instrument knows it, one look."""
    sweep_bin: FloatArray
    """(3,) Standard deviation of the beats by errors of the sweep, one look."""
    ripple_bin: float
    """Amplitude of the chirps' beats by the ripple, one look."""
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
    instrument, waveform = scenario.instrument, scenario.instrument.waveform
    model = build_receiver(instrument, scenario.site)
    echoes, law, looks = errors.echoes, model.variance_law, instrument.detection.looks
    range_bin = float(errors.hits.range_m[0, b]) / model.range_bin_m
    # Several beamlets have Doppler shifts of their own: what moves is the footprint over the ground.
    moving = compute_echoes(instrument, scenario.site, flight, _BEAMLETS, errors.pointing, errors.hits)
    exchange_bin = float(np.sqrt(exchange_bin2(instrument, moving.speckle_motion[..., TRAVEL])[0, b]))
    out_of_phase, in_phase = interpreted(line_noise)(
        law.line_rate, law.line_rate * law.delay_per_bin * range_bin
    )
    units = np.array([model.range_bin_m, model.speed_bin_mps])
    rates = np.array([echoes.range_rate_mps[0, b, 0], echoes.closing_acceleration_mps2[0, b]]) / units
    cycle, segment = model.cycle_records, model.segment_records
    time = (np.arange(3) - 1.0)[:, None] * segment + (np.arange(looks) - 0.5 * (looks - 1)) * cycle
    optical = np.broadcast_to(np.array([-0.5, 0.0, 0.5 - segment])[:, None], time.shape)
    variances = vibration_variances(scenario.vibration, instrument)[:2]
    return BeamSources(
        looks=looks,
        snr=errors.segment_snr[:, 0, b],
        beats_bin=errors.beats_bin[:, 0, b],
        truth_bin=errors.truth[:, 0, b] / units,
        compensated_bin=errors.compensated[:, 0, b] / units,
        drift_bin=_BEATS @ (rates * waveform.cycle_time_s),
        beat_bin=np.array([*errors.spread.beat[0, b], 0.0]),
        doppler_bin=np.array([*errors.spread.doppler[0, b], exchange_bin]),
        rough_bin=float(np.asarray(errors.spread.rough_bin)[0, b]),
        place=(optical, time),
        line_rad=float(np.sqrt(_SAMPLES * law.line_rate) * law.delay_per_bin * range_bin),
        line_bin=float(np.sqrt(looks * interpreted(line_bin2)(law, out_of_phase, in_phase))),
        sweep_bin=np.sqrt(looks) * range_bin * np.array(law.sweep_share),
        ripple_bin=float(
            np.sqrt(2.0 * looks) * law.ripple_bin * np.sin(np.pi * law.ripple_turns * range_bin)
        ),
        vibration=np.sqrt(variances @ np.square(flight.published_body(errors.pointing)[0, b])),
    )


def draw_errors(model: ReceiverModel, beam: BeamSources, count: int, seed: int) -> Draws:
    """Draw `count` measurements of a beam, as many as are detected of them."""
    random = np.random.default_rng(seed)
    mixing = record_mixing(beam) if model.speckle else None
    at_once = max(1, _AT_ONCE // beam.looks)
    sizes = [min(at_once, count - first) for first in range(0, count, at_once)]
    blocks = [_draw_block(model, beam, mixing, size, random) for size in sizes]
    error, motion, by_source, beats, detected = (
        np.concatenate(parts, axis=-1) for parts in zip(*blocks, strict=True)
    )
    return Draws(error, motion, by_source, beats, float(detected.mean()))


def record_mixing(beam: BeamSources) -> ComplexArray:
    """Matrix that makes the samples (2, 3, looks, samples) of all records, on smooth and on rough ground, of as many
    independent circular numbers as it has columns."""
    optical, time = (centre[..., None] for centre in beam.place)
    optical, time = optical + _SWEEPS * _TIME, time + _TIME
    _, size, turned = np.linalg.svd(np.stack([beam.beat_bin, beam.doppler_bin], axis=1), full_matrices=False)
    # Steps that no phase turns by half a cycle, so that no correlation returns.
    longest = size.max() * max(np.ptp(optical), np.ptp(time)) + 1e-9
    nodes = np.linspace(-4.0, 4.0, 1 + int(np.ceil(8.0 / min(0.5, 0.4 / longest))))
    share = np.exp(-0.5 * nodes**2) / np.exp(-0.5 * nodes**2).sum()
    depth, depth_share = np.polynomial.hermite_e.hermegauss(7 if beam.rough_bin > 0.0 else 1)
    first, second, rough = (axis.ravel() for axis in np.meshgrid(nodes, nodes, depth, indexing="ij"))
    power = share[:, None, None] * share[:, None] * depth_share / depth_share.sum()
    beat, doppler = turned.T @ (size[:, None] * np.stack([first, second]))
    rows = [
        np.exp(2j * np.pi * (np.multiply.outer(optical, beats) - np.multiply.outer(time, doppler)))
        for beats in (beat, beat + beam.rough_bin * rough)
    ]
    fields = np.stack(rows).reshape(-1, first.size) * np.sqrt(power.ravel())
    vectors, strength, _ = np.linalg.svd(fields, full_matrices=False)
    return np.asarray((vectors * strength)[:, strength > 1e-6])


def _draw_block(
    model: ReceiverModel,
    beam: BeamSources,
    mixing: ComplexArray | None,
    count: int,
    random: np.random.Generator,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
    """The arrays of `Draws`, and whether a measurement is detected."""
    shape = 3, beam.looks, count
    places = random.uniform(-0.5 * _PLACES_BIN, 0.5 * _PLACES_BIN, (2, count))
    tone = beam.beats_bin[:, None] + _BEATS @ places
    phase_rad = beam.line_rad * random.standard_normal((_SAMPLES, *shape))
    by_laser = {
        "line": _SLOPE / _COSINE.sum() * np.tensordot(_SINE, phase_rad, axes=1),
        "sweep": beam.sweep_bin[:, None, None] * random.standard_normal(shape),
        "ripple": _CHIRPS * beam.ripple_bin * np.sin(2.0 * np.pi * random.random(shape)),
    }
    look = np.arange(beam.looks) - 0.5 * (beam.looks - 1)
    shift = by_laser["sweep"] + by_laser["ripple"] + beam.drift_bin[:, None, None] * look[:, None]
    turns = np.multiply.outer(_TIME, (tone - np.rint(tone))[:, None] + shift)
    # The loss by the line is in the signal-to-noise ratio.
    turned = np.exp(1j * (2.0 * np.pi * turns + phase_rad) + 0.5 * beam.line_rad**2)
    smooth, rough = _fields(shape, mixing, random) * turned
    noise = _circular((_SAMPLES, *shape), random) * np.sqrt(_SAMPLES / beam.snr)[:, None, None]
    # Peaks are found by half bins of the whole record; other formulas, and half bins of 13 bins, have more noise.
    method = model.peak_method
    efficiency = EFFICIENCY[ABOUTANIOS_MULGREW if method == BIN_CENTRE else method]
    extra = np.sqrt(efficiency / _HALF_BIN_EFFICIENCY)
    highest, above = _highest(model, beam, rough + noise)
    found, rate, power = _peak(rough + extra * noise, highest)
    without_noise, _, _ = _peak(rough, highest)
    on_smooth = without_noise if beam.rough_bin == 0.0 else _peak(smooth, highest)[0]

    weight = power / power.sum(axis=1, keepdims=True)
    parts = {name: (weight * moved).sum(axis=1) for name, moved in by_laser.items()}
    parts["noise"] = found - without_noise
    parts["roughness"] = without_noise - on_smooth
    parts["speckle"] = on_smooth - (tone - np.rint(tone)) - sum(parts[name] for name in by_laser)
    parts["quantisation"] = highest - found if method == BIN_CENTRE else np.zeros_like(found)
    moved = np.stack([parts[name] for name in BEAT_SOURCES])

    noise_bin2 = efficiency * CRAMER_RAO_BIN2 / (beam.snr[:, None] * power.sum(axis=1))
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


def _fields(
    shape: tuple[int, int, int], mixing: ComplexArray | None, random: np.random.Generator
) -> ComplexArray:
    """Samples (2, samples, 3, looks, n) of the field on smooth and on rough ground, by the phase of signed beats."""
    if mixing is None:
        return np.ones((2, _SAMPLES, *shape), dtype=np.complex128)
    drawn = mixing @ _circular((mixing.shape[1], shape[-1]), random)
    fields = np.moveaxis(drawn.reshape(2, *shape[:2], _SAMPLES, shape[-1]), 3, 1)
    # The beats of the constant segment and of the down-chirp are those of falling phases.
    fields[:, :, 1:] = fields[:, :, 1:].conj()
    return np.asarray(fields)


def _circular(shape: tuple[int, ...], random: np.random.Generator) -> ComplexArray:
    """Circular Gaussian numbers of unit power."""
    return np.asarray(np.sqrt(0.5) * (random.standard_normal(shape) + 1j * random.standard_normal(shape)))


def _highest(model: ReceiverModel, beam: BeamSources, records: ComplexArray) -> tuple[FloatArray, BoolArray]:
    """Highest bin (3, n) from the one nearest to the beat, and whether its power exceeds the threshold."""
    window = model.window.centre - 2.0 * model.window.side * np.cos(2.0 * np.pi * _TIME)
    filters = window * np.exp(-2j * np.pi * np.outer(_BINS, _TIME)) / _SAMPLES
    power = np.square(np.abs(np.tensordot(filters, records, axes=1))).mean(axis=2)
    over_noise = power.max(axis=0) * beam.snr[:, None] / model.noise_power
    return _BINS[power.argmax(axis=0)].astype(float), over_noise > model.threshold


def _peak(records: ComplexArray, highest: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequency by half bins (3, n), the rate of the logarithm of the amplitude there in bins, and the power of each
    look (3, looks, n); see `receiver.peak_interpolation`."""
    found = highest
    for _ in range(_ITERATIONS):
        turned = records * np.exp(-2j * np.pi * np.multiply.outer(_TIME, found))[:, :, None]
        difference = np.tensordot(_SINE, turned, axes=1)
        total = np.tensordot(_COSINE, turned, axes=1)
        power = np.square(np.abs(total))
        ratio = (difference * total.conj()).sum(axis=1) / power.sum(axis=1)
        found = np.clip(found + _SLOPE * ratio.imag, highest - 1.0, highest + 1.0)
    return found, _SLOPE * ratio.real, power / _COSINE.sum() ** 2


def _stated_bin2(beam: BeamSources, rate_bin: FloatArray, noise_bin2: FloatArray) -> FloatArray:
    """(3, n) Variances of the beats by which the instrument weighs them: of its laser, of noise, and of what the rates of
    the logarithm of the amplitude (3, n) show of speckle; see `receiver.speckle_variance.one_look`."""

    def beyond_noise(*weights: float) -> FloatArray:
        square = np.square(np.tensordot(weights, rate_bin, axes=1))
        return np.maximum(square - np.tensordot(np.square(weights), noise_bin2, axes=1), 0.0)

    harmonic = 3.0 / (1.0 / noise_bin2).sum(axis=0)
    line_bin2 = 2.0 * (beyond_noise(1 / 3, 1 / 3, 1 / 3) + beyond_noise(1.0, -2.0, 1.0) / 6.0)
    common = COMMON_LINE_BINS**2 / (COMMON_LINE_BINS**2 + line_bin2)
    over_noise = (rate_bin**2 / noise_bin2).mean(axis=0)
    by_motion = over_noise - common * beyond_noise(-0.5, 0.0, 0.5) / (1.5 * harmonic)
    excess = EXCESS_FACTOR * (1.0 - common) * np.maximum(by_motion - LEAST_EXCESS, 0.0)
    laser = beam.line_bin**2 + np.square(beam.sweep_bin) + 0.5 * np.square(_CHIRPS.ravel() * beam.ripple_bin)
    return np.asarray((NOISE_SHARE + excess) * noise_bin2 + laser[:, None] / beam.looks)


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
