"""Numbers by counter for what befalls a run: those of one fault depend on no other's, nor on the receiver's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal, uniform_pair

_FIRST_PURPOSE = 1024
"""The receiver's purposes are below."""

_WHOLE_SHOT = 0xFFFF
"""In place of a beam's number."""


class Chance:
    """The numbers of one fault, or of the dust.

    Args:
        seed: of the run.
        number: of the fault in the scenario's list; 4096 the dust.
    """

    def __init__(self, seed: int, number: int) -> None:
        self._seed = np.uint64(seed)
        self._purpose = _FIRST_PURPOSE + number
        # Kernels are compiled before the run: what is drawn at a fault's first shot must not make it late.
        nobody = np.empty(0, dtype=np.int64)
        self.uniforms(nobody, 1, 0)
        self.normals(nobody, 1, 0)
        self.of_shots(nobody)
        self.run_of(0, 0, 0)

    def uniforms(self, shot: NDArray[np.int64], beams: int, index: int) -> FloatArray:
        """(shots, beams, 2) Uniforms between 0 and 1; other ones for each index."""
        out = np.empty((len(shot), beams, 2))
        _fill_uniforms(self._seed, shot, self._purpose, index, out)
        return out

    def normals(self, shot: NDArray[np.int64], beams: int, index: int) -> FloatArray:
        """(shots, beams, 2) Standard normal numbers; other ones for each index."""
        out = np.empty((len(shot), beams, 2))
        _fill_normals(self._seed, shot, self._purpose, index, out)
        return out

    def of_shots(self, shot: NDArray[np.int64]) -> FloatArray:
        """(shots,) A uniform for each shot as a whole."""
        out = np.empty(len(shot))
        _fill_whole(self._seed, shot, self._purpose, out)
        return out

    def run_of(self, shot: int, first: int, count: int) -> FloatArray:
        """(count,) Uniforms `first` onward of those that a shot as a whole has besides."""
        out = np.empty(count)
        _fill_run(self._seed, shot, self._purpose, first, out)
        return out


@kernel(outermost=True)
def _fill_uniforms(
    seed: np.uint64, shot: NDArray[np.int64], purpose: int, index: int, out: FloatArray
) -> None:
    for s in range(len(shot)):
        for b in range(out.shape[1]):
            out[s, b, 0], out[s, b, 1] = uniform_pair(seed, shot[s], b, purpose, index)


@kernel(outermost=True)
def _fill_normals(
    seed: np.uint64, shot: NDArray[np.int64], purpose: int, index: int, out: FloatArray
) -> None:
    for s in range(len(shot)):
        for b in range(out.shape[1]):
            x, y = complex_normal(seed, shot[s], b, purpose, index)
            out[s, b, 0], out[s, b, 1] = x * np.sqrt(2.0), y * np.sqrt(2.0)


@kernel(outermost=True)
def _fill_whole(seed: np.uint64, shot: NDArray[np.int64], purpose: int, out: FloatArray) -> None:
    for s in range(len(shot)):
        out[s], _ = uniform_pair(seed, shot[s], _WHOLE_SHOT, purpose, 0)


@kernel(outermost=True)
def _fill_run(seed: np.uint64, shot: int, purpose: int, first: int, out: FloatArray) -> None:
    for k in range(len(out)):
        out[k], _ = uniform_pair(seed, shot, _WHOLE_SHOT, purpose, 1 + first + k)
