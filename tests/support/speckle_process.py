"""The speckle of a beam at times about the time of validity, as the receiver draws it."""

from __future__ import annotations

from typing import Any

import numpy as np
from instruments import plain

from lidar_emu.numerics.arrays import as_record
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import draw_reserved, set_normals
from lidar_emu.receiver.beam_measurement import BEAM_RETURN, set_beam
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Echoes
from lidar_emu.receiver.speckle import level_for_travel, reserve_speckle, set_weights
from lidar_emu.receiver.workspace import as_workspace, build_workspace
from lidar_emu.receiver.workspace import plain as as_tuples
from lidar_emu.scenario.instrument import Optics


def speckle_model(looks: int = 1) -> ReceiverModel:
    """A receiver with speckle and nothing else."""
    instrument = plain(looks=looks).model_copy(update={"optics": Optics(speckle=True)})
    return build_receiver(instrument, left_out_share=0.0)


def speckle_at(
    model: ReceiverModel, beams: Echoes, time_s: np.ndarray, shot: np.ndarray, seed: int = 6, level: int = 0
) -> np.ndarray:
    """Weights of the tones, (shots, beams, times, tones, beamlets), at times from each shot's time of validity.

    Args:
        level: of `speckle._CHANGES`: 0 is the process itself.
    """
    travel = float(np.nan_to_num(beams.speckle_motion[..., 0]).max()) * model.record_time_s
    highest = max(level, int(level_for_travel(travel)))
    beamlets = beams.range_m.shape[2]
    work = build_workspace(model, beamlets, highest)
    tones = work.speckle.weights.shape[0]
    values = np.zeros((*beams.fired.shape, len(time_s), tones, 2, beamlets))
    row = np.zeros(1, dtype=BEAM_RETURN)
    arrays = as_tuples(work), tuple(beams), np.asarray(shot, np.int64), np.uint64(seed), level
    _set_values(as_record(model), *arrays, np.asarray(time_s, float), row, values)
    return values[..., 0, :] + 1j * values[..., 1, :]


@kernel(outermost=True)
def _set_values(
    models: Any,
    work_arrays: Any,
    echo_arrays: Any,
    shot: np.ndarray,
    seed: np.uint64,
    level: int,
    time_s: np.ndarray,
    rows: Any,
    values: np.ndarray,
) -> None:
    model, work, echoes = models[0], as_workspace(work_arrays), Echoes(*echo_arrays)
    beam = work.beam[0]
    beam.seed = seed
    for s in range(values.shape[0]):
        for b in range(values.shape[1]):
            beam.shot = shot[s]
            set_beam(model, work, echoes, s, b, rows[0])
            beam.speckle_level = level
            count = reserve_speckle(model, echoes, s, b, beam, work.speckle.waves, work.drawn)
            draw_reserved(seed, shot[s], count, work.drawn.counters, work.drawn.words)
            set_normals(count, work.drawn)
            for t in range(len(time_s)):
                set_weights(model, beam, time_s[t], work.speckle, work.drawn)
                for tone in range(values.shape[3]):
                    for part in range(2):
                        for i in range(values.shape[5]):
                            values[s, b, t, tone, part, i] = work.speckle.weights[tone, part, i]
