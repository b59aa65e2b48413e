"""Records as samples, and their bins by numpy's FFT: the slow way."""

from __future__ import annotations

import numpy as np

from lidar_emu.receiver.spectrum import NOISE, REACH, ROWS, grid_capacity, lay_bins

COSINES = {"rect": (1.0, 0.0), "hann": (0.5, 0.5), "hamming": (0.54, 0.46)}
"""Windows a - b cos(2πn/N)."""


def tones_in_time(signed_bin: np.ndarray, weight: np.ndarray, length: int) -> np.ndarray:
    """Real samples of tones that have the phase of `weight` at the record's centre."""
    n = np.arange(length, dtype=np.longdouble) - np.longdouble(length - 1) / 2
    samples = np.zeros(length)
    for place, w in zip(signed_bin, weight, strict=True):
        turns = np.longdouble(place) / length * n
        phase = 2 * np.pi * (turns - np.rint(turns)).astype(float)
        samples += w.real * np.cos(phase) - w.imag * np.sin(phase)
    return samples


def fft_bins(samples: np.ndarray, window: str) -> np.ndarray:
    """Bins 0 to N/2, scaled so that a tone of unit amplitude on its bin gives the window's mean."""
    length = samples.shape[-1]
    a, b = COSINES[window]
    weights = a - b * np.cos(2 * np.pi * np.arange(length) / length)
    return np.fft.rfft(samples * weights) / (length / 2)


def laid_intervals(tone_bin: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Bins laid around tones, with unit noise, in whole vectors, and the ends of their intervals."""
    places = tone_bin.astype(np.float32)
    grid = np.zeros((ROWS, grid_capacity(len(places), REACH, length)), dtype=np.float32)
    ends = np.zeros(len(places) + 1, dtype=np.int64)
    count = lay_bins(places, float(REACH), float(length), np.empty_like(places), grid, ends)
    grid[NOISE] = 1.0
    return grid[:, : -(-count // 8) * 8].copy(), ends
