"""Targets of one segment: groups of bins around the tones, and peaks of the noise elsewhere."""

from __future__ import annotations

from math import pi, sin

import numpy as np

from lidar_emu.fmcw.beam_filter import line_variance
from lidar_emu.fmcw.detect import MAX_GROUPS, find_groups
from lidar_emu.fmcw.false_alarms import exceeding_bins, noise_peak
from lidar_emu.fmcw.model import ReceiverModel, Workspace
from lidar_emu.fmcw.peaks import BIN_CENTRE, BIN_VARIANCE, peak
from lidar_emu.fmcw.response import noise_level
from lidar_emu.fmcw.spectrum import BIN, NOISE, POWER, TAPS
from lidar_emu.fmcw.tones import RANGE_M
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import FALSE_ALARM

_PEAK_VARIANCE_TIMES_SNR = 0.5
"""Of the estimators that resolve part of a bin, for peaks in noise, whose bins are not computed."""


@kernel(inline="always")
def find_targets(
    model: ReceiverModel, work: Workspace, count: int, segment: int, shot: int, beam: int, seed: np.uint64
) -> int:
    """Fill `work.targets[segment]` with frequency, its variance and power over noise, strongest first.

    Args:
        count: bins in use, 0 without light.

    Returns:
        Number of targets, MAX_GROUPS at most.
    """
    targets = work.targets[segment]
    highest = 0.0
    noisiest = 0.0
    for j in range(count):
        highest = max(highest, work.grid[POWER, j])
        noisiest = max(noisiest, work.grid[NOISE, j])
    if count == 0:
        noisiest = 1.0
    computed = float(max(0, count - 2 * TAPS))
    alarms = draw_alarms(model, highest, noisiest, computed, segment, shot, beam, seed, work.alarms)
    if alarms > 0:
        highest = max(highest, work.alarms[0, 0])
    groups = find_groups(
        work.grid[POWER, :count],
        work.grid[NOISE, :count],
        model.threshold * model.noise_power,
        model.group_power_share * highest,
        work.peaks,
    )
    for g in range(groups):
        _set_target(model, work, work.peaks[g], targets[g])
        if model.peak_method != BIN_CENTRE:
            # The estimators know of noise only.
            targets[g, 1] += line_variance(model, work.beamlets[RANGE_M, 0]) / model.looks
    return insert_alarms(model, work.alarms[:alarms], highest, targets, groups)


@kernel(inline="always")
def _set_target(model: ReceiverModel, work: Workspace, j: int, target: FloatArray) -> None:
    offset, variance = peak(
        model.peak_method,
        work.grid,
        work.bins,
        j,
        model.window_centre,
        model.window_side,
        model.fft_length,
    )
    target[0] = work.grid[BIN, j] + offset
    target[1] = variance
    target[2] = work.grid[POWER, j] / (work.grid[NOISE, j] * model.noise_power)
    target[3] = work.grid[POWER, j]


@kernel
def draw_alarms(
    model: ReceiverModel,
    highest: float,
    noisiest: float,
    computed: float,
    segment: int,
    shot: int,
    beam: int,
    seed: np.uint64,
    alarms: FloatArray,
) -> int:
    """Peaks of noise above the threshold in bins that are not computed, unless the echo leaves them no chance.

    Args:
        highest: power of the echo's highest bin.
        noisiest: mean noise power of the rectangular bins there.
        computed: bins that are computed.
        alarms: (MAX_GROUPS, 3) receives power, bin, and power over noise.

    Returns:
        Their number.
    """
    # In units of the mean noise power of a windowed bin; the noise elsewhere may be twice as strong as here.
    floor = max(model.threshold, model.group_power_share * highest / (2.0 * noisiest * model.noise_power))
    bins = (0.5 * model.fft_length - 1.0 - computed) * model.independent_share
    if bins < 1.0 or exceeding_bins(model.looks, floor, bins) <= model.least_false_alarm:
        return 0
    below = np.inf
    for a in range(MAX_GROUPS):
        below, place = noise_peak(
            model.looks, below, max(1.0, bins - a), seed, shot, beam, FALSE_ALARM, MAX_GROUPS * segment + a
        )
        if below <= model.threshold:
            return a
        k = 1.0 + place * (0.5 * model.fft_length - 2.0)
        if model.peak_method == BIN_CENTRE:
            k = np.rint(k)
        level = noise_level(model.response, 1.0, 0.0, k, sin(pi * k / model.fft_length))
        alarms[a, 0] = below * level * model.noise_power
        alarms[a, 1] = k
        alarms[a, 2] = below
    return MAX_GROUPS


@kernel(inline="always")
def insert_alarms(
    model: ReceiverModel, alarms: FloatArray, highest: float, targets: FloatArray, count: int
) -> int:
    """Put peaks of noise among the `count` targets, as far as they are near the highest power; the new count."""
    for a in range(len(alarms)):
        if alarms[a, 0] > model.group_power_share * highest:
            count = _insert(model, alarms[a], targets, count)
    return count


@kernel
def _insert(model: ReceiverModel, alarm: FloatArray, targets: FloatArray, count: int) -> int:
    """Put a peak of noise in its place among the `count` strongest targets."""
    place = count
    while place > 0 and targets[place - 1, 3] < alarm[0]:
        if place < MAX_GROUPS:
            for i in range(targets.shape[1]):
                targets[place, i] = targets[place - 1, i]
        place -= 1
    if place < MAX_GROUPS:
        exact = model.peak_method != BIN_CENTRE
        targets[place, 0] = alarm[1]
        targets[place, 1] = _PEAK_VARIANCE_TIMES_SNR / alarm[2] if exact else BIN_VARIANCE
        targets[place, 2] = alarm[2]
        targets[place, 3] = alarm[0]
    return min(count + 1, MAX_GROUPS)
