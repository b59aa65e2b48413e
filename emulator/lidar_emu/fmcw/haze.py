"""Haze as a target: a band of random bins in the chirps, from zero range to the surface, and a line in the constant
segment.

All haze on a beam has the closing speed of the air. In a chirp each range has its own beat: particles at random places
make every rectangular bin of the band a circular Gaussian number of its own, of the mean power

    p(r) = s c df/(2S) exp(-2αr)/(1 + (r/z)²),   s the SNR per metre at the sensor:

noise with a spectrum of its own, which the instrument's threshold does not know. In the constant segment the whole band
is one line of ∫ p dr.
"""

from __future__ import annotations

from math import atan, exp, sqrt, tan
from typing import Any

import numpy as np

from lidar_emu.fmcw.analog_response import tone_gain
from lidar_emu.fmcw.beat_tones import signed_bin, speed_change_mps
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.spectrum import fold
from lidar_emu.fmcw.workspace import SEGMENT_INDICES
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal
from lidar_emu.numerics.random_streams import HAZE

_PANELS = 16


@kernel
def haze_snr(model: ReceiverModel, range_m: float) -> float:
    """SNR of the backscatter from the sensor to a range: ∫ exp(-2αr) / (1 + (r/z)²) dr, by panels of Simpson's rule."""
    z = model.haze.rayleigh_range_m
    # The substitution atan(r/z) removes the beam's divergence.
    end = atan(range_m / z)
    total = 0.0
    for i in range(2 * _PANELS + 1):
        share = 1.0 if i in (0, 2 * _PANELS) else (4.0 if i % 2 == 1 else 2.0)
        r = min(z * tan(end * i / (2 * _PANELS)), range_m)
        total += share * exp(-2.0 * model.haze.extinction_per_m * r)
    snr: float = model.haze.snr_per_m * z * total * end / (6.0 * _PANELS)
    return snr


@kernel
def set_haze_tone(model: ReceiverModel, beam: Any, look: int, time_s: float, tones: FloatArray) -> None:
    """Set the line of the haze in the constant segment, as the last of a record's tones (4, tones)."""
    beat = signed_bin(model, 1, 0.0, beam.air_speed_mps + speed_change_mps(beam, time_s))
    gain_re, gain_im = tone_gain(model.response, beat)
    observed_bin, factor_re, factor_im = fold(beat, model.fft_length)
    x, y = complex_normal(beam.seed, beam.shot, beam.beam, HAZE, (1 + 3 * look) * SEGMENT_INDICES // 2)
    scale = sqrt(beam.haze_snr)
    tone = tones[:, -1]
    tone[0] = np.rint(observed_bin)
    tone[1] = observed_bin - tone[0]
    tone[2] = factor_re * scale * (x * gain_re - y * gain_im)
    tone[3] = factor_im * scale * (x * gain_im + y * gain_re)


@kernel
def haze_power(model: ReceiverModel, zero: float, end: float, beat: float) -> float:
    """Mean power of the haze in the rectangular bin at a signed beat, for a band from beat `zero` to `end`."""
    filled = min(beat + 0.5, end) - max(beat - 0.5, zero)
    if filled <= 0.0:
        return 0.0
    r = max(0.0, min(beat, end) - zero) / model.beat_bin_per_m
    spread = 1.0 + (r / model.haze.rayleigh_range_m) ** 2
    gain_re, gain_im = tone_gain(model.response, beat)
    passed = (gain_re * gain_re + gain_im * gain_im) * model.haze.snr_per_m / model.beat_bin_per_m
    return min(1.0, filled) * passed * exp(-2.0 * model.haze.extinction_per_m * r) / spread
