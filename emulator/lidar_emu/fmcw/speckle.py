"""Speckle: each beamlet's echo is a circular Gaussian number that changes as the footprint moves over the ground.

The numbers are a random field over the position of the footprint, so that any shot can be computed alone: independent
Gaussian numbers at the corners of a lattice, interpolated with weights cos and sin of quarter turns along each axis,
whose squares sum to 1. Averaged over the cell, the correlation over a distance x in pitches is

    (1 - |x|/2) cos(πx/2) + sin(π|x|/2)/π for |x| < 2,

within 0.035 of the Gaussian exp(-D²/w²) with the pitch (π/√8) w.
"""

from __future__ import annotations

from math import floor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import fill_complex_normals, unit_phasor
from lidar_emu.numerics.random_streams import SPECKLE

SLOTS = 9
"""Corners cached, by their coordinates modulo 3: a measurement seldom moves by more than a cell."""

_FIRST: Any = np.int64(0)
"""A variable, since numba would compile the drawing of the numbers once more for a literal."""

_LOW_WORD = np.int64(0x7FFFFFFF)
"""Mask of a coordinate: two of them fit into a word beside the sign bit."""


class SpeckleField(NamedTuple):
    """The field of one beam at one position, and the surrounding corners of the lattice."""

    weights: FloatArray
    """(2, beamlets) Real and imaginary parts at the position, of unit mean power."""
    held: NDArray[np.int64]
    """(SLOTS, 2) Coordinates of the corners in `corners`."""
    corners: FloatArray
    """(SLOTS, 2, beamlets) Numbers at these corners."""
    words: NDArray[np.uint64]
    """(4, beamlets / 2 or more) Random words, overwritten."""


def speckle_field(beamlets: int) -> SpeckleField:
    """Allocate the field of beams with up to `beamlets` beamlets, an even number; `forget_corners` clears it."""
    return SpeckleField(
        weights=np.empty((2, beamlets)),
        held=np.empty((SLOTS, 2), dtype=np.int64),
        corners=np.empty((SLOTS, 2, beamlets)),
        words=np.empty((4, beamlets), dtype=np.uint64),
    )


@kernel
def set_weights(seed: np.uint64, beam: int, east: float, north: float, field: SpeckleField) -> None:
    """Set the field's weights for a position in pitches."""
    weights, corners = field.weights, field.corners
    weights[:] = 0.0
    cell_east, cell_north = floor(east), floor(north)
    for corner in range(4):
        x, y = corner & 1, corner >> 1
        share = _share(east - cell_east, x) * _share(north - cell_north, y)
        slot = _slot_of(seed, beam, int(cell_east) + x, int(cell_north) + y, field)
        for part in range(2):
            weight, normal = weights[part], corners[slot, part]
            for i in range(len(weight)):
                weight[i] += share * normal[i]


@kernel
def forget_corners(field: SpeckleField) -> None:
    """Clear the cached corners, before each beam."""
    field.held[:] = np.iinfo(np.int64).max


@kernel
def _share(offset: float, side: int) -> float:
    # A quarter turn leads from one corner to the next.
    cosine, sine = unit_phasor(0.5 + 0.25 * offset)
    return sine if side else cosine


@kernel
def _slot_of(seed: np.uint64, beam: int, x: int, y: int, field: SpeckleField) -> int:
    """Slot of a corner, drawn unless it is cached."""
    held, corners, words = field.held, field.corners, field.words
    slot = 3 * (x % 3) + y % 3
    if held[slot, 0] != x or held[slot, 1] != y:
        held[slot, 0], held[slot, 1] = x, y
        place = int(((x & _LOW_WORD) << 32) | (y & _LOW_WORD))
        fill_complex_normals(seed, place, beam, SPECKLE, _FIRST, corners.shape[2], words, corners[slot])
    return slot
