"""Every sample of the light of beamlets: range and speed without a beat frequency, a fold or a window's transform.

Records are sampled from the laser's phase, filtered, digitised and transformed. Echo field and signal-to-noise ratio
come from level spectral, the detector and the exhaustive estimator from level reference.

Phases are in cycles, not radians. At the time u since the start of the segment the laser's phase is φ(u) = f_a u + s
u²/2, and in the preceding segment φ(u) = f_a u + s' u²/2: its frequency is continuous. The echo of a scatterer at range
R(t) was emitted at t - τ(t), τ = 2R/c, so that the detector receives φ(u) - φ(u - τ).

This is about 1e10 cycles, and its change over the record is needed to 1e-9. Therefore only the difference from the
record's centre is computed, in expanded form: with the time x from the centre, u = u_s + x and τ = τ_s + D,

    f_a D + s [τ_s x + D (u - τ_s) - D²/2],     D = -(2/c) (v x + a x²/2),

which is exact and consists of terms in the displacement: none exceeds about 1e4 cycles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from benchmarks.echo_field import EchoField, echo_field
from lidar_emu.numerics.arrays import ComplexArray, FloatArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.receiver.exhaustive_estimation import nothing, to_beam_result, unseen
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.residual_limit import ResidualLimit
from lidar_emu.receiver.returns import RETURN_COLUMNS, Echoes, Reason, Returns
from lidar_emu.receiver.whole_spectrum import (
    Targets,
    estimator_window,
    find_targets,
    transform,
    window_noise_power,
)
from lidar_emu.reference.analog_receiver import (
    FLAT,
    AnalogResponse,
    Digitiser,
    Poles,
    draw_noise,
    noise_level,
    noise_with_echo,
)
from lidar_emu.reference.laser_sweep import (
    Segment,
    draw_drift,
    draw_frequency_plan,
    frequency_plan,
    has_phase_noise,
    laser_generator,
    record_times,
    ripple_drift,
)
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Instrument, Waveform

_PROBES = 513
"""Times at which a beamlet's instantaneous frequency is evaluated to choose its rate of synthesis."""

_BLOCK_SAMPLES = 2**23
"""Samples of noise and spectra that are held in memory at once."""


@dataclass(frozen=True)
class Beamlets:
    """The scatterer patches of one beam at the centre of one record; each stays fixed to the ground within it."""

    range_m: FloatArray
    """(n,) Ranges."""
    closing_speed_mps: FloatArray
    """(n,) Closing speeds."""
    closing_acceleration_mps2: float
    weight: ComplexArray
    """(..., n) Amplitude and phase at the record's centre; leading axes are over records of the same geometry."""
    offset_hz: FloatArray | None = None
    """(n,) Frequency that adds to the beat, for a patch whose speckle changes within the record; None: 0."""


def phase_cycles(
    segment: Segment,
    range_m: float,
    closing_speed_mps: float,
    closing_acceleration_mps2: float,
    time_s: FloatArray,
    edges: bool,
) -> FloatArray:
    """Phase of the laser less the phase of one scatterer's echo, in cycles, relative to the record's centre.

    Args:
        segment: segment of the frequency plan.
        range_m, closing_speed_mps, closing_acceleration_mps2: values at the record's centre.
        time_s: times from the record's centre.
        edges: whether light emitted before the start of the segment has the phase of the preceding segment; otherwise
            the segment is extended backwards. Delays of more than a whole segment, 45 km with the defaults, are not
            modelled.

    Returns:
        In the shape of `time_s`, with the sign of physics: `Segment.beat_sign` is not applied.
    """
    slope = segment.slope_hz_per_s
    delay_s = 2.0 * range_m / SPEED_OF_LIGHT_MPS
    approach_m = time_s * (closing_speed_mps + 0.5 * closing_acceleration_mps2 * time_s)
    growth_s = -2.0 * approach_m / SPEED_OF_LIGHT_MPS
    since_start_s = segment.start_to_centre_s + time_s
    chirped = delay_s * time_s + growth_s * (since_start_s - delay_s) - 0.5 * growth_s * growth_s
    cycles = segment.start_frequency_hz * growth_s + slope * chirped
    if edges:
        excess = 0.5 * (segment.previous_slope_hz_per_s - slope)
        left_s = since_start_s - (delay_s + growth_s)
        at_centre_s = segment.start_to_centre_s - delay_s
        cycles += excess * (_before(since_start_s) - _before(left_s) + _before(np.asarray(at_centre_s)))
    return cycles


def _before(since_start_s: FloatArray) -> FloatArray:
    """Square of the time until the segment begins, 0 once it has begun."""
    return np.square(np.minimum(since_start_s, 0.0))


def phasor(
    segment: Segment, beamlets: Beamlets, index: int, time_s: FloatArray, edges: bool = False
) -> ComplexArray:
    """exp(±j 2π [Δφ(t) - Δφ(t_s)]) of one beamlet, in the shape of `time_s`, without its weight."""
    cycles = phase_cycles(
        segment,
        float(beamlets.range_m[index]),
        float(beamlets.closing_speed_mps[index]),
        beamlets.closing_acceleration_mps2,
        time_s,
        edges,
    )
    if beamlets.offset_hz is not None:
        cycles += segment.beat_sign * beamlets.offset_hz[index] * time_s
    # Whole cycles are removed before the factor 2π rounds them.
    turn = segment.beat_sign * 2.0 * np.pi * (cycles - np.rint(cycles))
    result: ComplexArray = np.cos(turn) + 1j * np.sin(turn)
    return result


def add_beamlets(beamlets: Beamlets, phasor_of: Callable[[int], ComplexArray], count: int) -> ComplexArray:
    """Σ w_i z_i, (..., count), with the phasor z_i (count,) of beamlet i from `phasor_of`."""
    total = np.zeros((*beamlets.weight.shape[:-1], count), dtype=complex)
    for i in range(beamlets.range_m.size):
        total += beamlets.weight[..., i, None] * phasor_of(i)
    return total


def analytic_record(
    waveform: Waveform, segment: Segment, beamlets: Beamlets, edges: bool = False
) -> ComplexArray:
    """Record of one segment behind a receiver without poles, (..., N), in units of the weights.

    The samples are its real part.
    """
    time_s = record_times(waveform)
    return add_beamlets(beamlets, lambda i: phasor(segment, beamlets, i, time_s, edges), time_s.size)


def receive_record(
    waveform: Waveform,
    segment: Segment,
    beamlets: Beamlets,
    response: AnalogResponse = FLAT,
    edges: bool = False,
) -> ComplexArray:
    """The record of one segment behind the receiver's poles, without noise: (..., N), whose real part is sampled.

    The poles are applied as a product in the frequency domain, at a multiple of the sample rate at which the
    frequencies of all beamlets before folding lie within the band; every Nth sample is then kept. A run-in ahead of the
    record, in which the waveform continues as in `phase_cycles`, lets the transients decay: the bins of a steady tone
    are accurate to about 1e-9 of the peak.
    """
    if response.flat:
        return analytic_record(waveform, segment, beamlets, edges)
    every = range(beamlets.range_m.size)
    ahead_s = response.run_in(waveform.sample_rate_hz) / waveform.sample_rate_hz
    highest_hz = max(_highest_frequency(waveform, segment, beamlets, i, ahead_s, edges) for i in every)
    poles = Poles(waveform, response, highest_hz)

    def light(i: int) -> ComplexArray:
        return phasor(segment, beamlets, i, poles.time_s, edges)

    if beamlets.weight.size == beamlets.range_m.size:
        # For a single record all light passes the poles at once.
        return poles.passed(add_beamlets(beamlets, light, poles.time_s.size))
    return add_beamlets(beamlets, lambda i: poles.passed(light(i)), waveform.fft_length)


def _highest_frequency(
    waveform: Waveform, segment: Segment, beamlets: Beamlets, index: int, ahead_s: float, edges: bool
) -> float:
    """Highest frequency of one beamlet's beat, from the slope of its phase."""
    half_s = 0.5 * waveform.record_time_s
    time_s = np.linspace(-half_s - ahead_s, half_s, _PROBES)
    step_s = waveform.record_time_s / 2**20
    scatterer = (
        float(beamlets.range_m[index]),
        float(beamlets.closing_speed_mps[index]),
        beamlets.closing_acceleration_mps2,
    )
    later = phase_cycles(segment, *scatterer, time_s + step_s, edges)
    earlier = phase_cycles(segment, *scatterer, time_s - step_s, edges)
    return float(np.abs(later - earlier).max()) / (2.0 * step_s)


@dataclass(frozen=True)
class ScattererPatches:
    """The scatterer patches of one beam, at the time of validity."""

    range_m: FloatArray
    """(n,) Ranges."""
    closing_speed_mps: FloatArray
    """(n,) Closing speeds."""
    weight: ComplexArray
    """(records, 3, n) Amplitude and phase of each patch at the centre of each segment's record, broadcast. The leading
    axis is over measurements of the same geometry, each with its own weights and noise."""
    range_rate_mps: float | FloatArray | None = None
    """Range rate of the beam's axis along the ground, between segments; None: minus the closing speed."""
    closing_acceleration_mps2: float = 0.0
    """Acceleration along the moving beam."""
    closing_jerk_mps3: float = 0.0
    """Rate of the acceleration along the moving beam, from segment to segment."""
    range_curvature_mps2: float = 0.0
    """Rate of the range rate, from segment to segment."""
    offset_hz: FloatArray | None = None
    """(n,) Frequency that adds to each patch's beat, and is subtracted in the up-chirp (`receiver.speckle`); None:
    0."""

    def beamlets(self, segment: Segment, weight: ComplexArray) -> Beamlets:
        """Patches at the centre of one segment's record, with weights (..., n) there."""
        range_rate_mps = -self.closing_speed_mps if self.range_rate_mps is None else self.range_rate_mps
        time_s = segment.centre_s
        return Beamlets(
            self.range_m + (range_rate_mps + 0.5 * self.range_curvature_mps2 * time_s) * time_s,
            self.closing_speed_mps
            + (self.closing_acceleration_mps2 + 0.5 * self.closing_jerk_mps3 * time_s) * time_s,
            self.closing_acceleration_mps2,
            weight,
            None if self.offset_hz is None else -segment.beat_sign * self.offset_hz,
        )


@dataclass(frozen=True)
class WaveformMeasurement(Returns):
    """Report of one beam, (records,), with the targets and spectra that it derives from."""

    targets: tuple[Targets, Targets, Targets]
    """Targets of up-chirp, constant segment and down-chirp."""
    noise_power: FloatArray
    """() or (N/2 + 1,): mean noise power in a bin with the window of detection, as the detector assumes it."""
    threshold: FloatArray
    """Power that a detected bin exceeds, in the same shape."""


def measure_waveform(
    waveform: Waveform,
    detection: Detection,
    footprint: ScattererPatches,
    *,
    response: AnalogResponse = FLAT,
    rng: np.random.Generator | None = None,
    laser_rng: np.random.Generator | None = None,
    reflection: ScattererPatches | None = None,
    noise_share: float = 1.0,
    digitiser: Digitiser | None = None,
    noise_level: float | FloatArray = 1.0,
    residual_limit: ResidualLimit | None = None,
    edges: bool = False,
) -> WaveformMeasurement:
    """Measure one beam, once for each record of the footprint's weights.

    Squares of the footprint's weights are bin SNRs ahead of the poles, against which `noise_share` and `noise_level`
    count. Without `rng` there is no noise and no line of the laser; without `laser_rng` no error of the sweep.
    """
    count = waveform.fft_length
    weight = np.asarray(footprint.weight, dtype=complex)
    records = weight.shape[0] if weight.ndim == 3 else 1
    weight = np.broadcast_to(weight, (records, 3, footprint.range_m.size))
    level = np.asarray(noise_level, dtype=float)
    window_noise = window_noise_power(detection.window, count)
    windowed_level = level * window_noise
    threshold = windowed_level * -detection.log_false_alarm_per_bin(count)

    # A generator of its own, so that random numbers do not depend on the blocks.
    line_rng = rng.spawn(1)[0] if rng is not None and has_phase_noise(waveform) else None
    plan = frequency_plan(waveform) if laser_rng is None else draw_frequency_plan(laser_rng, waveform)
    found: list[Targets] = []
    block = max(1, _BLOCK_SAMPLES // count)
    for s, segment in enumerate(plan):
        parts: list[Targets] = []
        for first in range(0, records, block):
            rows = slice(first, first + block)
            beamlets = footprint.beamlets(segment, weight[rows, s])
            light = receive_record(waveform, segment, beamlets, response, edges)
            if line_rng is not None:
                delay_s = 2.0 * float(beamlets.range_m[0]) / SPEED_OF_LIGHT_MPS
                drift = draw_drift(line_rng, len(light), waveform, delay_s, laser_rng)
                light *= drift if segment.beat_sign > 0 else drift.conj()
            if laser_rng is not None and waveform.ripple_hz > 0.0 and segment.slope_hz_per_s != 0.0:
                delay_s = 2.0 * float(beamlets.range_m[0]) / SPEED_OF_LIGHT_MPS
                turns = laser_rng.random((len(light), 1))
                ripple = ripple_drift(waveform, delay_s, turns, record_times(waveform))
                light = light * (ripple if segment.beat_sign > 0 else ripple.conj())
            if reflection is not None:
                steady = reflection.beamlets(segment, np.asarray(reflection.weight)[..., s, :])
                light = light + receive_record(waveform, segment, steady, response)
            samples = np.ascontiguousarray(light.real)
            if rng is not None:
                samples += np.sqrt(noise_share) * draw_noise(rng, len(samples), waveform, response)
            if digitiser is not None:
                samples = digitiser.digitise(samples)
            bins = transform(samples, detection.window)
            parts.append(
                find_targets(
                    bins,
                    transform(samples, estimator_window(detection.peak)),
                    detection.peak,
                    threshold,
                    detection.group_fraction,
                    level,
                    window_noise,
                    detection.lowest_beat_hz / waveform.bin_width_hz,
                )
            )
        found.append(Targets(*(np.concatenate(column) for column in zip(*parts, strict=True))))
    targets = found[0], found[1], found[2]
    concluded = to_beam_result(waveform, detection, targets, windowed_level, residual_limit)
    return WaveformMeasurement(
        **vars(concluded), targets=targets, noise_power=windowed_level, threshold=threshold
    )


_DARK = ScattererPatches(np.ones(1), np.zeros(1), np.zeros(1, dtype=complex))
"""Placeholder for no light: noise alone is measured."""


def measure_echoes(
    instrument: Instrument,
    model: ReceiverModel,
    echoes: Echoes,
    shot: NDArray[np.int64],
    seed: int,
) -> Returns:
    """Measure every beam of every shot from samples.

    Echo field, speckle and phase are the same as at the other levels (`echo_field`); noise and laser phase are drawn
    independently, from seed, shot and beam. The threshold follows the noise of each bin in a receiver without clipping.
    Backscatter of the atmosphere is left out.

    Args:
        instrument: one look, all three segments, `bin`, `hann` or `aboutanios_mulgrew` peaks and a homodyne line.
        model: constants of the same instrument, from `build_receiver`: SNR per watt, and the noise ahead of and behind
            the poles.
        echoes: echoes (shots, beams, beamlets).
        shot: (shots,) numbers of the shots.
        seed: seed of all random numbers, 64 bits.

    Raises:
        ValueError: the instrument is not supported.
    """
    field = echo_field(model, echoes, shot, seed)
    beams = [
        _measure_beam(
            instrument,
            model,
            echoes,
            field,
            s,
            b,
            _Generators.of(model, seed, int(shot[s]), b),
        )
        for s, b in np.ndindex(echoes.fired.shape)
    ]
    columns = {name: np.concatenate([getattr(beam, name) for beam in beams]) for name in RETURN_COLUMNS}
    return Returns(**{name: a.reshape(*echoes.fired.shape, *a.shape[1:]) for name, a in columns.items()})


class _Generators(NamedTuple):
    """Random generators of one measurement."""

    beam: np.random.Generator
    laser: np.random.Generator

    @classmethod
    def of(cls, model: ReceiverModel, seed: int, shot: int, b: int) -> Self:
        beam = generator(seed, shot, b, bit_generator=np.random.PCG64)
        return cls(beam, laser_generator(model, seed, shot, b))


def _measure_beam(
    instrument: Instrument,
    model: ReceiverModel,
    echoes: Echoes,
    field: EchoField,
    s: int,
    b: int,
    rng: _Generators,
) -> Returns:
    """Measure one beam of one shot."""
    if not echoes.fired[s, b]:
        return nothing(Reason.NOT_FIRED)
    range_m = echoes.range_m[s, b]
    travelled_m = model.furthest_record_s * np.abs(_finite(echoes.range_rate_mps[s, b]))
    if echoes.inside[s, b] or (range_m <= travelled_m).any():
        return nothing(Reason.INSIDE_GROUND)
    waveform, receiver = instrument.waveform, instrument.receiver
    footprint = scatterer_patches(waveform, echoes, field, s, b)
    response = AnalogResponse.of(receiver)
    echo_w = float(echoes.power_w[s, b][field.weight[s, b].any(axis=(0, 1))].sum())
    share, level = noise_with_echo(model, echo_w, noise_level(waveform, response))
    digitiser = Digitiser.of(receiver, model.response)
    measured = measure_waveform(
        waveform,
        instrument.detection,
        footprint,
        response=response,
        rng=rng.beam,
        laser_rng=rng.laser,
        reflection=_reflection(model, rng.beam),
        noise_share=share,
        digitiser=digitiser,
        noise_level=level,
        residual_limit=model.residual_limit,
        edges=bool((range_m > model.record_edge_range_m).any()),
    )
    if measured.reason[0] == Reason.BELOW_THRESHOLD:
        return replace(measured, reason=np.array([unseen(range_m, model.record_edge_range_m)], np.int8))
    return measured


def scatterer_patches(
    waveform: Waveform, echoes: Echoes, field: EchoField, s: int, b: int
) -> ScattererPatches:
    """Patches of beam `b` of shot `s`: one for each tone of each beamlet."""
    weight, offset_hz = field.weight[s, b], field.offset_bin[s, b] * waveform.bin_width_hz
    tone, lit = np.nonzero(weight.any(axis=0))
    if lit.size == 0:
        return _DARK
    return ScattererPatches(
        echoes.range_m[s, b, lit],
        echoes.closing_speed_mps[s, b, lit],
        weight[None, :, tone, lit],
        _finite(echoes.range_rate_mps[s, b, lit]),
        float(echoes.closing_acceleration_mps2[s, b]),
        float(echoes.closing_jerk_mps3[s, b]),
        float(echoes.range_curvature_mps2[s, b]),
        offset_hz[tone],
    )


def _reflection(model: ReceiverModel, rng: np.random.Generator) -> ScattererPatches | None:
    """Light that the optics reflect, at rest, with a phase of its own in each record; None: none."""
    snr, range_m = model.back_reflection
    if snr == 0.0:
        return None
    weight = np.sqrt(snr) * np.exp(2j * np.pi * rng.random((1, 3, 1)))
    return ScattererPatches(np.array([range_m]), np.zeros(1), weight)


def _finite(rate_mps: FloatArray) -> FloatArray:
    return np.where(np.isfinite(rate_mps), rate_mps, 0.0)
