"""Level `waveform`: every beam of every shot from its samples."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.echo_field import EchoField, echo_field
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.returns import RETURN_COLUMNS, Echoes, Reason, Returns
from lidar_emu.fmcw.waveform.analog_receiver import AnalogResponse, Digitiser, noise_level, noise_with_echo
from lidar_emu.fmcw.waveform.beam_measurement import (
    OwnTargets,
    ScattererPatches,
    WaveformMeasurement,
    measure_waveform,
)
from lidar_emu.fmcw.waveform.beam_result import nothing, unseen
from lidar_emu.fmcw.waveform.detection import Targets
from lidar_emu.fmcw.waveform.laser_phase_noise import laser_generator
from lidar_emu.fmcw.waveform.own_detector import Detector, detected_in_all_bins
from lidar_emu.fmcw.waveform.record_samples import ComplexArray
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.random_streams import generator
from lidar_emu.scenario.instrument import Instrument, Waveform

_DARK = ScattererPatches(np.ones(1), np.zeros(1), np.zeros(1, dtype=complex))
"""Placeholder for no light: noise alone is measured."""


def measure_echoes(
    instrument: Instrument,
    model: ReceiverModel,
    echoes: Echoes,
    shot: NDArray[np.int64],
    seed: int,
    detector: Detector | None = None,
) -> Returns:
    """Measure every beam of every shot from samples.

    Echo field, speckle and phase are the same as at the other levels (`echo_field`); noise and laser phase are drawn
    independently, from seed, shot and beam. The threshold follows the noise of each bin in a receiver without clipping.
    Backscatter of the atmosphere is left out.

    Args:
        instrument: one look, all three segments, `bin` or `hann` peaks and a homodyne line.
        model: constants of the same instrument, from `build_receiver`: SNR per watt, and the noise ahead of and behind
            the poles.
        echoes: echoes (shots, beams, beamlets).
        shot: (shots,) numbers of the shots.
        seed: seed of all random numbers, 64 bits.
        detector: detector of the user's own; None: the instrument's.

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
            None if detector is None else _own_targets(instrument.waveform, detector, int(shot[s]), b),
        )
        for s, b in np.ndindex(echoes.fired.shape)
    ]
    columns = {name: np.concatenate([getattr(beam, name) for beam in beams]) for name in RETURN_COLUMNS}
    return Returns(**{name: a.reshape(*echoes.fired.shape, *a.shape[1:]) for name, a in columns.items()})


def measure_one_beam(
    instrument: Instrument,
    model: ReceiverModel,
    echoes: Echoes,
    shot: NDArray[np.int64],
    seed: int,
    s: int,
    b: int,
) -> WaveformMeasurement:
    """Measure beam `b` of shot `shot[s]`, which fires, as `measure_echoes` does, and keep its three whole spectra.

    Arguments and errors are the same as of `measure_echoes`.
    """
    field = echo_field(model, echoes, shot, seed)
    return _measure_records(
        instrument, model, echoes, field, s, b, _Generators.of(model, seed, int(shot[s]), b), keep_bins=True
    )


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
    own_targets: OwnTargets | None,
) -> Returns:
    """Measure one beam of one shot."""
    if not echoes.fired[s, b]:
        return nothing(Reason.NOT_FIRED)
    range_m = echoes.range_m[s, b]
    travelled_m = model.furthest_record_s * np.abs(_finite(echoes.range_rate_mps[s, b]))
    if echoes.inside[s, b] or (range_m <= travelled_m).any():
        return nothing(Reason.INSIDE_GROUND)
    measured = _measure_records(instrument, model, echoes, field, s, b, rng, own_targets=own_targets)
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


def _measure_records(
    instrument: Instrument,
    model: ReceiverModel,
    echoes: Echoes,
    field: EchoField,
    s: int,
    b: int,
    rng: _Generators,
    keep_bins: bool = False,
    own_targets: OwnTargets | None = None,
) -> WaveformMeasurement:
    """Measure the records of a beam."""
    range_m, power_w = echoes.range_m[s, b], echoes.power_w[s, b]
    waveform, receiver = instrument.waveform, instrument.receiver
    footprint = scatterer_patches(waveform, echoes, field, s, b)
    response = AnalogResponse.of(receiver)
    echo_w = float(power_w[field.weight[s, b].any(axis=(0, 1))].sum())
    share, level = noise_with_echo(model, echo_w, noise_level(waveform, response))
    digitiser = Digitiser.of(receiver, model.response)
    return measure_waveform(
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
        keep_bins=keep_bins,
        own_targets=own_targets,
    )


def _own_targets(waveform: Waveform, detector: Detector, shot: int, b: int) -> OwnTargets:
    """The detector of a beam's segments."""

    def targets(
        segment: int, samples: FloatArray, bins: ComplexArray, noise: FloatArray, threshold: FloatArray
    ) -> Targets:
        return detected_in_all_bins(
            detector, waveform, shot, b, segment, bins[0], samples[0], noise, threshold
        )

    return targets


def _reflection(model: ReceiverModel, rng: np.random.Generator) -> ScattererPatches | None:
    """Light that the optics reflect, at rest, with a phase of its own in each record; None: none."""
    snr, range_m = model.back_reflection
    if snr == 0.0:
        return None
    weight = np.sqrt(snr) * np.exp(2j * np.pi * rng.random((1, 3, 1)))
    return ScattererPatches(np.array([range_m]), np.zeros(1), weight)


def _finite(rate_mps: FloatArray) -> FloatArray:
    return np.where(np.isfinite(rate_mps), rate_mps, 0.0)
