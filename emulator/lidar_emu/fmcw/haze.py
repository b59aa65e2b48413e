"""Backscatter of the atmosphere: a line in the constant segment, additional noise in the chirps."""

from __future__ import annotations

from typing import Any

import numpy as np

from lidar_emu.fmcw.analog_response import tone_gain
from lidar_emu.fmcw.beat_tones import RANGE_M, SPEED_MPS, signed_bin
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.spectrum import BIN, NOISE, fold
from lidar_emu.fmcw.workspace import Workspace
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal
from lidar_emu.numerics.random_streams import HAZE

_PANELS = 16


@kernel(inline="always")
def set_haze_tone(
    model: ReceiverModel,
    work: Workspace,
    beam: Any,
    look: int,
    tones: FloatArray,
) -> None:
    """Set the line of the haze in the constant segment, where all of it has the sensor's closing speed, as the last
    tone."""
    beat = signed_bin(model, 1, work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0])
    gain_re, gain_im = tone_gain(model.response, beat)
    observed_bin, factor_re, factor_im = fold(beat, model.fft_length)
    snr = haze_snr(model, work.beamlets[RANGE_M, 0])
    x, y = complex_normal(beam.seed, beam.shot, beam.beam, HAZE, look)
    scale = np.sqrt(snr)
    tone = tones[:, -1]
    tone[0] = np.rint(observed_bin)
    tone[1] = observed_bin - tone[0]
    tone[2] = factor_re * scale * (x * gain_re - y * gain_im)
    tone[3] = factor_im * scale * (x * gain_im + y * gain_re)


@kernel
def haze_snr(model: ReceiverModel, range_m: float) -> float:
    """SNR of the backscatter from the sensor to a range: ∫ exp(-2αr) / (1 + (r/z)²) dr, by panels of Simpson's rule."""
    z = model.haze.rayleigh_range_m
    # The substitution atan(r/z) removes the beam's divergence.
    end = np.arctan(range_m / z)
    total = 0.0
    for i in range(2 * _PANELS + 1):
        share = 1.0 if i in (0, 2 * _PANELS) else (4.0 if i % 2 == 1 else 2.0)
        r = min(z * np.tan(end * i / (2 * _PANELS)), range_m)
        total += share * np.exp(-2.0 * model.haze.extinction_per_m * r)
    snr: float = model.haze.snr_per_m * z * total * end / (6.0 * _PANELS)
    return snr


@kernel(inline="always")
def add_haze(
    model: ReceiverModel, work: Workspace, grid: FloatArray, segment: int, gain: float, count: int
) -> None:
    """Add the backscatter in a chirp: each range has its own beat, so that it adds to the noise of each bin."""
    farthest_m, speed_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
    zero = signed_bin(model, segment, 0.0, speed_mps)
    scale = gain * gain * model.haze.snr_per_m / model.beat_bin_per_m
    for j in range(count):
        k = grid[BIN, j]
        # Signed beats that appear in bin k: k itself, its mirror image, and those beyond N/2.
        for beat in (k, -k, model.fft_length - k, k - model.fft_length):
            r = (beat - zero) / model.beat_bin_per_m
            if 0.0 < r < farthest_m:
                gain_re, gain_im = tone_gain(model.response, beat)
                passed = scale * (gain_re * gain_re + gain_im * gain_im)
                spread = 1.0 + (r / model.haze.rayleigh_range_m) ** 2
                grid[NOISE, j] += passed * np.exp(-2.0 * model.haze.extinction_per_m * r) / spread
