"""The highest bin of a wide line at level `statistical`: tones, the laser's line and noise, bin by bin."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from lidar_emu.fmcw.laser_phase_noise import LineArrays, peak_wanders, walked_taps
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.workspace import LINE_TAPS, MAX_LINES
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal
from lidar_emu.numerics.random_streams import NOISE_BINS
from lidar_emu.numerics.sine import sin_pi_anywhere

_OFF_ZERO = 1e-9
"""Distance in bins from the zeros of denominators, far less than a peak is accurate."""

_LINE_INDICES = 128
"""Random number indices reserved for the laser's line in each record."""


@kernel
def set_line_taps(
    model: ReceiverModel, beam: Any, segment: int, look: int, range_m: float, line: LineArrays
) -> int:
    """Draw the taps of the laser's line in a record where its peak wanders, and return their number on each side; 0
    and a single tap of 1 elsewhere.

    They reach as far as the pedestal has power, 1/τ and twice the linewidth.
    """
    if not peak_wanders(model, range_m):
        line.taps[0, 0], line.taps[1, 0] = 1.0, 0.0
        return 0
    delay = model.delay_per_m * range_m
    half = min(1 + int(1.0 / delay + 2.0 * model.linewidth_bins), LINE_TAPS)
    index = (segment + 3 * look) * _LINE_INDICES
    walked_taps(model.linewidth_bins, delay, beam, index, half, line, line.taps)
    return half


@kernel
def highest_bin(
    model: ReceiverModel,
    beam: Any,
    first_index: int,
    tones: FloatArray,
    centre: float,
    reach: float,
    loss: float,
    noise: float,
    line: LineArrays,
    half: int,
) -> tuple[float, float, float]:
    """Find the highest windowed bin of tones and noise near a place.

    Args:
        first_index: index of the random numbers for the place's bin.
        centre: place in bins from the first tone's whole bin, like the place returned.
        reach: bins on each side that the tones reach.
        loss: amplitude of the tones.
        noise: amplitude of the noise of a rectangular bin.
        line, half: arrays and result of `set_line_taps`.

    Returns:
        Its place, real and imaginary part.
    """
    lit_re, lit_im = line.phasors[0], line.phasors[1]
    lit_sides = min(int(reach), len(lit_re) // 2 - 1)
    _set_windowed_bins(model, tones, np.rint(centre) - lit_sides, 2 * lit_sides + 1, lit_re, lit_im)
    sides = lit_sides + half
    highest, place, highest_re, highest_im = -1.0, np.rint(centre), 0.0, 0.0
    before_x, before_y = _bin_noise(beam, first_index, -sides - 1)
    x, y = _bin_noise(beam, first_index, -sides)
    for side in range(-sides, sides + 1):
        after_x, after_y = _bin_noise(beam, first_index, side + 1)
        k = np.rint(centre) + side
        if 0.0 < tones[0, 0] + k < 0.5 * model.fft_length:
            re = im = 0.0
            for m in range(max(-half, side - lit_sides), min(half, side + lit_sides) + 1):
                tap_re, tap_im = line.taps[0, half + m], line.taps[1, half + m]
                from_re, from_im = lit_re[lit_sides + side - m], lit_im[lit_sides + side - m]
                re += tap_re * from_re - tap_im * from_im
                im += tap_re * from_im + tap_im * from_re
            re = loss * re + noise * (model.window_centre * x + model.window_side * (before_x + after_x))
            im = loss * im + noise * (model.window_centre * y + model.window_side * (before_y + after_y))
            if re * re + im * im > highest:
                highest, place, highest_re, highest_im = re * re + im * im, k, re, im
        before_x, before_y, x, y = x, y, after_x, after_y
    return place, highest_re, highest_im


@kernel
def _bin_noise(beam: Any, first_index: int, side: int) -> tuple[float, float]:
    """Noise of unit power of the bin `side` bins from a line's middle."""
    place = 2 * side if side >= 0 else -2 * side - 1
    x, y = complex_normal(beam.seed, beam.shot, beam.beam, NOISE_BINS, first_index + place * (MAX_LINES + 1))
    return x, y


@kernel
def _set_windowed_bins(
    model: ReceiverModel, tones: FloatArray, first: float, count: int, re: FloatArray, im: FloatArray
) -> None:
    """Set `count` windowed bins of the tones' sum, the first of them `first` bins from the first tone's whole bin."""
    re[:count] = 0.0
    im[:count] = 0.0
    for i in range(tones.shape[1]):
        d = (tones[0, i] - tones[0, 0]) + tones[1, i] - first + _OFF_ZERO
        sine = sin_pi_anywhere(d) / pi
        for k in range(count):
            gain = sine * (model.window_centre / d + 2.0 * model.window_side * d / (d * d - 1.0))
            re[k] += tones[2, i] * gain
            im[k] += tones[3, i] * gain
            d, sine = d - 1.0, -sine
