"""Back-reflection of window and optics: a steady line at the beat of a short range, in the chirps alone.

It stays where it is, so that the constant segment has it at frequency 0, and its delay is too short for the laser's
phase noise. Its interferometric phase is drawn for each record.
"""

from __future__ import annotations

from math import copysign, sqrt

import numpy as np

from lidar_emu.numerics.arrays import SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import BACK_REFLECTION, uniform_pair, unit_phasor
from lidar_emu.numerics.vectors import sin_pi
from lidar_emu.receiver.analog_response import tone_gain
from lidar_emu.receiver.beat_tones import signed_bin
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.spectrum import BIN, fold


@kernel
def reflection_bin(model: ReceiverModel, segment: int) -> float:
    """Signed beat in bins."""
    return float(signed_bin(model, segment, model.back_reflection.range_m, 0.0))


@kernel
def reflection_power(model: ReceiverModel, segment: int) -> float:
    """Power behind the poles, relative to the mean noise power of a rectangular bin ahead of them."""
    gain_re, gain_im = tone_gain(model.response, reflection_bin(model, segment))
    return float(model.back_reflection.snr * (gain_re * gain_re + gain_im * gain_im))


@kernel
def add_reflection(
    model: ReceiverModel,
    beam: Beam,
    segment: int,
    look: int,
    gain: float,
    grid: SingleArray,
    count: int,
    bins: SingleArray,
) -> None:
    """Add the line to the first `count` bins of a record; see `set_tones`.

    Args:
        gain: gain of a clipping digitiser.
    """
    beat = reflection_bin(model, segment)
    gain_re, gain_im = tone_gain(model.response, beat)
    turn, _ = uniform_pair(beam.seed, beam.shot, beam.beam, BACK_REFLECTION, segment + 3 * look)
    cosine, sine = unit_phasor(turn)
    observed_bin, factor_re, factor_im = fold(beat, model.fft_length)
    amplitude = gain * sqrt(model.back_reflection.snr)
    re = factor_re * amplitude * (cosine * gain_re - sine * gain_im)
    im = factor_im * amplitude * (cosine * gain_im + sine * gain_re)
    n = np.rint(observed_bin)
    rest = copysign(max(abs(observed_bin - n), 1e-18), observed_bin - n)
    sign = -1.0 if int(n) & 1 else 1.0
    scale = sign * sin_pi(rest) / model.fft_length
    for j in range(count):
        near = scale / sin_pi(((n - grid[BIN, j]) + rest) / model.fft_length)
        image = scale / sin_pi(((n + grid[BIN, j]) + rest) / model.fft_length)
        bins[0, j] += np.float32(re * (near + image))
        bins[1, j] += np.float32(im * (near - image))
