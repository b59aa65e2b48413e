"""Detection: groups of strong bins in a spectrum, their targets, and noise peaks elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.false_alarms import draw_alarms, insert_alarms
from lidar_emu.fmcw.peak_interpolation import peak
from lidar_emu.fmcw.peak_shape import peak_shape, width_bin2
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.spectrum import BIN, NOISE, POWER, TAPS
from lidar_emu.fmcw.volume_light import COMPUTED_DUST_BINS, has_band
from lidar_emu.fmcw.volume_peaks import draw_volume_peaks
from lidar_emu.fmcw.workspace import MAX_TARGETS, SpectrumWorkspace, Workspace
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel


@kernel(inline="always")
def find_targets(
    model: ReceiverModel, work: Workspace, spectra: SpectrumWorkspace, beam: Any, segment: int, count: int
) -> int:
    """Fill `work.targets[segment]`, strongest first.

    Args:
        count: bins in use, 0 without light.

    Returns:
        Number of targets, MAX_TARGETS at most.
    """
    targets = work.targets[segment]
    highest = 0.0
    noisiest = 0.0
    for j in range(count):
        highest = max(highest, spectra.grid[POWER, j])
        noisiest = max(noisiest, spectra.grid[NOISE, j])
    if count == 0:
        noisiest = 1.0
    computed = float(max(0, count - 2 * TAPS))
    alarms = draw_alarms(model, beam, segment, highest, noisiest, computed, work.alarms)
    if alarms > 0:
        highest = max(highest, work.alarms[0].power)
    peaks = 0
    if has_band(beam):
        computed_m = model.haze.computed_range_m
        peaks = draw_volume_peaks(model, work, beam, segment, computed_m, COMPUTED_DUST_BINS, highest)
        if peaks > 0:
            highest = max(highest, work.volume_peaks[0].power)
    groups = find_groups(
        spectra.grid[POWER, :count],
        spectra.grid[NOISE, :count],
        model.threshold * model.noise_power,
        model.group_power_share * highest,
        spectra.peaks,
    )
    for g in range(groups):
        _set_target(model, spectra, spectra.peaks[g], count, targets[g])
    groups = insert_alarms(model, work.alarms[:alarms], highest, targets, groups)
    return insert_alarms(model, work.volume_peaks[:peaks], highest, targets, groups)


@kernel(inline="always")
def _set_target(model: ReceiverModel, spectra: SpectrumWorkspace, j: int, count: int, target: Any) -> None:
    offset, variance = peak(
        model.peak_method,
        spectra.grid,
        spectra.bins,
        j,
        model.window_centre,
        model.window_side,
        model.fft_length,
    )
    target.frequency_bin = spectra.grid[BIN, j] + offset
    target.variance_bin2 = variance
    shape = peak_shape(spectra.grid, spectra.bins, j, model.fft_length)
    target.quadrature_bin, target.quadrature_bin2 = shape.quadrature_bin, shape.quadrature_bin2
    target.quadrature_variance_bin2, target.drift_bin = shape.quadrature_variance_bin2, shape.drift_bin
    target.width_bin2 = width_bin2(spectra.grid, j, count, model.noise_power)
    target.power_over_noise = spectra.grid[POWER, j] / (spectra.grid[NOISE, j] * model.noise_power)
    target.power = spectra.grid[POWER, j]


@kernel
def find_groups(
    power: FloatArray, noise: FloatArray, threshold: float, floor: float, peaks: NDArray[np.int64]
) -> int:
    """Contiguous bins above a floor, with a peak above the threshold.

    Args:
        power: (bins,) powers, with 0 at the end and between separate intervals.
        noise: (bins,) mean power of the noise, in any unit.
        threshold: minimum power of a group's peak relative to its noise.
        floor: minimum power of a group's bins.
        peaks: (MAX_TARGETS,) receives the indices of the groups' highest bins, strongest first.

    Returns:
        Number of groups, at most MAX_TARGETS.
    """
    # Variables instead of literals, for which numba would compile `_keep` once more.
    count, peak = int(np.int64(0)), int(np.int64(-1))
    for j in range(len(power)):
        if power[j] > floor:
            if peak < 0 or power[j] > power[peak]:
                peak = j
        elif peak >= 0:
            if power[peak] > threshold * noise[peak]:
                count = _keep(power, peak, peaks, count)
            peak = -1
    return count


@kernel
def _keep(power: FloatArray, peak: int, peaks: NDArray[np.int64], count: int) -> int:
    """Insert a peak among the `count` strongest; of equal ones the first stays ahead."""
    place = count
    while place > 0 and power[peaks[place - 1]] < power[peak]:
        if place < MAX_TARGETS:
            peaks[place] = peaks[place - 1]
        place -= 1
    if place < MAX_TARGETS:
        peaks[place] = peak
    return min(count + 1, MAX_TARGETS)
