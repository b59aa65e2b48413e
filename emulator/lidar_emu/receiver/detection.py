"""Detection: groups of strong bins in a spectrum, their targets, and noise peaks elsewhere."""

from __future__ import annotations

from math import exp, expm1, log, log1p, pi, sin

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, IntArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import HAZE, uniform_pair
from lidar_emu.receiver.analog_response import noise_level, unclipped_noise
from lidar_emu.receiver.false_alarms import draw_alarms, insert_alarms, set_random_peak
from lidar_emu.receiver.peak_interpolation import peak
from lidar_emu.receiver.peak_shape import peak_shape, width_bin2
from lidar_emu.receiver.probability import minus_log_exceedance
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import MAX_TARGETS, Beam, SpectrumTarget
from lidar_emu.receiver.spectrum import BIN, NOISE, POWER, SEGMENT_INDICES, TAPS, fold, whole_vectors
from lidar_emu.receiver.volume_light import COMPUTED_DUST_BINS, dust_ends, dust_power, has_band, haze_power
from lidar_emu.receiver.workspace import Workspace

HAZE_NODES, DUST_NODES = 48, 16
"""Parts of the bands over which the distribution of their highest bin is summed."""

_BINS, _MEAN, _NOISE, _FIRST, _BEATS = range(5)
"""Columns of a node: independent bins, mean power of each, and of its noise, first beat and number of beats."""

_HALVINGS = 16


@kernel
def draw_volume_peaks(
    model: ReceiverModel,
    work: Workspace,
    beam: Beam,
    segment: int,
    from_m: float,
    from_bins: float,
    highest: float,
) -> int:
    """Draw the highest bins of the bands, those above the threshold and near the highest power.

    The bins' powers are independent and exponential around their means: none of them exceeds p with the probability
    exp(-g(p)), g = -Σ ln(1 - Q(p/mean)). The powers at which g is the sum of one, two, ... exponential numbers are the
    highest, the second highest and so on. Windows correlate neighbours: fewer bins count.

    Args:
        from_m: range at which the part of the haze begins that is not computed.
        from_bins: width of a band of dust above which it is not computed.
        highest: power of the highest bin elsewhere.

    Returns:
        Number of peaks, in `work.volume_peaks` in descending order of power.
    """
    count = _set_haze_nodes(model, beam, from_m, work.volume_nodes)
    if beam.dust_snr > 0.0:
        first, last = dust_ends(beam)
        if last - first > from_bins:
            count = _set_dust_nodes(model, beam, work.volume_nodes, count)
    if count == 0:
        return 0
    nodes = work.volume_nodes[:count]
    floor = model.group_power_share * highest / model.noise_power
    expected = _exceedances(model, nodes, floor)
    if expected <= model.least_false_alarm:
        return 0
    total, power = 0.0, floor
    for i in range(MAX_TARGETS):
        index = (segment + 1) * SEGMENT_INDICES - 1 - 2 * i
        u, choice = uniform_pair(beam.seed, beam.shot, beam.beam, HAZE, index)
        total -= log(u)
        if total >= expected:
            return i
        power = _power_exceeded(model, nodes, total, floor)
        if i == 0:
            floor = max(floor, model.group_power_share * power)
            expected = _exceedances(model, nodes, floor)
        node = nodes[_choose_node(model, nodes, power, choice)]
        place, _ = uniform_pair(beam.seed, beam.shot, beam.beam, HAZE, index - 1)
        k, _, _ = fold(node[_FIRST] + place * node[_BEATS], model.fft_length)
        set_random_peak(model, k, power / node[_NOISE], power * model.noise_power, work.volume_peaks[i])
    return MAX_TARGETS


@kernel
def _set_haze_nodes(model: ReceiverModel, beam: Beam, from_m: float, nodes: FloatArray) -> int:
    span_m = beam.haze_range_m - from_m
    zero, end = beam.haze_beats[0], beam.haze_beats[1]
    if span_m <= 0.0 or end <= zero:
        return 0
    decay_per_m = 2.0 * model.haze.extinction_per_m + 1.0 / model.haze.rayleigh_range_m
    rise_m = min(span_m, 1.0 / (20.0 * decay_per_m))
    growth = log1p(span_m / rise_m)
    for i in range(HAZE_NODES):
        first_m = from_m + rise_m * expm1(growth * i / HAZE_NODES)
        last_m = from_m + rise_m * expm1(growth * (i + 1) / HAZE_NODES)
        middle = zero + (from_m + rise_m * expm1(growth * (i + 0.5) / HAZE_NODES)) * model.beat_bin_per_m
        mean = haze_power(model, zero, np.inf, middle)
        first = zero + first_m * model.beat_bin_per_m
        _set_node(model, first, (last_m - first_m) * model.beat_bin_per_m, middle, mean, nodes[i])
    return HAZE_NODES


@kernel
def _set_dust_nodes(model: ReceiverModel, beam: Beam, nodes: FloatArray, count: int) -> int:
    first, last = dust_ends(beam)
    width = (last - first) / DUST_NODES
    for i in range(DUST_NODES):
        beat, middle = first + i * width, first + (i + 0.5) * width
        _set_node(model, beat, width, middle, dust_power(model, beam, middle), nodes[count + i])
    return count + DUST_NODES


@kernel
def _set_node(
    model: ReceiverModel, first: float, beats: float, middle: float, mean: float, node: FloatArray
) -> None:
    k, _, _ = fold(middle, model.fft_length)
    noise = noise_level(model.response, 1.0, 1.0, 0.0, k, sin(pi * k / model.fft_length))
    node[_BINS] = beats * model.independent_share if k >= model.lowest_bin else 0.0
    node[_MEAN] = noise + mean
    node[_NOISE] = noise
    node[_FIRST] = first
    node[_BEATS] = beats


@kernel
def _node_exceedances(model: ReceiverModel, nodes: FloatArray, i: int, power: float) -> float:
    """-ln of the probability that no bin of a part exceeds both a power and its threshold."""
    least = max(power, model.threshold * nodes[i, _NOISE]) / nodes[i, _MEAN]
    unlikely = exp(-minus_log_exceedance(model.looks * least, model.looks))
    return -nodes[i, _BINS] * log1p(-unlikely) if unlikely < 1.0 else np.inf


@kernel
def _exceedances(model: ReceiverModel, nodes: FloatArray, power: float) -> float:
    total = 0.0
    for i in range(len(nodes)):
        total += _node_exceedances(model, nodes, i, power)
    return total


@kernel
def _power_exceeded(model: ReceiverModel, nodes: FloatArray, total: float, floor: float) -> float:
    mean = 0.0
    for i in range(len(nodes)):
        mean = max(mean, nodes[i, _MEAN])
    low, step = floor, mean / model.looks
    while _exceedances(model, nodes, low + step) > total:
        low, step = low + step, 2.0 * step
    high = low + step
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _exceedances(model, nodes, middle) > total:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@kernel
def _choose_node(model: ReceiverModel, nodes: FloatArray, power: float, choice: float) -> int:
    """The part whose bin has this power: with a share of the density of `_exceedances` there."""
    total = 0.0
    for i in range(len(nodes)):
        total += _density(model, nodes, i, power)
    left = choice * total
    for i in range(len(nodes)):
        left -= _density(model, nodes, i, power)
        if left <= 0.0:
            return i
    return len(nodes) - 1


@kernel
def _density(model: ReceiverModel, nodes: FloatArray, i: int, power: float) -> float:
    if power <= model.threshold * nodes[i, _NOISE]:
        return 0.0
    step = 1e-3 * nodes[i, _MEAN] / model.looks
    fewer = _node_exceedances(model, nodes, i, power) - _node_exceedances(model, nodes, i, power + step)
    return float(fewer / step)


@kernel
def find_targets(model: ReceiverModel, work: Workspace, beam: Beam, segment: int, count: int) -> int:
    """Fill `work.targets[segment]`, strongest first.

    Args:
        count: bins in use, 0 without light.

    Returns:
        Number of targets, MAX_TARGETS at most.
    """
    targets, grid = work.targets[segment], work.grid[segment]
    wide = whole_vectors(count)
    highest = np.float64(_largest(wide, grid[POWER]))
    noisiest = np.float64(_largest(wide, grid[NOISE])) if count > 0 else 1.0
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
        grid[POWER, :count],
        grid[NOISE, :count],
        model.threshold * model.noise_power,
        model.group_power_share * highest,
        work.peaks,
    )
    for g in range(groups):
        _set_target(model, beam, grid, work.bins[segment], work.peaks[g], count, targets[g])
    groups = insert_alarms(model, work.alarms[:alarms], highest, targets, groups)
    return insert_alarms(model, work.volume_peaks[:peaks], highest, targets, groups)


@kernel(fastmath={"nsz", "nnan"})
def _largest(count: int, values: SingleArray) -> np.float32:
    largest = np.float32(0.0)
    for j in range(count):
        largest = max(largest, values[j])
    return largest


@kernel
def _set_target(
    model: ReceiverModel,
    beam: Beam,
    grid: SingleArray,
    bins: SingleArray,
    j: int,
    count: int,
    target: SpectrumTarget,
) -> None:
    shape = peak_shape(grid, bins, j, model.fft_length)
    offset, variance, shape = peak(model.peak_method, grid, bins, j, model.window, model.fft_length, shape)
    target.frequency_bin = np.float64(grid[BIN, j]) + offset
    target.variance_bin2 = variance
    target.quadrature_bin, target.quadrature_bin2 = shape.quadrature_bin, shape.quadrature_bin2
    target.quadrature_variance_bin2, target.drift_bin = shape.quadrature_variance_bin2, shape.drift_bin
    target.width_bin2 = width_bin2(grid, j, count, model.noise_power)
    target.power = np.float64(grid[POWER, j])
    noise: float = np.float64(grid[NOISE, j])
    if beam.gain < 1.0:
        noise = unclipped_noise(model.response, beam.gain, beam.distortion, noise)
    target.power_over_noise = target.power / (noise * model.noise_power)


@kernel
def find_groups(
    power: SingleArray, noise: SingleArray, threshold: float, floor: float, peaks: IntArray
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
    count, j, least = 0, 0, np.float32(floor)
    while j < len(power):
        if not power[j] > least:  # NaN, too
            j += 1
            continue
        peak = j
        while j < len(power) and power[j] > least:
            if power[j] > power[peak]:
                peak = j
            j += 1
        if power[peak] > threshold * noise[peak]:
            count = _keep(power, peak, peaks, count)
    return count


@kernel
def _keep(power: SingleArray, peak: int, peaks: IntArray, count: int) -> int:
    """Insert a peak among the `count` strongest; of equal ones the first stays ahead."""
    place = count
    while place > 0 and power[peaks[place - 1]] < power[peak]:
        if place < MAX_TARGETS:
            peaks[place] = peaks[place - 1]
        place -= 1
    if place < MAX_TARGETS:
        peaks[place] = peak
    return min(count + 1, MAX_TARGETS)
