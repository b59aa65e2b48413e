"""Arrays that the receiver's kernels write to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.close_tones import TONES_PER_DIVISION
from lidar_emu.fmcw.motion_smear import LEAST_TAPS
from lidar_emu.fmcw.speckle import SLOTS
from lidar_emu.fmcw.spectrum import REACH, ROWS, grid_capacity
from lidar_emu.numerics.arrays import FloatArray

MAX_TARGETS = 4
"""Targets kept of one spectrum, the strongest."""


class Workspace(NamedTuple):
    """Arrays that the kernels write to; their size bounds beamlets, looks and the widest filter."""

    beamlets: FloatArray
    """(5, tones) see `gather_beamlets`; columns are beamlets, and at least one more, for the haze."""
    tones: FloatArray
    """(looks, 4, tones) see `set_tones`; also the places of all, one after another, to lay bins."""
    places: FloatArray
    residues: FloatArray
    weights: FloatArray
    held: NDArray[np.int64]
    corners: FloatArray
    grid: FloatArray
    bins: FloatArray
    filtered: FloatArray
    noise: FloatArray
    words: NDArray[np.uint64]
    taps: FloatArray
    """(3, 2, taps) of smear, of the line, and of both."""
    peaks: NDArray[np.int64]
    targets: FloatArray
    """(3, MAX_TARGETS, 4) frequency, its variance, power over noise, and power of each segment's targets."""
    alarms: FloatArray
    """(MAX_TARGETS, 3) power, bin, and power over noise of peaks in noise."""


def build_workspace(beamlets: int, looks: int, half: int, length: float) -> Workspace:
    """Room for beams of so many beamlets, and filters of `half` taps on each side."""
    tones = -(-(beamlets + 1) // TONES_PER_DIVISION) * TONES_PER_DIVISION
    reach = REACH + max(0, half - LEAST_TAPS)
    capacity = grid_capacity(looks * tones, reach, length)
    return Workspace(
        beamlets=np.empty((5, tones)),
        tones=np.zeros((looks, 4, tones)),
        places=np.empty((2, looks * tones)),
        residues=np.empty((2, tones)),
        weights=np.empty((2, tones)),
        held=np.empty((SLOTS, 2), dtype=np.int64),
        corners=np.empty((SLOTS, 2, tones)),
        grid=np.empty((ROWS, capacity)),
        bins=np.empty((looks, 2, capacity)),
        filtered=np.empty((4, capacity + 2 * half + 4)),
        noise=np.empty((2, capacity + 4)),
        words=np.empty((4, capacity // 2 + tones + 4), dtype=np.uint64),
        taps=np.empty((3, 2, 2 * half + 1)),
        peaks=np.empty(MAX_TARGETS, dtype=np.int64),
        targets=np.empty((3, MAX_TARGETS, 4)),
        alarms=np.empty((MAX_TARGETS, 3)),
    )
