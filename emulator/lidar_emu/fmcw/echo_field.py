"""The echo field: amplitude and phase of each beamlet in each record, common to all levels of the receiver."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.beat_tones import relative_turn
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.returns import Echoes, contiguous_echoes
from lidar_emu.fmcw.speckle import SpeckleField, forget_corners, set_weights
from lidar_emu.fmcw.workspace import build_workspace
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import uniform_pair, unit_phasor
from lidar_emu.numerics.random_streams import PHASE
from lidar_emu.numerics.records import as_record


def echo_field(
    model: ReceiverModel, echoes: Echoes, shot: NDArray[np.int64], seed: int
) -> NDArray[np.complex128]:
    """Complex amplitude of each beamlet at the centre of each record, (shots, beams, 3, beamlets).

    The square of the field is the bin SNR ahead of the receiver's poles, for an echo that fills the record, with one
    look. With speckle each amplitude is multiplied by a circular complex Gaussian number of the record's own time;
    without, the beamlets add in phase, beamlet i with P_i / sqrt(P). A phase common to the beam is uniform in each
    record. The tone is Re{field exp(j2πgt)} with the segment's signed beat g; in the up-chirp, where g rises with the
    delay, the echo field enters as its conjugate. A beamlet without light has the field 0.

    Args:
        model: from `build_receiver`.
        echoes: echoes (shots, beams, beamlets).
        shot: (shots,) numbers of the shots.
        seed: seed of all random numbers, 64 bits.
    """
    lit = (echoes.range_m > 0.0) & (echoes.power_w > 0.0)
    lit &= np.isfinite(echoes.power_w) & np.isfinite(echoes.closing_speed_mps)
    snr = np.where(lit, echoes.power_w, 0.0) * model.snr_per_w
    amplitude = np.sqrt(snr)
    if not model.speckle:
        amplitude = snr / np.sqrt(np.maximum(snr.sum(axis=-1, keepdims=True), np.finfo(float).tiny))
    shots, beams, beamlets = echoes.range_m.shape
    field = np.zeros((shots, beams, 3, beamlets), dtype=complex)
    work = build_workspace(beamlets, 1)
    arrays = contiguous_echoes(echoes)
    number = np.ascontiguousarray(shot, dtype=np.int64)
    _set_field(as_record(model), work.speckle, lit, amplitude, arrays, number, np.uint64(seed), field)
    return field


@kernel(outermost=True)
def _set_field(
    models: NDArray[Any],
    speckle: SpeckleField,
    lit: BoolArray,
    amplitude: FloatArray,
    echoes: Echoes,
    shot: NDArray[np.int64],
    seed: np.uint64,
    field: NDArray[np.complex128],
) -> None:
    """Fill `field` as `echo_field` returns it; `speckle` is overwritten."""
    model = models[0]
    range_m, closing_speed_mps = echoes.range_m, echoes.closing_speed_mps
    place, drift_per_s, weights = echoes.speckle_place, echoes.speckle_drift_per_s, speckle.weights
    beamlets = range_m.shape[2]
    for s in range(range_m.shape[0]):
        for b in range(range_m.shape[1]):
            forget_corners(speckle)
            for segment in range(3):
                time_records = (segment - 1) * model.segment_records
                time_s = time_records * model.record_time_s
                common_turn, _ = uniform_pair(seed, shot[s], b, PHASE, segment)
                if model.speckle:
                    east = place[s, b, 0] + drift_per_s[s, b, 0] * time_s
                    north = place[s, b, 1] + drift_per_s[s, b, 1] * time_s
                    set_weights(seed, b, east, north, speckle)
                sense = -1.0 if segment == 0 else 1.0
                first = -1
                for i in range(beamlets):
                    if not lit[s, b, i]:
                        continue
                    if first < 0:
                        first = i
                    value = complex(amplitude[s, b, i], 0.0)
                    turn = common_turn
                    if model.speckle:
                        value *= complex(weights[0, i], sense * weights[1, i])
                        ahead_m = range_m[s, b, i] - range_m[s, b, first]
                        faster_mps = closing_speed_mps[s, b, i] - closing_speed_mps[s, b, first]
                        turn += sense * relative_turn(
                            model, segment, time_records, range_m[s, b, first], ahead_m, faster_mps
                        )
                    cosine, sine = unit_phasor(turn + 0.5 - np.floor(turn + 0.5))
                    field[s, b, segment, i] = value * complex(cosine, sine)
