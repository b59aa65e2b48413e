"""The spectrum of one segment: tones, what motion and the laser's line make of them, noise."""

from __future__ import annotations

from math import ceil, cos, floor, pi, sin

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.fmcw.cauchy import are_close, set_close_tones
from lidar_emu.fmcw.modulation import (
    LEAST_TAPS,
    convolve_taps,
    filter_bins,
    gaussian_line_taps,
    line_taps,
    smear_taps,
)
from lidar_emu.fmcw.model import ReceiverModel, Workspace
from lidar_emu.fmcw.philox import complex_normal, fill_complex_normals, uniform_pair
from lidar_emu.fmcw.response import clipping, set_noise, tone_gain
from lidar_emu.fmcw.speckle import set_weights
from lidar_emu.fmcw.spectrum import (
    BIN,
    NOISE,
    REACH,
    add_noise,
    fold,
    lay_bins,
    mirror_ends,
    set_power,
    set_tones,
)
from lidar_emu.fmcw.tones import AMPLITUDE, RANGE_M, SPEED_MPS, set_segment_tones, signed_bin
from lidar_emu.kernels import njit

PHASE, NOISE_BINS, SPECKLE, LINE, HAZE, FALSE_ALARM = range(1, 7)
"""What a random number is for; part of its counter."""

SEGMENT_INDICES = 2**24
"""Indices kept for the bins of each record; N is at most 2**24."""

_MOST_TAPS = 512


@njit(cache=True)
def smear_bins(model: ReceiverModel, segment: int, speed_mps: float, acceleration_mps2: float) -> float:
    """By how many bins a beat changes during its record: acceleration, and in the chirps migration.

    A scatterer's range changes with its speed, and so does its Doppler shift with the optical frequency: each makes
    half of the chirps' -4Sv/c.
    """
    by_motion = acceleration_mps2 * model.record_time_s / model.speed_bin_mps
    if segment == 1:
        return by_motion
    by_migration = -2.0 * model.beat_bin_per_m * speed_mps * model.record_time_s
    return by_migration - by_motion if segment == 0 else by_migration + by_motion


@njit(cache=True, error_model="numpy")
def widest_filter(model: ReceiverModel, range_m: float, speed_mps: float, acceleration_mps2: float) -> int:
    """Taps on each side that the segments of a beam need; 0 where none does."""
    smear = 0.0
    for segment in range(3):
        smear = max(smear, abs(smear_bins(model, segment, speed_mps, acceleration_mps2)))
    needed = 0.0
    if smear > model.least_smear_bins:
        needed = LEAST_TAPS + floor(0.5 * smear)
    drift = 2.0 * pi * model.linewidth_bins * model.delay_per_m * range_m
    if model.linewidth_bins > 0.0 and (drift > model.least_line_drift or not model.homodyne_line):
        # Wide lines lose their central tap; what remains is as wide as the line itself.
        wide = 0.0 if model.homodyne_line and drift < 0.5 else ceil(2.0 * model.linewidth_bins)
        needed = max(needed, LEAST_TAPS + wide)
    return int(min(needed, float(_MOST_TAPS)))


@njit(cache=True)
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
    haze = 1 if segment == 1 and model.haze.snr_per_m > 0.0 else 0
    tones = count + haze
    # Tones come in fours; those added have no weight.
    padded = -(-tones // 4) * 4
    for look in range(model.looks):
        set_look_tones(
            model, work, count, segment, look, acceleration_mps2, place, drift_per_s, shot, beam, seed
        )
        if haze:
            _set_haze_tone(model, work, count, look, power_w, shot, beam, seed)
        for i in range(tones, padded):
            work.tones[look, :, i] = work.tones[look, :, 0]
            work.tones[look, 2:, i] = 0.0
        work.places[0, look * tones : (look + 1) * tones] = work.tones[look, 0, :tones]
    reach = REACH + max(0, half - LEAST_TAPS)
    every = model.looks * tones
    bins = lay_bins(work.places[0, :every], float(reach), model.fft_length, work.places[1], work.grid)
    variance = model.fft_length / 4.0
    for i in range(count):
        variance += 0.5 * work.beamlets[AMPLITUDE, i] ** 2
    gain, distortion = clipping(model.response, variance, model.fft_length)
    factor = gain * gain * (1.0 + model.signal_shot_per_w * power_w)
    set_noise(model.response, factor, distortion, work.grid, bins)
    if model.haze.snr_per_m > 0.0 and segment != 1:
        _add_haze(model, work, segment, gain, bins)
    for look in range(model.looks):
        _set_look(
            model, work, padded, half, segment, look, smear_acceleration_mps2, gain, bins, shot, beam, seed
        )
    cosine, sine = cos(pi / model.fft_length), sin(pi / model.fft_length)
    set_power(
        model.window_centre, model.window_side, cosine, sine, model.fft_length, work.grid, bins, work.bins
    )
    return bins


@njit(cache=True)
def set_look_tones(
    model: ReceiverModel,
    work: Workspace,
    count: int,
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
    weights = work.weights[:, : count + count % 2]
    if model.speckle:
        east = place[0] + drift_per_s[0] * time_s
        north = place[1] + drift_per_s[1] * time_s
        corners = work.corners[:, :, : weights.shape[1]]
        set_weights(seed, beam, SPECKLE, east, north, work.held, corners, work.words, weights)
    turn, _ = uniform_pair(seed, shot, beam, PHASE, segment + 3 * look)
    set_segment_tones(
        model,
        segment,
        time_records,
        acceleration_mps2,
        turn,
        work.beamlets[:, :count],
        weights,
        work.tones[look, :, :count],
    )


@njit(cache=True)
def _set_look(
    model: ReceiverModel,
    work: Workspace,
    tones: int,
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
    lines = work.tones[look, :, :tones]
    if gain != 1.0:
        for i in range(tones):
            lines[2, i] *= gain
            lines[3, i] *= gain
    if are_close(lines, length, work.grid, count):
        set_close_tones(lines, length, work.grid, count, bins, work.residues)
    else:
        set_tones(lines, length, work.grid, count, bins)
    if half > 0:
        mirror_ends(length, work.grid, count, bins)
        _filter(model, work, half, segment, look, smear_acceleration_mps2, count, shot, beam, seed)
    first = (segment + 3 * look) * SEGMENT_INDICES
    add_noise(seed, shot, beam, NOISE_BINS, first, length, work.grid, count, bins, work.words, work.noise)
    mirror_ends(length, work.grid, count, bins)


@njit(cache=True)
def _filter(
    model: ReceiverModel,
    work: Workspace,
    half: int,
    segment: int,
    look: int,
    smear_acceleration_mps2: float,
    count: int,
    shot: int,
    beam: int,
    seed: np.uint64,
) -> None:
    """Apply smear and the laser's line, those of the two that matter."""
    range_m, speed_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
    smear = smear_bins(model, segment, speed_mps, smear_acceleration_mps2)
    # Wider smears leave the widest filter's bins as empty, and would only take longer to integrate.
    smear = min(max(smear, -2.0 * _MOST_TAPS), 2.0 * _MOST_TAPS)
    drift = 2.0 * pi * model.linewidth_bins * model.delay_per_m * range_m
    width = 2 * half + 1
    by_smear, by_line, both = work.taps[0, :, :width], work.taps[1, :, :width], work.taps[2, :, :width]
    index = (segment + 3 * look) * 4 * _MOST_TAPS
    smeared = abs(smear) > model.least_smear_bins
    lined = model.linewidth_bins > 0.0 and (drift > model.least_line_drift or not model.homodyne_line)
    if lined and model.homodyne_line:
        line_taps(model.linewidth_bins, model.delay_per_m * range_m, seed, shot, beam, LINE, index, half, by_line)
    elif lined:
        gaussian_line_taps(model.linewidth_bins, seed, shot, beam, LINE, index, half, by_line)
    if smeared:
        smear_taps(smear, half, by_smear)
    if smeared and lined:
        convolve_taps(by_smear, by_line, half, both)
    taps = both if smeared and lined else (by_smear if smeared else by_line)
    if smeared or lined:
        beat = signed_bin(model, segment, range_m, speed_mps)
        nearest = beat - model.fft_length * np.rint(beat / model.fft_length)
        filter_bins(taps, half, nearest < 0.0, work.grid, count, work.bins[look], work.filtered)


@njit(cache=True, error_model="numpy")
def _set_haze_tone(
    model: ReceiverModel,
    work: Workspace,
    tone: int,
    look: int,
    power_w: float,
    shot: int,
    beam: int,
    seed: np.uint64,
) -> None:
    """The air's own line in the constant segment: all of it closes with the sensor's speed."""
    beat = signed_bin(model, 1, work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0])
    gain_re, gain_im = tone_gain(model.response, beat)
    observed_bin, factor_re, factor_im = fold(beat, model.fft_length)
    snr = haze_snr(model, work.beamlets[RANGE_M, 0])
    x, y = complex_normal(seed, shot, beam, HAZE, look)
    scale = np.sqrt(snr)
    work.tones[look, 0, tone] = np.rint(observed_bin)
    work.tones[look, 1, tone] = observed_bin - work.tones[look, 0, tone]
    work.tones[look, 2, tone] = factor_re * scale * (x * gain_re - y * gain_im)
    work.tones[look, 3, tone] = factor_im * scale * (x * gain_im + y * gain_re)


@njit(cache=True, error_model="numpy")
def haze_snr(model: ReceiverModel, range_m: float) -> float:
    """SNR of the air's light from the sensor to a range: ∫ exp(-2αr) / (1 + (r/z)²) dr, by panels of Simpson's rule."""
    z = model.haze.rayleigh_range_m
    # In the variable atan(r/z) the beam's spreading is gone.
    end = np.arctan(range_m / z)
    panels = 16
    total = 0.0
    for i in range(2 * panels + 1):
        share = 1.0 if i in (0, 2 * panels) else (4.0 if i % 2 == 1 else 2.0)
        r = min(z * np.tan(end * i / (2 * panels)), range_m)
        total += share * np.exp(-2.0 * model.haze.extinction_per_m * r)
    return model.haze.snr_per_m * z * total * end / (6.0 * panels)


@njit(cache=True, error_model="numpy")
def _add_haze(model: ReceiverModel, work: Workspace, segment: int, gain: float, count: int) -> None:
    """The air's light in a chirp: each range has its own beat, so that it adds to the noise of each bin."""
    farthest_m, speed_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
    zero = signed_bin(model, segment, 0.0, speed_mps)
    scale = gain * gain * model.haze.snr_per_m / model.beat_bin_per_m
    for j in range(count):
        k = work.grid[BIN, j]
        for sign in (-1.0, 1.0):
            r = (sign * k - zero) / model.beat_bin_per_m
            if 0.0 < r < farthest_m:
                spread = 1.0 + (r / model.haze.rayleigh_range_m) ** 2
                work.grid[NOISE, j] += scale * np.exp(-2.0 * model.haze.extinction_per_m * r) / spread
