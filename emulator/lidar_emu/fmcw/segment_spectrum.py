"""The spectrum of one segment: tones, what motion and the laser's line make of them, noise."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

from lidar_emu.fmcw.beat_tones import set_segment_tones
from lidar_emu.fmcw.bin_filter import filter_beam
from lidar_emu.fmcw.close_tones import are_close, set_close_tones
from lidar_emu.fmcw.haze import add_haze, set_haze_tone
from lidar_emu.fmcw.motion_smear import LEAST_TAPS
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.response import clipping, set_noise
from lidar_emu.fmcw.speckle import set_weights
from lidar_emu.fmcw.spectrum import REACH, add_noise, lay_bins, mirror_ends, set_power, set_tones
from lidar_emu.fmcw.workspace import Workspace
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import uniform_pair
from lidar_emu.numerics.random_streams import HAZE, LINE, NOISE_BINS, PHASE, SPECKLE

SEGMENT_INDICES = 2**24
"""Indices kept for the bins of each record; N is at most 2**24."""


@kernel(inline="always")
def set_spectrum(
    model: ReceiverModel,
    work: Workspace,
    count: int,
    half: int,
    segment: int,
    acceleration_mps2: float,
    smear_acceleration_mps2: float,
    place: FloatArray,
    drift_per_s: FloatArray,
    power_w: float,
    shot: int,
    beam: int,
    seed: np.uint64,
) -> int:
    """Fill grid and bins of `work` with one segment of one beam.

    Args:
        count: beamlets in `work`; 0 for a beam without any light.
        half: taps that `widest_filter` gives.
        power_w: of all beamlets.

    Returns:
        The number of bins; 0 without light.
    """
    if count == 0:
        return 0
    haze = segment == 1 and model.haze.snr_per_m > 0.0
    tones = work.tones.shape[2]
    for look in range(model.looks):
        set_look_tones(model, work, segment, look, acceleration_mps2, place, drift_per_s, shot, beam, seed)
        if haze:
            set_haze_tone(model, work, look, HAZE, shot, beam, seed)
        for i in range(tones):
            work.places[0, look * tones + i] = work.tones[look, 0, i]
    reach = REACH + max(0, half - LEAST_TAPS)
    bins = lay_bins(work.places[0], float(reach), model.fft_length, work.places[1], work.grid)
    gain, distortion = clipping(model.response, work.tones[0], model.fft_length)
    factor = gain * gain * (1.0 + model.signal_shot_per_w * power_w)
    set_noise(model.response, factor, distortion, work.grid, bins)
    if model.haze.snr_per_m > 0.0 and segment != 1:
        add_haze(model, work, segment, gain, bins)
    for look in range(model.looks):
        _set_look(model, work, half, segment, look, smear_acceleration_mps2, gain, bins, shot, beam, seed)
    cosine, sine = cos(pi / model.fft_length), sin(pi / model.fft_length)
    set_power(
        model.window_centre, model.window_side, cosine, sine, model.fft_length, work.grid, bins, work.bins
    )
    return bins


@kernel(inline="always")
def set_look_tones(
    model: ReceiverModel,
    work: Workspace,
    segment: int,
    look: int,
    acceleration_mps2: float,
    place: FloatArray,
    drift_per_s: FloatArray,
    shot: int,
    beam: int,
    seed: np.uint64,
) -> None:
    """Tones of one record, with the speckle of its own time and a phase common to the beam."""
    time_records = (segment - 1) * model.segment_records
    time_records += (look - 0.5 * (model.looks - 1)) * model.cycle_records
    time_s = time_records * model.record_time_s
    if model.speckle:
        east = place[0] + drift_per_s[0] * time_s
        north = place[1] + drift_per_s[1] * time_s
        set_weights(seed, beam, SPECKLE, east, north, work.held, work.corners, work.words, work.weights)
    turn, _ = uniform_pair(seed, shot, beam, PHASE, segment + 3 * look)
    beamlets, tones = work.beamlets, work.tones[look]
    set_segment_tones(model, segment, time_records, acceleration_mps2, turn, beamlets, work.weights, tones)


@kernel(inline="always")
def _set_look(
    model: ReceiverModel,
    work: Workspace,
    half: int,
    segment: int,
    look: int,
    smear_acceleration_mps2: float,
    gain: float,
    count: int,
    shot: int,
    beam: int,
    seed: np.uint64,
) -> None:
    """Bins of one record: light, filter, noise."""
    length, bins = model.fft_length, work.bins[look]
    lines = work.tones[look]
    if gain != 1.0:
        for i in range(lines.shape[1]):
            lines[2, i] *= gain
            lines[3, i] *= gain
    if are_close(length, work.grid, count):
        set_close_tones(lines, length, work.grid, count, bins, work.residues)
    else:
        set_tones(lines, length, work.grid, count, bins)
    if half > 0:
        mirror_ends(length, work.grid, count, bins)
        filter_beam(model, work, half, segment, look, smear_acceleration_mps2, count, LINE, shot, beam, seed)
    first = (segment + 3 * look) * SEGMENT_INDICES
    add_noise(seed, shot, beam, NOISE_BINS, first, length, work.grid, count, bins, work.words, work.noise)
    mirror_ends(length, work.grid, count, bins)
