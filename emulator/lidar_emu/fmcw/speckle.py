"""Speckle: each beamlet's echo is a circular Gaussian number that changes as the footprint moves over the ground.

The numbers are a random field over the position of the footprint, so that any shot can be computed alone: independent
Gaussian numbers at the corners of a lattice, interpolated along each axis with the weights cos²(πx/3) √(8/9) of the
three nearest corners at distances x. The squares of the weights sum to 1 at any place, and the squares of their
slopes to 4π²/27. Averaged over the cell, the correlation over a distance x in pitches is

    2/9 [(3 - |x|) (1 + ½ cos(2πx/3)) + 9/(4π) sin(2π|x|/3)] for |x| < 3,

which has the curvature of the Gaussian exp(-D²/w²) at x = 0 with the pitch π √(2/27) w, and is within 0.03 of it.
"""

from __future__ import annotations

from math import floor, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal, fill_normals_of_shots
from lidar_emu.numerics.random_streams import SPECKLE, STREAK
from lidar_emu.numerics.sine import sin_pi

PITCH_W = pi * sqrt(2.0 / 27.0)
"""Pitch of the lattice as a multiple of the radius w of the correlation exp(-D²/w²)."""

SLOTS = 9
"""Corners cached, by their coordinates modulo 3: the corners of one position."""

_SHARE = sqrt(8.0 / 9.0)

_LOW_WORD = np.int64(0x7FFFFFFF)
"""Mask of a coordinate: two of them fit into a word beside the sign bit."""


class SpeckleField(NamedTuple):
    """The field of one beam in one record, and the surrounding corners of the lattice."""

    weights: FloatArray
    """(tones, 2, beamlets) Real and imaginary parts of the weight of each beamlet's tones; the field has unit mean
    power."""
    held: NDArray[np.int64]
    """(SLOTS, 2) Coordinates of the corners in `corners`."""
    places: NDArray[np.int64]
    """(SLOTS,) Coordinates of corners to be drawn, overwritten."""
    corners: FloatArray
    """(2, SLOTS, beamlets) Real and imaginary parts of the numbers at these corners."""
    numbers: FloatArray
    """(2, SLOTS * beamlets) The same numbers, one slot after another."""
    words: NDArray[np.uint64]
    """(4, SLOTS * beamlets / 2) Random words, overwritten."""


def speckle_field(beamlets: int, tones: int = 1) -> SpeckleField:
    """Allocate the field of beams with up to `beamlets` beamlets, an even number, of up to `tones` tones each;
    `forget_corners` clears it."""
    numbers = np.empty((2, SLOTS * beamlets))
    return SpeckleField(
        weights=np.empty((tones, 2, beamlets)),
        held=np.empty((SLOTS, 2), dtype=np.int64),
        places=np.empty(SLOTS, dtype=np.int64),
        corners=numbers.reshape(2, SLOTS, beamlets),
        numbers=numbers,
        words=np.empty((4, SLOTS * beamlets // 2), dtype=np.uint64),
    )


@kernel
def set_weights(
    seed: np.uint64, beam: int, east: float, north: float, field: SpeckleField, weights: FloatArray
) -> None:
    """Set `weights`, (2, beamlets), to the field at a position in pitches."""
    nearest_east, nearest_north = floor(east + 0.5), floor(north + 0.5)
    x, y = int(nearest_east), int(nearest_north)
    _draw_corners(seed, beam, x, y, field)
    weights[:] = 0.0
    east -= nearest_east
    north -= nearest_north
    south_share, share, north_share = _share(north + 1.0), _share(north), _share(north - 1.0)
    for step in range(-1, 2):
        share_east = _share(east - step)
        slot = 3 * ((x + step) % 3)
        for part in range(2):
            below, here, above = (
                field.corners[part, slot + (y - 1) % 3],
                field.corners[part, slot + y % 3],
                field.corners[part, slot + (y + 1) % 3],
            )
            weight = weights[part]
            a, b, c = share_east * south_share, share_east * share, share_east * north_share
            for i in range(len(weight)):
                weight[i] = weight[i] + a * below[i] + b * here[i] + c * above[i]


@kernel
def streak_weight(seed: np.uint64, shot: int, beam: int, place: float) -> tuple[float, float]:
    """Field of a streak of dust that a beam meets in a shot, at a position in pitches along the way of the streak."""
    nearest = floor(place + 0.5)
    re = im = 0.0
    for step in range(-1, 2):
        share = _share(place - nearest - step)
        x, y = complex_normal(seed, shot, beam, STREAK, int((int(nearest) + step) & _LOW_WORD))
        re, im = re + share * x, im + share * y
    return re, im


@kernel
def forget_corners(field: SpeckleField) -> None:
    """Clear the cached corners, before each beam."""
    field.held[:] = np.iinfo(np.int64).max


@kernel
def _share(distance: float) -> float:
    """Weight of a corner at the distance x <= 3/2, cos²(πx/3) √(8/9)."""
    cosine = sin_pi(0.5 - abs(distance) / 3.0)
    return _SHARE * cosine * cosine


@kernel
def _draw_corners(seed: np.uint64, beam: int, east: int, north: int, field: SpeckleField) -> None:
    """Draw the corners around the nearest one that are not cached, those in neighbouring slots together."""
    held, numbers, columns = field.held, field.numbers, field.corners.shape[2]
    drawn = 0
    for slot in range(SLOTS + 1):
        if slot < SLOTS:
            x, y = east - 1 + (slot // 3 + 1 - east) % 3, north - 1 + (slot % 3 + 1 - north) % 3
            if held[slot, 0] != x or held[slot, 1] != y:
                held[slot, 0], held[slot, 1] = x, y
                field.places[drawn] = ((x & _LOW_WORD) << 32) | (y & _LOW_WORD)
                drawn += 1
                continue
        if drawn > 0:
            first, last = (slot - drawn) * columns, slot * columns
            re, im = numbers[0, first:last], numbers[1, first:last]
            fill_normals_of_shots(seed, field.places[:drawn], beam, SPECKLE, columns, field.words, re, im)
            drawn = 0
