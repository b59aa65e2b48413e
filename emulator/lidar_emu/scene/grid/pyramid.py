"""The greatest height of every block of 2^L x 2^L cells, by which a ray skips ground far below it."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray

_ROWS_AT_ONCE = 64
"""Rows of cells processed at a time, an even number."""


def cell_maxima(nodes_m: FloatArray, hole_m: float) -> FloatArray:
    """Greatest height of each cell; ``hole_m`` where a corner is missing.

    The bilinear surface of a cell never rises above its highest corner.
    """
    rows = np.maximum(nodes_m[:-1], nodes_m[1:])
    cells = np.maximum(rows[:, :-1], rows[:, 1:])
    return np.asarray(np.where(np.isnan(cells), hole_m, cells), dtype=np.float64)


def build_pyramid(nodes_m: FloatArray, hole_m: float) -> tuple[FloatArray, IntArray]:
    """Build all levels in one array, with the index at which each begins.

    Args:
        nodes_m: (rows, columns) heights, NaN where missing.
        hole_m: height that bounds the ground of a cell with a missing corner.

    Returns:
        The maxima of all levels, and for each level L its (first index, blocks per row). Level 0, the cells
        themselves, is not stored, since a cell's corners are read anyway: its entry is empty.
    """
    maxima: list[FloatArray] = [np.empty(0)]
    levels = [(0, 0)]
    if nodes_m.size > 4:
        blocks = _blocks_of_four(nodes_m, hole_m)
        while True:
            levels.append((sum(level.size for level in maxima), blocks.shape[1]))
            maxima.append(blocks.ravel())
            if blocks.size == 1:
                break
            blocks = _halved(blocks)
    return np.concatenate(maxima), np.array(levels, dtype=np.int64)


def _blocks_of_four(nodes_m: FloatArray, hole_m: float) -> FloatArray:
    """Level 1, computed a few rows at a time: the maxima of all cells would take as much memory as the samples."""
    firsts = range(0, len(nodes_m) - 1, _ROWS_AT_ONCE)
    return np.concatenate(
        [_halved(cell_maxima(nodes_m[first : first + _ROWS_AT_ONCE + 1], hole_m)) for first in firsts]
    )


def _halved(blocks: FloatArray) -> FloatArray:
    rows, columns = blocks.shape
    even = np.pad(blocks, ((0, rows % 2), (0, columns % 2)), constant_values=-np.inf)
    pairs = np.maximum(even[0::2], even[1::2])
    return np.maximum(pairs[:, 0::2], pairs[:, 1::2])
