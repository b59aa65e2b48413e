"""Speckle: each beamlet's echo is a circular Gaussian number that changes as the footprint moves over the ground.

The numbers are a field over the footprint's place, so that any shot can be computed alone: independent Gaussian
numbers at the corners of a lattice, and between corners their mixture with weights cos and sin of quarter turns along
each axis, whose squares sum to 1. Averaged over the cell its correlation over a distance x, in pitches, is

    (1 - |x|/2) cos(πx/2) + sin(π|x|/2)/π  for |x| < 2,

within 0.035 of the Gaussian exp(-D²/w²) where the pitch is (π/√8) w.
"""

from __future__ import annotations

from math import floor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import fill_complex_normals, unit_phasor

SLOTS = 9
"""Corners kept, by their coordinates modulo 3: a measurement seldom moves by more than a cell."""

_FIRST: Any = np.int64(0)
"""No literal, for which numba would compile what draws the numbers once more."""

_LOW_WORD = np.int64(0x7FFFFFFF)
"""Of a coordinate: two of them are a number that has a sign bit left."""


@kernel
def set_weights(
    seed: np.uint64,
    beam: int,
    purpose: int,
    east: float,
    north: float,
    held: NDArray[np.int64],
    corners: FloatArray,
    words: NDArray[np.uint64],
    weights: FloatArray,
) -> None:
    """Set `weights` (2, beamlets), of unit mean power, to the field at a place given in pitches.

    Args:
        held: (SLOTS, 2) coordinates of the corners in `corners`; `forget` clears them for each beam.
        corners: (SLOTS, 2, beamlets) the numbers there.
        words: (4, beamlets / 2) overwritten.
    """
    weights[:] = 0.0
    cell_east, cell_north = floor(east), floor(north)
    for corner in range(4):
        x, y = corner & 1, corner >> 1
        share = _share(east - cell_east, x) * _share(north - cell_north, y)
        slot = _hold(seed, beam, purpose, int(cell_east) + x, int(cell_north) + y, held, corners, words)
        for part in range(2):
            weight, normal = weights[part], corners[slot, part]
            for i in range(len(weight)):
                weight[i] += share * normal[i]


@kernel
def forget(held: NDArray[np.int64]) -> None:
    """No corner is known."""
    held[:] = np.iinfo(np.int64).max


@kernel
def _share(offset: float, side: int) -> float:
    # A quarter turn leads from one corner to the other.
    cosine, sine = unit_phasor(0.5 + 0.25 * offset)
    return sine if side else cosine


@kernel
def _hold(
    seed: np.uint64,
    beam: int,
    purpose: int,
    x: int,
    y: int,
    held: NDArray[np.int64],
    corners: FloatArray,
    words: NDArray[np.uint64],
) -> int:
    """The slot of a corner, drawn unless it is there."""
    slot = 3 * (x % 3) + y % 3
    if held[slot, 0] != x or held[slot, 1] != y:
        held[slot, 0], held[slot, 1] = x, y
        place = int(((x & _LOW_WORD) << 32) | (y & _LOW_WORD))
        fill_complex_normals(seed, place, beam, purpose, _FIRST, corners.shape[2], words, corners[slot])
    return slot
