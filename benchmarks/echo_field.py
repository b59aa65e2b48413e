"""The echo field of level spectral: amplitude and phase of each beamlet in each record, as arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, as_record
from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.numerics.random_streams import PHASE, draw_reserved, set_normals, uniform_pair
from lidar_emu.receiver.beam_measurement import BEAM_RETURN, set_beam
from lidar_emu.receiver.beat_tones import field_sense, record_time, relative_turn
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.returns import Echoes, contiguous_echoes
from lidar_emu.receiver.speckle import (
    highest_level,
    reserve_speckle,
    set_streak_weights,
    set_weights,
    tone_count,
    tone_offset_bin,
)
from lidar_emu.receiver.workspace import Workspace, as_workspace, build_workspace, plain


class EchoField(NamedTuple):
    """Amplitude and phase of each beamlet, as tones beside the beamlet's own frequency."""

    weight: NDArray[np.complex128]
    """(shots, beams, 3, tones, beamlets) Weights at the centre of each record; 0 where a beam has fewer tones."""
    offset_bin: FloatArray
    """(shots, beams, tones) Frequency of the tones from the beamlet's own, in bins; the opposite in the up-chirp."""

    def at_centre(self) -> NDArray[np.complex128]:
        """Field at the centre of each record, (shots, beams, 3, beamlets)."""
        return np.asarray(self.weight.sum(axis=-2))


def echo_field(model: ReceiverModel, echoes: Echoes, shot: NDArray[np.int64], seed: int) -> EchoField:
    """Complex amplitude of each beamlet in each record.

    The square of the field is the bin SNR ahead of the receiver's poles, for an echo that fills the record, with one
    look. With speckle each amplitude is multiplied by a circular complex Gaussian number of the record's own time,
    which changes within the record (`receiver.speckle`); without, the beamlets add in phase, beamlet i with P_i /
    sqrt(P), and a phase common to the beam is uniform in each record. The tone is Re{field exp(j2πgt)} with the
    segment's signed beat g; in the up-chirp, where g rises with the delay, the echo field enters as its conjugate. A
    beamlet without light has the field 0.

    Args:
        model: from `build_receiver`.
        echoes: echoes (shots, beams, beamlets).
        shot: (shots,) numbers of the shots.
        seed: seed of all random numbers, 64 bits.
    """
    lit = (echoes.range_m > 0.0) & (echoes.power_w > 0.0)
    lit &= np.isfinite(echoes.power_w) & np.isfinite(echoes.closing_speed_mps)
    power_w = np.where(lit, echoes.power_w, 0.0)
    snr = power_w * model.snr_per_w
    amplitude = np.sqrt(snr)
    if not model.speckle:
        amplitude = snr / np.sqrt(np.maximum(snr.sum(axis=-1, keepdims=True), np.finfo(float).tiny))
    shots, beams, beamlets = echoes.range_m.shape
    arrays, number = contiguous_echoes(echoes), np.ascontiguousarray(shot, dtype=np.int64)
    records, set_field = as_record(model), _set_field
    level = highest_level(records, arrays.speckle_motion)
    tones = int(tone_count(level))
    field = EchoField(
        np.zeros((shots, beams, 3, tones, beamlets), dtype=complex), np.zeros((shots, beams, tones))
    )
    work = plain(build_workspace(model, beamlets, level))
    row = with_fields(np.zeros(1, dtype=BEAM_RETURN))
    set_field(records, work, lit, amplitude, tuple(arrays), number, np.uint64(seed), row, *field)
    return field


@kernel(outermost=True)
def _set_field(
    models: NDArray[Any],
    work_arrays: tuple[Any, ...],
    lit: BoolArray,
    amplitude: FloatArray,
    echo_arrays: tuple[Any, ...],
    shot: NDArray[np.int64],
    seed: np.uint64,
    rows: NDArray[Any],
    field: NDArray[np.complex128],
    offset_bin: FloatArray,
) -> None:
    model, work, echoes = models[0], as_workspace(work_arrays), Echoes(*echo_arrays)
    beam = work.beam[0]
    beam.seed = seed
    for s in range(lit.shape[0]):
        for b in range(lit.shape[1]):
            beam.shot = shot[s]
            if not set_beam(model, work, echoes, s, b, rows[0]) or beam.lit_beamlets == 0:
                continue
            level = beam.speckle_level
            for tone in range(tone_count(level)):
                offset_bin[s, b, tone] = tone_offset_bin(level, tone)
            if model.speckle:
                count = reserve_speckle(model, echoes, s, b, beam, work.speckle.waves, work.drawn)
                draw_reserved(seed, shot[s], count, work.drawn.counters, work.drawn.words)
                set_normals(count, work.drawn)
            for segment in range(3):
                _set_segment(
                    model, work, beam, segment, lit[s, b], amplitude[s, b], echoes, s, field[s, b, segment]
                )


@kernel
def _set_segment(
    model: ReceiverModel,
    work: Workspace,
    beam: Beam,
    segment: int,
    lit: BoolArray,
    amplitude: FloatArray,
    echoes: Echoes,
    s: int,
    field: NDArray[np.complex128],
) -> None:
    range_m, closing_speed_mps = echoes.range_m[s, beam.beam], echoes.closing_speed_mps[s, beam.beam]
    time_records, sense = record_time(model, segment, 0), field_sense(segment)
    common_turn = 0.0
    if model.speckle:
        time_s = time_records * model.record_time_s
        set_weights(model, beam, time_s, work.speckle, work.drawn)
        if beam.streak_drift_per_s >= 0.0:
            set_streak_weights(beam, time_s, model.ground_beamlets, work.speckle)
    else:
        turn, _ = uniform_pair(beam.seed, beam.shot, beam.beam, PHASE, segment)
        common_turn = turn - 0.5
    first = -1
    for i in range(len(range_m)):
        if not lit[i]:
            continue
        if first < 0:
            first = i
        turn = common_turn
        if model.speckle:
            ahead_m, delta_mps = range_m[i] - range_m[first], closing_speed_mps[i] - closing_speed_mps[first]
            turn += sense * relative_turn(model, segment, time_records, range_m[first], ahead_m, delta_mps)
        angle = 2.0 * np.pi * (turn - np.rint(turn))
        for tone in range(tone_count(beam.speckle_level)):
            value = complex(amplitude[i], 0.0)
            if model.speckle:
                weight = work.speckle.weights[tone]
                value *= complex(weight[0, i], sense * weight[1, i])
            field[tone, i] = value * complex(np.cos(angle), np.sin(angle))
