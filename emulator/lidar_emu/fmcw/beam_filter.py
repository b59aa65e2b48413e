"""The filter over bins of one beam's record: smear by motion and the laser's line, where they matter."""

from __future__ import annotations

from math import ceil, erf, exp, floor, log, pi, sqrt

import numpy as np

from lidar_emu.fmcw.model import ReceiverModel, Workspace
from lidar_emu.fmcw.modulation import (
    LEAST_TAPS,
    convolve_taps,
    filter_bins,
    gaussian_line_taps,
    line_taps,
    smear_taps,
)
from lidar_emu.fmcw.tones import RANGE_M, SPEED_MPS, signed_bin
from lidar_emu.numerics.kernels import kernel

_MOST_TAPS = 512
_INDICES = 4 * _MOST_TAPS

_MOST_SMEAR_BINS = 128.0
"""Beats that change by more are spread over so many bins, and are as weak there as they would be."""


@kernel
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


@kernel
def line_variance(model: ReceiverModel, range_m: float) -> float:
    """Variance in bins² of a beat's frequency by the laser's white frequency noise over the delay, 6Δν τ²/π."""
    delay = model.delay_per_m * range_m
    return 6.0 * model.linewidth_bins / pi * delay * delay if model.homodyne_line else 0.0


@kernel
def line_share(model: ReceiverModel, range_m: float) -> float:
    """Share of the echo's power that the laser's line leaves in its central bin."""
    if model.homodyne_line or model.linewidth_bins == 0.0:
        return exp(-_drift(model, range_m))
    return erf(0.5 * sqrt(4.0 * log(2.0)) / model.linewidth_bins)


@kernel
def widest_filter(model: ReceiverModel, range_m: float, speed_mps: float, acceleration_mps2: float) -> int:
    """Taps on each side that the segments of a beam need; 0 where none does."""
    smear = 0.0
    for segment in range(3):
        smear = max(smear, abs(smear_bins(model, segment, speed_mps, acceleration_mps2)))
    needed = 0.0
    if smear > model.least_smear_bins:
        needed = LEAST_TAPS + floor(0.5 * min(smear, _MOST_SMEAR_BINS))
    if _line_matters(model, range_m):
        # Wide lines lose their central tap; what remains is as wide as the line itself.
        narrow = model.homodyne_line and _drift(model, range_m) < 0.5
        needed = max(needed, LEAST_TAPS + (0.0 if narrow else ceil(2.0 * model.linewidth_bins)))
    return int(min(needed, float(_MOST_TAPS)))


@kernel(inline="always")
def filter_beam(
    model: ReceiverModel,
    work: Workspace,
    half: int,
    segment: int,
    look: int,
    smear_acceleration_mps2: float,
    count: int,
    purpose: int,
    shot: int,
    beam: int,
    seed: np.uint64,
) -> None:
    """Apply smear and the laser's line, those of the two that matter, to the bins of one record."""
    range_m, speed_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
    by_smear, by_line, both = work.taps[0], work.taps[1], work.taps[2]
    smear = smear_bins(model, segment, speed_mps, smear_acceleration_mps2)
    smeared, lined = abs(smear) > model.least_smear_bins, _line_matters(model, range_m)
    index = (segment + 3 * look) * _INDICES
    if lined and model.homodyne_line:
        delay = model.delay_per_m * range_m
        line_taps(model.linewidth_bins, delay, seed, shot, beam, purpose, index, half, by_line)
    elif lined:
        gaussian_line_taps(model.linewidth_bins, seed, shot, beam, purpose, index, half, by_line)
    if smeared:
        computed = min(max(smear, -_MOST_SMEAR_BINS), _MOST_SMEAR_BINS)
        smear_taps(computed, half, by_smear)
        if computed != smear:
            for part in range(2):
                for m in range(2 * half + 1):
                    by_smear[part, m] *= sqrt(computed / smear)
    if smeared and lined:
        convolve_taps(by_smear, by_line, half, both)
    taps = both if smeared and lined else (by_smear if smeared else by_line)
    if smeared or lined:
        beat = signed_bin(model, segment, range_m, speed_mps)
        nearest = beat - model.fft_length * np.rint(beat / model.fft_length)
        filter_bins(taps, half, nearest < 0.0, work.grid, count, work.bins[look], work.filtered)


@kernel
def _drift(model: ReceiverModel, range_m: float) -> float:
    """Variance of the phase that the laser drifts within the echo's delay."""
    return 2.0 * pi * model.linewidth_bins * model.delay_per_m * range_m


@kernel
def _line_matters(model: ReceiverModel, range_m: float) -> bool:
    if model.linewidth_bins == 0.0 or not model.homodyne_line:
        return model.linewidth_bins > 0.0
    scattered = line_variance(model, range_m) > model.least_line_scatter_bins**2
    return scattered or _drift(model, range_m) > model.least_line_drift
