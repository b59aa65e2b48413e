"""Random streams: every random number of the package, and its purpose.

A number that belongs to a shot is a function of seed, shot, beam and purpose (`philox`), so that any shot can be
computed alone and no effect changes the numbers of another. Kernels call `philox` themselves, with a purpose from here;
everything else has a `RandomStream`. Large arrays that are drawn once, for a run or a ground, come from a numpy
generator made by `generator`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal, uniform_pair

_RECEIVER: Any = np.arange(1, 7)
PHASE, NOISE_BINS, SPECKLE, LINE, HAZE, FALSE_ALARM = _RECEIVER
"""Purposes in the receiver's kernels. They are variables: numba would compile a kernel again for each literal."""
FIRST_FAULT = 1024
"""Purpose of the first fault in a scenario's list; the others follow."""
DUST = 5120
"""Purpose of the dust raised by the plume."""
CLOCK_WANDER = 5121
"""Purpose of the slow changes of the device clock's rate."""
SCATTERERS = 5122
"""Purpose of a measurement's scatterers, noise and laser phase, as a key of `generator`."""
SWEEP: Any = np.int64(5123)
"""Purpose of the errors of the laser's sweep; also a key of `generator`."""
BACK_REFLECTION: Any = np.int64(5124)
"""Purpose of the phase of light that the optics reflect."""
RIPPLE: Any = np.int64(5125)
"""Purpose of the phase of the chirps' periodic non-linearity; also a key of `generator`."""
STREAK: Any = np.int64(5126)
"""Purpose of the speckle of a streak of dust."""

RELIEF, CRATERS, ROCKS = range(3)
"""Keys of `generator`, after the seed of a generated ground."""
SHARES, RUN_SEEDS = range(2)
"""Keys of `generator`, after the seed of a campaign: quantiles of the dispersed keys, and the seeds of its runs."""

WHOLE_SHOT = 0xFFFF
"""Placeholder for the number of a beam."""


def fault_purpose(number: int) -> int:
    """Purpose of a fault by its index in the scenario's list.

    Raises:
        ValueError: the purposes of faults are used up.
    """
    if not 0 <= number < DUST - FIRST_FAULT:
        raise ValueError(f"fault {number}; must be fewer than {DUST - FIRST_FAULT}")
    return FIRST_FAULT + number


def generator(
    *key: int, bit_generator: type[np.random.BitGenerator] = np.random.Philox
) -> np.random.Generator:
    """A numpy generator for arrays drawn as a whole.

    Args:
        key: seed and further natural numbers; another key gives an independent stream.
        bit_generator: Philox, unless published results depend on another one.
    """
    return np.random.Generator(bit_generator(np.random.SeedSequence(key)))


class RandomStream:
    """Random numbers of one purpose by shot and beam, such as the numbers of one fault.

    Args:
        seed: the run's seed.
        purpose: declared in this module.
    """

    def __init__(self, seed: int, purpose: int) -> None:
        self._seed = np.uint64(seed)
        self._purpose = purpose
        # Kernels are compiled before the run, so that the first shot with a fault is not late.
        no_shot = np.empty(0, dtype=np.int64)
        self.uniforms(no_shot, 1, 0)
        self.normals(no_shot, 1, 0)
        self.per_shot(no_shot)
        self.sequence(0, 0, 0)

    def uniforms(self, shot: NDArray[np.int64], beams: int, index: int) -> FloatArray:
        """Uniforms (shots, beams, 2) between 0 and 1; another `index` gives other numbers."""
        out = np.empty((len(shot), beams, 2))
        _fill_uniforms(self._seed, shot, self._purpose, index, out)
        return out

    def normals(self, shot: NDArray[np.int64], beams: int, index: int) -> FloatArray:
        """Standard normal numbers (shots, beams, 2); another `index` gives other numbers."""
        out = np.empty((len(shot), beams, 2))
        _fill_normals(self._seed, shot, self._purpose, index, out)
        return out

    def per_shot(self, shot: NDArray[np.int64]) -> FloatArray:
        """One uniform (shots,) per shot as a whole."""
        out = np.empty(len(shot))
        _fill_per_shot(self._seed, shot, self._purpose, out)
        return out

    def sequence(self, shot: int, first: int, count: int) -> FloatArray:
        """Uniforms (count,) from number `first` on, of a further sequence per shot."""
        out = np.empty(count)
        _fill_sequence(self._seed, shot, self._purpose, first, out)
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
def _fill_per_shot(seed: np.uint64, shot: NDArray[np.int64], purpose: int, out: FloatArray) -> None:
    for s in range(len(shot)):
        out[s], _ = uniform_pair(seed, shot[s], WHOLE_SHOT, purpose, 0)


@kernel(outermost=True)
def _fill_sequence(seed: np.uint64, shot: int, purpose: int, first: int, out: FloatArray) -> None:
    for k in range(len(out)):
        out[k], _ = uniform_pair(seed, shot, WHOLE_SHOT, purpose, 1 + first + k)
