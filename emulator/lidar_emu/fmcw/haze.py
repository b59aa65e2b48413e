"""Haze as a target: a band of random bins in the chirps, from zero range to the surface, and a line in the constant
segment.

All haze on a beam has the closing speed of the air. In a chirp each range has its own beat: particles at random places
make every rectangular bin of the band a circular Gaussian number of its own, of the mean power

    p(r) = s c df/(2S) exp(-2αr)/(1 + (r/z)²),   s the SNR per metre at the sensor.

Where single bins of the band are likely to exceed the threshold they are computed; beyond, the highest of them is drawn
from its distribution, as false alarms are. In the constant segment the whole band is one line of ∫ p dr.
"""

from __future__ import annotations

from math import atan, ceil, exp, expm1, log, log1p, pi, sin, sqrt, tan
from typing import Any

import numpy as np

from lidar_emu.fmcw.analog_response import noise_level, tone_gain
from lidar_emu.fmcw.beat_tones import record_time_s, signed_bin, speed_change_mps
from lidar_emu.fmcw.false_alarms import set_random_peak
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.spectrum import BIN, fold
from lidar_emu.fmcw.workspace import HAZE_NODES, MAX_TARGETS, SEGMENT_INDICES, SpectrumWorkspace, Workspace
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal, fill_complex_normals, uniform_pair
from lidar_emu.numerics.random_streams import HAZE
from lidar_emu.probability.noise import minus_log_exceedance

_PANELS = 16
_HALVINGS = 16


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
def air_speed_mps(beam: Any, time_s: float) -> float:
    """Closing speed of the haze at a time from the time of validity; it changes with the sensor's."""
    speed_mps: float = beam.air_speed_mps + speed_change_mps(beam, time_s)
    return speed_mps


@kernel
def set_haze_tone(model: ReceiverModel, beam: Any, look: int, time_s: float, tones: FloatArray) -> None:
    """Set the line of the haze in the constant segment, as the last of a record's tones (4, tones)."""
    beat = signed_bin(model, 1, 0.0, air_speed_mps(beam, time_s))
    gain_re, gain_im = tone_gain(model.response, beat)
    observed_bin, factor_re, factor_im = fold(beat, model.fft_length)
    x, y = complex_normal(beam.seed, beam.shot, beam.beam, HAZE, (1 + 3 * look) * SEGMENT_INDICES // 2)
    scale = sqrt(haze_snr(model, beam.haze_range_m))
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


@kernel
def add_band_places(
    model: ReceiverModel, beam: Any, segment: int, time_s: float, step: float, places: FloatArray
) -> int:
    """Set places `step` bins apart over the part of the band that is computed.

    Returns:
        The number of places.
    """
    end_m = min(beam.haze_range_m, model.haze.computed_range_m)
    if segment == 1 or end_m <= 0.0:
        return 0
    speed_mps, length = air_speed_mps(beam, time_s), model.fft_length
    first, last = signed_bin(model, segment, 0.0, speed_mps), signed_bin(model, segment, end_m, speed_mps)
    one, _, _ = fold(first, length)
    other, _, _ = fold(last, length)
    # A continuous band folds into a continuous one.
    low, high = min(one, other), max(one, other)
    if ceil(first / length) * length <= last:
        low = 0.0
    if (ceil(first / length - 0.5) + 0.5) * length <= last:
        high = 0.5 * length
    place, stop, count = np.rint(low), np.rint(high), 0
    while place < stop:
        places[count] = place
        count += 1
        place += step
    places[count] = stop
    return count + 1


@kernel
def add_haze(
    model: ReceiverModel,
    spectra: SpectrumWorkspace,
    beam: Any,
    segment: int,
    look: int,
    time_s: float,
    gain: float,
    count: int,
) -> None:
    """Add the haze in a chirp to the first `count` rectangular bins of a look.

    A bin holds the haze of all signed beats that appear in it: its own number, its mirror image, and those beyond N/2.
    Each beat has random numbers of its own.
    """
    speed_mps, length, grid = air_speed_mps(beam, time_s), model.fft_length, spectra.grid
    zero = signed_bin(model, segment, 0.0, speed_mps)
    end = signed_bin(model, segment, beam.haze_range_m, speed_mps)
    start = int(np.int64(0))
    while start < count:
        stop = start + 1
        while stop < count and grid[BIN, stop] - grid[BIN, stop - 1] == 1.0:
            stop += 1
        # Columns below 0 and above N/2 are mirror images, set later; bins 0 and N/2 hold no target.
        low, high = max(grid[BIN, start], 1.0), min(grid[BIN, stop - 1], 0.5 * length - 1.0)
        for sense, shift in ((1.0, 0.0), (-1.0, 0.0), (1.0, -length), (-1.0, length)):
            one, other = sense * low + shift, sense * high + shift
            least, most = max(min(one, other), np.rint(zero)), min(max(one, other), np.rint(end))
            if least <= most:
                _add_beats(
                    model, spectra, beam, segment, look, zero, end, gain, least, most, sense, shift, start
                )
        start = stop


@kernel
def _add_beats(
    model: ReceiverModel,
    spectra: SpectrumWorkspace,
    beam: Any,
    segment: int,
    look: int,
    zero: float,
    end: float,
    gain: float,
    least: float,
    most: float,
    sense: float,
    shift: float,
    start: int,
) -> None:
    """Add the haze of signed beats from `least` to `most` to the interval of the grid that begins in column `start`."""
    first = int(least - np.rint(zero))
    odd = first % 2
    needed = int(most - least) + 1 + odd
    pair = ((segment + 3 * look) * SEGMENT_INDICES + first) // 2
    numbers, bins = spectra.noise, spectra.bins[look]
    drawn = needed + needed % 2
    fill_complex_normals(beam.seed, beam.shot, beam.beam, HAZE, pair, drawn, spectra.words, numbers)
    lowest = spectra.grid[BIN, start]
    for i in range(needed - odd):
        beat = least + i
        scale = gain * sqrt(haze_power(model, zero, end, beat))
        j = start + int(sense * (beat - shift) - lowest)
        bins[0, j] += scale * numbers[0, i + odd]
        bins[1, j] += scale * numbers[1, i + odd]


@kernel
def draw_haze_peaks(
    model: ReceiverModel,
    work: Workspace,
    beam: Any,
    segment: int,
    from_m: float,
    highest: float,
) -> int:
    """Draw the highest bins of the band beyond a range, those above the threshold and near the highest power.

    The bins' powers are independent and exponential around their means: none of them exceeds p with the probability
    exp(-g(p)), g = -Σ ln(1 - Q(p/mean)). The powers at which g is the sum of one, two, ... exponential numbers are the
    highest, the second highest and so on. Windows correlate neighbours: fewer bins count.

    Args:
        from_m: where the part of the band begins.
        highest: power of the highest bin elsewhere.

    Returns:
        Number of peaks, in `work.haze_peaks` in descending order of power.
    """
    span_m = beam.haze_range_m - from_m
    if segment == 1 or span_m <= 0.0:
        return 0
    zero = signed_bin(model, segment, 0.0, air_speed_mps(beam, record_time_s(model, segment, 0)))
    rise_m = min(
        span_m, 1.0 / (20.0 * (2.0 * model.haze.extinction_per_m + 1.0 / model.haze.rayleigh_range_m))
    )
    nodes = work.haze_nodes
    _set_nodes(model, zero, from_m, span_m, rise_m, nodes)
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
        node = _choose_node(model, nodes, power, choice)
        place, _ = uniform_pair(beam.seed, beam.shot, beam.beam, HAZE, index - 1)
        y = (node + place) / HAZE_NODES
        r = from_m + rise_m * expm1(log1p(span_m / rise_m) * y)
        k, _, _ = fold(zero + r * model.beat_bin_per_m, model.fft_length)
        set_random_peak(model, k, power / nodes[2, node], power * model.noise_power, work.haze_peaks[i])
    return MAX_TARGETS


@kernel
def _set_nodes(
    model: ReceiverModel, zero: float, from_m: float, span_m: float, rise_m: float, nodes: FloatArray
) -> None:
    """Set number of bins, mean power and noise, (3, nodes), of parts of the band, narrow where it decays fast."""
    growth = log1p(span_m / rise_m)
    for i in range(HAZE_NODES):
        away_m = rise_m * exp(growth * (i + 0.5) / HAZE_NODES)
        beat = zero + (from_m + away_m - rise_m) * model.beat_bin_per_m
        k, _, _ = fold(beat, model.fft_length)
        noise = noise_level(model.response, 1.0, 0.0, k, sin(pi * k / model.fft_length))
        bins = away_m * growth / HAZE_NODES * model.beat_bin_per_m
        nodes[0, i] = bins * model.independent_share if k >= model.lowest_bin else 0.0
        nodes[1, i] = noise + haze_power(model, zero, np.inf, beat)
        nodes[2, i] = noise


@kernel
def _node_exceedances(model: ReceiverModel, nodes: FloatArray, i: int, power: float) -> float:
    """-ln of the probability that no bin of a part exceeds both a power and its threshold."""
    least = max(power, model.threshold * nodes[2, i]) / nodes[1, i]
    unlikely = exp(-minus_log_exceedance(model.looks * least, model.looks))
    return -nodes[0, i] * log1p(-unlikely) if unlikely < 1.0 else np.inf


@kernel
def _exceedances(model: ReceiverModel, nodes: FloatArray, power: float) -> float:
    """-ln of the probability that no bin of the band exceeds both a power and its threshold."""
    total = 0.0
    for i in range(HAZE_NODES):
        total += _node_exceedances(model, nodes, i, power)
    return total


@kernel
def _power_exceeded(model: ReceiverModel, nodes: FloatArray, total: float, floor: float) -> float:
    """The power above `floor` at which `_exceedances` is `total`, by bisection."""
    mean = 0.0
    for i in range(HAZE_NODES):
        mean = max(mean, nodes[1, i])
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
    for i in range(HAZE_NODES):
        total += _density(model, nodes, i, power)
    left = choice * total
    for i in range(HAZE_NODES):
        left -= _density(model, nodes, i, power)
        if left <= 0.0:
            return i
    return HAZE_NODES - 1


@kernel
def _density(model: ReceiverModel, nodes: FloatArray, i: int, power: float) -> float:
    """Density of bins of a part at a power, relative to the other parts; 0 below its threshold."""
    if power <= model.threshold * nodes[2, i]:
        return 0.0
    step = 1e-3 * nodes[1, i] / model.looks
    here, above = (
        _node_exceedances(model, nodes, i, power),
        _node_exceedances(model, nodes, i, power + step),
    )
    density: float = (here - above) / step
    return density
