"""The receiver of one beam after another: echoes in, range and closing speed out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, as_record
from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.receiver.beam_measurement import BEAM_RETURN, measure_beams
from lidar_emu.receiver.bin_filter import most_taps
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import RETURN_COLUMNS, Echoes, Returns, contiguous_echoes
from lidar_emu.receiver.speckle import highest_level
from lidar_emu.receiver.volume_light import COMPUTED_DUST_BINS
from lidar_emu.receiver.workspace import (
    build_workspace,
    plain,
)


class FmcwReceiver:
    """Measures every beam of every shot: three spectra, their targets, range and closing speed.

    Range, speed and speckle are evaluated at each record's own time. With speckle, each beamlet's amplitude is the
    square root of its SNR times a circular complex Gaussian number (`speckle`); without, the beamlets of a beam
    add in phase, beamlet i with P_i / sqrt(P) of the beam's power P. A phase common to the beam is uniform in each
    record. Noise is drawn in the bins near the tones, and as peaks elsewhere.

    A beamlet beyond the record edge is received for the remaining part of the record; one at range 0 or less means
    contact with the ground. Random numbers depend on seed, shot, beam and purpose alone, so that a shot has the same
    bits in any block, and no effect changes the random numbers of another.

    Each thread needs its own instance, which holds the arrays that the kernels write to.

    Args:
        model: from `build_receiver`.
        seed: seed of all random numbers, 64 bits.
    """

    def __init__(self, model: ReceiverModel, seed: int) -> None:
        self.model = model
        self._records = as_record(model)
        self._seed = np.uint64(seed)
        # The type checker cannot analyse kernels.
        self._measure: Any = measure_beams
        self._most_taps: Any = most_taps
        self._highest_level: Any = highest_level
        self._has_room: Any = _has_room
        self._beamlets, self._taps, self._level, self._dusty = 0, -1, -1, False
        self._work: tuple[Any, ...]

    def __call__(self, echoes: Echoes, shot: NDArray[np.int64]) -> Returns:
        """Returns of echoes (shots, beams, beamlets) of the shots with these numbers, (shots,)."""
        echoes = contiguous_echoes(echoes)
        self._reserve(echoes)
        rows = np.empty(echoes.fired.shape, dtype=BEAM_RETURN)
        self._measure(
            self._records,
            self._work,
            tuple(echoes),
            np.ascontiguousarray(shot, dtype=np.int64),
            self._seed,
            with_fields(rows),
        )
        return Returns(*(rows[name] for name in RETURN_COLUMNS))

    def _reserve(self, echoes: Echoes) -> None:
        model, beamlets = self.model, echoes.range_m.shape[2]
        dusty = self._dusty or echoes.dust.size > 0
        motion = (
            echoes.speckle_motion,
            echoes.range_m,
            echoes.closing_speed_mps,
            echoes.closing_acceleration_mps2,
        )
        is_same = self._beamlets == beamlets and self._dusty == dusty
        if is_same and self._has_room(self._records, *motion, self._level, self._taps):
            return
        level, taps = (
            self._highest_level(self._records, motion[0]),
            self._most_taps(self._records, *motion[1:]),
        )
        self._work = plain(build_workspace(model, beamlets, level, taps, dusty * COMPUTED_DUST_BINS))
        self._beamlets, self._taps, self._level, self._dusty = beamlets, taps, level, dusty


@kernel(outermost=True)
def _has_room(
    models: NDArray[Any],
    speckle_motion: FloatArray,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    closing_acceleration_mps2: FloatArray,
    level: int,
    taps: int,
) -> bool:
    """Whether a workspace of this level of speckle and as many taps is enough for these echoes."""
    if highest_level(models, speckle_motion) > level:
        return False
    return bool(most_taps(models, range_m, closing_speed_mps, closing_acceleration_mps2) <= taps)


def receive(model: ReceiverModel, echoes: Echoes, shot: NDArray[np.int64], seed: int) -> Returns:
    """See `FmcwReceiver`."""
    return FmcwReceiver(model, seed)(echoes, shot)
