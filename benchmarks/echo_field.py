"""The echo field of level spectral: amplitude and phase of each beamlet in each record, as arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import PHASE, uniform_pair, unit_phasor
from lidar_emu.receiver.beat_tones import field_sense, record_time, relative_turn
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Echoes, contiguous_echoes
from lidar_emu.receiver.skip_limits import negligible_bin2
from lidar_emu.receiver.speckle import (
    forget_corners,
    highest_level,
    needed_level,
    set_streak_weights,
    set_tone_weights,
    streak_drift,
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
    sqrt(P). A phase common to the beam is uniform in each record. The tone is Re{field exp(j2πgt)} with the segment's
    signed beat g; in the up-chirp, where g rises with the delay, the echo field enters as its conjugate. A beamlet
    without light has the field 0.

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
    level = highest_level(records, arrays.speckle_drift_per_s)
    tones = int(tone_count(level))
    field = EchoField(
        np.zeros((shots, beams, 3, tones, beamlets), dtype=complex), np.zeros((shots, beams, tones))
    )
    work = plain(build_workspace(beamlets, 1, level))
    set_field(records, work, lit, amplitude, power_w.sum(axis=-1), arrays, number, np.uint64(seed), *field)
    return field


@kernel(outermost=True)
def _set_field(
    models: NDArray[Any],
    work_arrays: tuple[Any, ...],
    lit: BoolArray,
    amplitude: FloatArray,
    power_w: FloatArray,
    echoes: Echoes,
    shot: NDArray[np.int64],
    seed: np.uint64,
    field: NDArray[np.complex128],
    offset_bin: FloatArray,
) -> None:
    model = models[0]
    work: Workspace = as_workspace(work_arrays)
    range_m, closing_speed_mps = echoes.range_m, echoes.closing_speed_mps
    beamlets = range_m.shape[2]
    for s in range(range_m.shape[0]):
        for b in range(range_m.shape[1]):
            forget_corners(work.speckle)
            place, drift_per_s = echoes.speckle_place[s, b], echoes.speckle_drift_per_s[s, b]
            level = needed_level(model, drift_per_s, negligible_bin2(model, power_w[s, b]))
            streak_drift_per_s = streak_drift(model, echoes, s, b)
            for tone in range(tone_count(level)):
                offset_bin[s, b, tone] = tone_offset_bin(level, tone)
            for segment in range(3):
                time_records = record_time(model, segment, 0)
                time_s = time_records * model.record_time_s
                common_turn, _ = uniform_pair(seed, shot[s], b, PHASE, segment)
                if model.speckle:
                    set_tone_weights(
                        seed,
                        b,
                        place,
                        drift_per_s,
                        time_s,
                        model.record_time_s,
                        level,
                        work.speckle,
                        work.change,
                    )
                    if streak_drift_per_s >= 0.0:
                        way = streak_drift_per_s * time_s
                        set_streak_weights(seed, shot[s], b, way, level, model.ground_beamlets, work.speckle)
                sense = field_sense(segment)
                first = -1
                for i in range(beamlets):
                    if not lit[s, b, i]:
                        continue
                    if first < 0:
                        first = i
                    turn = common_turn
                    if model.speckle:
                        ahead_m = range_m[s, b, i] - range_m[s, b, first]
                        delta_speed_mps = closing_speed_mps[s, b, i] - closing_speed_mps[s, b, first]
                        turn += sense * relative_turn(
                            model, segment, time_records, range_m[s, b, first], ahead_m, delta_speed_mps
                        )
                    cosine, sine = unit_phasor(turn + 0.5 - np.floor(turn + 0.5))
                    for tone in range(tone_count(level)):
                        value = complex(amplitude[s, b, i], 0.0)
                        if model.speckle:
                            weight = work.speckle.weights[tone]
                            value *= complex(weight[0, i], sense * weight[1, i])
                        field[s, b, segment, tone, i] = value * complex(cosine, sine)
