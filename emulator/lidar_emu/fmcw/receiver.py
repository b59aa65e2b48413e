"""The receiver of one beam after another: echoes in, range and closing speed out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.beam_measurement import BEAM_RETURN, measure_spectra, measure_statistically, prepare
from lidar_emu.fmcw.receiver_model import ReceiverModel, as_records
from lidar_emu.fmcw.returns import RETURN_COLUMNS, Echoes, Returns
from lidar_emu.fmcw.workspace import Workspace, build_workspace
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import with_fields


class FmcwReceiver:
    """Measures every beam of every shot: three spectra, their targets, range and closing speed.

    Range, speed and speckle are those of each record's own time. With speckle each beamlet's amplitude is the root
    of its SNR times a circular complex Gaussian number (`fmcw.speckle`); without, the beamlets of a beam add in
    phase, beamlet i with the share P_i / sqrt(P) of the beam's P. A phase common to the beam is uniform in each
    record. Noise is drawn in the bins around the tones, and as peaks elsewhere.

    A beamlet beyond the record edge is heard for the part of the record that is left; one at range 0 or less means
    contact with the ground. What is drawn depends on seed, shot, beam and purpose alone, so that the bits of a shot are
    the same in any block, and no effect changes another's chance.

    Two threads need one each: it keeps the arrays that its kernels write to.

    Args:
        model: from `build_receiver`.
        seed: 64 bits, of everything drawn.
    """

    def __init__(self, model: ReceiverModel, seed: int) -> None:
        self._model = model
        self._records = as_records(model)
        self._seed = np.uint64(seed)
        # Two kernels, of which a run compiles the one that it needs; the type checker cannot follow into either.
        self._measure: Any = measure_statistically if model.statistical else measure_spectra
        self._prepare: Any = prepare
        self._room = (0, -1)
        self._work: Workspace

    def __call__(self, echoes: Echoes, shot: NDArray[np.int64]) -> Returns:
        """The returns of echoes (shots, beams, beamlets) of shots with these numbers, (shots,)."""
        shape = echoes.fired.shape
        range_m, speed_mps, power_w, rate_mps = (
            np.ascontiguousarray(values, dtype=np.float64)
            for values in (echoes.range_m, echoes.closing_speed_mps, echoes.power_w, echoes.range_rate_mps)
        )
        size = echoes.fired.size
        bounded = np.empty(6 * size)
        half = self._prepare(
            self._records,
            range_m,
            speed_mps,
            (
                _flat(echoes.smear_acceleration_mps2),
                _flat(echoes.closing_acceleration_mps2),
                _flat(echoes.speckle_place),
                _flat(echoes.speckle_drift_per_s),
            ),
            bounded,
        )
        rows = np.zeros(shape, dtype=BEAM_RETURN)
        self._measure(
            self._records,
            self._workspace(range_m.shape[2], half),
            range_m,
            speed_mps,
            power_w,
            rate_mps,
            bounded[size : 2 * size].reshape(shape),
            bounded[:size].reshape(shape),
            bounded[2 * size : 4 * size].reshape(*shape, 2),
            bounded[4 * size :].reshape(*shape, 2),
            np.ascontiguousarray(echoes.fired),
            np.ascontiguousarray(echoes.inside),
            np.ascontiguousarray(shot, dtype=np.int64),
            self._seed,
            with_fields(rows),
        )
        return Returns(*(rows[name] for name in RETURN_COLUMNS))

    def _workspace(self, beamlets: int, half: int) -> Workspace:
        """Room for so many beamlets and for filters of `half` taps on each side."""
        if self._room[0] != beamlets or self._room[1] < half:
            self._work = build_workspace(beamlets, self._model.looks, half, self._model.fft_length)
            self._room = beamlets, half  # now that there is room
        return self._work


def _flat(values: FloatArray) -> FloatArray:
    return np.ascontiguousarray(values, dtype=np.float64).reshape(-1)


def receive(model: ReceiverModel, echoes: Echoes, shot: NDArray[np.int64], seed: int) -> Returns:
    """See `FmcwReceiver`."""
    return FmcwReceiver(model, seed)(echoes, shot)
