"""The statistical level: targets of one segment from a closed-form error model.

The beam's tones are summed at one frequency, the peak of their sum, instead of in every bin; where their line is wide,
the peak is sought among the bins of the line.
Speckle, spread, smear and linewidth reduce that sum as they reduce the spectrum's peak. One complex Gaussian number
represents the noise of the highest bin and decides on detection; the estimator's error is drawn from its variance.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import Any

import numpy as np

from lidar_emu.fmcw.analog_response import clipping, noise_level
from lidar_emu.fmcw.beat_tones import RANGE_M, SPEED_MPS, record_time_s
from lidar_emu.fmcw.false_alarms import draw_alarms, insert_alarms
from lidar_emu.fmcw.haze import set_haze_tone
from lidar_emu.fmcw.highest_bin import highest_bin, set_line_taps
from lidar_emu.fmcw.laser_phase_noise import line_share, peak_wanders, phase_drift
from lidar_emu.fmcw.motion_smear import smear_bins
from lidar_emu.fmcw.peak_interpolation import BIN_CENTRE, BIN_VARIANCE, HANN, noise_bin2
from lidar_emu.fmcw.peak_shape import MOST_QUADRATURE, WIDTH_BINS
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.segment_spectrum import others_power, set_look_tones
from lidar_emu.fmcw.speckle_change import LINE_BIN2, speckle_way, tone_count
from lidar_emu.fmcw.stated_variance import TONE_WIDTH_BIN2, line_noise
from lidar_emu.fmcw.volume_light import has_band, set_bands, volume_in_bin
from lidar_emu.fmcw.volume_peaks import draw_volume_peaks
from lidar_emu.fmcw.workspace import SEGMENT_INDICES, Workspace, look_tones
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal
from lidar_emu.numerics.random_streams import NOISE_BINS
from lidar_emu.numerics.sine import sin_pi, sin_pi_anywhere

_NARROW_BIN2 = 0.1
"""Second moment below which `peak_shape.width_bin2` does not distinguish a line from a single tone."""

_REACH_LINES = 4.0
"""Standard deviations of a wide line on each side of its centre among which its peak is sought."""

_WIDEST_BIN2 = 20.0
"""Second moment that the bins around the peak of the widest line have; of narrower lines they have half."""

_FAR_BIN = 0.25
"""A step this far from the centre of power is followed by a second one: bins beyond the three may be higher."""

_OFF_ZERO = 1e-9
"""Distance in bins from the zeros of denominators, far less than a peak is accurate."""

_APART_BINS = 1.5
"""Lines nearer to the footprint's are one target with it, like peaks of a band nearer to a line or to each other."""


@kernel(inline="always")
def draw_targets(model: ReceiverModel, work: Workspace, beam: Any, segment: int) -> int:
    """Fill `work.targets[segment]`, like `set_spectrum` and `find_targets`: with one target of the footprint, one for
    each line of a streak, clutter or haze, and the highest peaks of bands of haze and dust, and of noise."""
    targets = work.targets[segment]
    hazy = model.haze.snr_per_m > 0.0
    if beam.lit_beamlets == 0 and not (hazy or beam.dust_snr > 0.0):
        alarms = draw_alarms(model, beam, segment, 0.0, 1.0, 0.0, work.alarms)
        return insert_alarms(model, work.alarms[:alarms], 0.0, targets, 0)
    set_bands(model, beam, segment, record_time_s(model, segment, 0))
    banded = has_band(beam)
    kept = _filter_loss(model, work, segment, beam.closing_acceleration_mps2)
    # The last column is the haze's.
    first = min(model.ground_beamlets, work.beamlets.shape[1] - 1)
    lines = min(work.beamlets.shape[1] - first, len(work.line_tones))
    for look in range(model.looks):
        tones = look_tones(work, beam, look)
        set_look_tones(model, work, beam, segment, look, tones)
        if hazy and segment == 1:
            set_haze_tone(model, beam, look, record_time_s(model, segment, look), tones)
        for line in range(lines):
            _take_line(work, beam, first + line, tones, _line_tones(work, beam, line, look))
    level = _draw_line(model, work, beam, segment, 0, kept)
    for line in range(lines):
        work.lines[1 + line].power = 0.0
        if _is_lit(_line_tones(work, beam, line, 0)):
            _draw_line(model, work, beam, segment, 1 + line, kept)
    highest = 0.0
    for line in range(1 + lines):
        highest = max(highest, work.lines[line].power)
    alarms = draw_alarms(model, beam, segment, highest, level, 2.0, work.alarms)
    if alarms > 0:
        highest = max(highest, work.alarms[0].power)
    peaks = 0
    if banded:
        peaks = draw_volume_peaks(model, work, beam, segment, 0.0, 0.0, highest)
        if peaks > 0:
            highest = max(highest, work.volume_peaks[0].power)
        _merge_peaks(work, 1 + lines, peaks)
    count = 0
    for line in range(1 + lines):
        if work.lines[line].power > 0.0 and work.lines[line].power_over_noise > model.threshold:
            count = insert_alarms(model, work.lines[line : line + 1], highest, targets, count)
    count = insert_alarms(model, work.alarms[:alarms], highest, targets, count)
    return insert_alarms(model, work.volume_peaks[:peaks], highest, targets, count)


@kernel
def _merge_peaks(work: Workspace, lines: int, peaks: int) -> None:
    """Remove the weaker of a band's peak and a line or another peak beside it: bins that touch are one target."""
    for i in range(peaks):
        peak = work.volume_peaks[i]
        for k in range(lines + i):
            other = work.lines[k] if k < lines else work.volume_peaks[k - lines]
            if abs(peak.frequency_bin - other.frequency_bin) <= _APART_BINS:
                weaker = peak if peak.power <= other.power else other
                weaker.power = 0.0


@kernel(inline="always")
def _line_tones(work: Workspace, beam: Any, line: int, look: int) -> FloatArray:
    """Tones of a line beside the footprint's, (4, tones)."""
    count = tone_count(beam.speckle_level)
    tones: FloatArray = work.line_tones[line, look][: 4 * count].reshape((4, count))
    return tones


@kernel
def _take_line(work: Workspace, beam: Any, column: int, tones: FloatArray, taken: FloatArray) -> None:
    """Move the tones of a column from a record's to a line of its own, unless they are near the footprint's."""
    columns = work.beamlets.shape[1]
    last = tones.shape[1] - columns + column
    apart = abs((tones[0, last] - tones[0, 0]) + tones[1, last] - tones[1, 0])
    alone = beam.lit_beamlets == 0 or apart > _APART_BINS
    for block in range(taken.shape[1]):
        tone = block * columns + column
        for row in range(4):
            taken[row, block] = tones[row, tone]
        for row in range(2, 4):
            if alone:
                tones[row, tone] = 0.0
            else:
                taken[row, block] = 0.0


@kernel
def _is_lit(tones: FloatArray) -> bool:
    light = 0.0
    for i in range(tones.shape[1]):
        light += abs(tones[2, i]) + abs(tones[3, i])
    return light > 0.0


@kernel
def _draw_line(
    model: ReceiverModel, work: Workspace, beam: Any, segment: int, line: int, kept: float
) -> float:
    """Draw the highest bin of the footprint, line 0, or of a line beside it, into `work.lines`.

    Returns:
        Mean noise power of the rectangular bin there.
    """
    power, frequency, weight, level = 0.0, 0.0, 0.0, 1.0
    quadrature, squares, width, volume, errors = 0.0, 0.0, 0.0, 0.0, 0.0
    late, late2, late_frequency = 0.0, 0.0, 0.0
    law = model.variance_law
    out_of_phase, in_phase = line_noise(law.line_rate, phase_drift(model, work.beamlets[RANGE_M, 0]))
    # The law has the variances of means over looks.
    out_of_phase, in_phase = (
        law.line_bin2 * law.looks * out_of_phase,
        law.quadrature_line_bin2 * law.looks * in_phase,
    )
    banded = has_band(beam)
    for look in range(model.looks):
        tones, columns = look_tones(work, beam, look), work.beamlets.shape[1]
        gain, distortion = clipping(
            model.response,
            tones,
            model.fft_length,
            others_power(model, beam, segment),
        )
        if line > 0:
            tones, columns = _line_tones(work, beam, line - 1, look), 1
        power_gain, loss = gain * gain, gain * kept
        factor = 1.0 + model.signal_shot_per_w * beam.power_w
        beamlets_bin, beamlets_bin2 = _centre_of_power(tones, columns)
        line_bin2 = _line_variance(model, beam)
        index = (segment + 3 * look) * SEGMENT_INDICES + line
        taps = set_line_taps(model, beam, segment, look, work.beamlets[RANGE_M, 0], work.laser_line)
        sought = taps > 0 or beamlets_bin2 + line_bin2 > _NARROW_BIN2
        if sought:
            k = _inner_bin(model, tones[0, 0] + beamlets_bin)
            sine = sin_pi(k / model.fft_length)
            level = noise_level(model.response, power_gain, factor, distortion, k, sine)
            if banded:
                volume = power_gain * volume_in_bin(model, beam, k)
            reach = _REACH_LINES * sqrt(beamlets_bin2 + line_bin2) + 2.0
            place, x, y = highest_bin(
                model,
                beam,
                index,
                tones,
                beamlets_bin,
                reach,
                loss,
                sqrt(level + volume),
                work.laser_line,
                taps,
            )
            step, quadrature_bin = 0.0, 0.0
            # Beside the tones the laser's line has a peak of its own.
            if taps == 0 or abs(place - beamlets_bin) < reach - 1.0:
                step, quadrature_bin = _step_to_peak(tones, place)
            if model.peak_method == BIN_CENTRE:
                step = 0.0
            centre, strength = tones[0, 0] + place + step, (x * x + y * y) / model.window_centre**2
        else:
            centre, quadrature_bin, re, im = _sum_at_peak(tones, beamlets_bin)
            k = _inner_bin(model, centre)
            sine = sin_pi(k / model.fft_length)
            level = noise_level(model.response, power_gain, factor, distortion, k, sine)
            if banded:
                volume = power_gain * volume_in_bin(model, beam, centre)
            straddled = loss * window_gain(model, centre - k)
            x, y = complex_normal(beam.seed, beam.shot, beam.beam, NOISE_BINS, index)
            scale = sqrt((level + volume) * model.noise_power)
            x, y = straddled * re + scale * x, straddled * im + scale * y
            strength = loss * loss * (re * re + im * im)
        power += (x * x + y * y) / model.looks
        frequency += strength * centre
        snr = max(strength / level, 1e-12)
        x, y = _draw_errors(beam, segment, look, line)
        error = sqrt(2.0 * (noise_bin2(model.peak_method, snr) + out_of_phase)) * x
        errors += strength * error
        late += look * strength
        late2 += look * look * strength
        late_frequency += look * strength * (centre + error)
        quadrature_bin += sqrt(2.0 * (noise_bin2(HANN, snr) + in_phase)) * y
        quadrature += strength * quadrature_bin
        squares += strength * quadrature_bin * quadrature_bin
        width += strength * (beamlets_bin2 + line_bin2 / (2.0 + line_bin2 / _WIDEST_BIN2))
        weight += strength
    target = work.lines[line]
    target.power = 0.0
    if weight > 0.0 and frequency / weight >= model.lowest_bin:
        target.power, target.power_over_noise = power, power / (level * model.noise_power)
        target.quadrature_bin = quadrature / weight
        target.quadrature_bin2 = squares / (model.looks * weight)
        target.drift_bin = 0.0
        spread = late2 - late * late / weight
        if spread > 0.0:
            drift = (late_frequency - late * (frequency + errors) / weight) / spread
            target.drift_bin = min(max(drift, -MOST_QUADRATURE), MOST_QUADRATURE)
        spread_bin2 = width / weight
        target.width_bin2 = TONE_WIDTH_BIN2 + (spread_bin2 if spread_bin2 > _NARROW_BIN2 else 0.0)
        error = min(max(errors / weight, -1.0), 1.0)
        # A bin that was found among others is scattered no further.
        if sought and model.peak_method == BIN_CENTRE:
            error = 0.0
        _set_frequency(model, frequency / weight + error, weight / level, target)
    return level


@kernel
def _line_variance(model: ReceiverModel, beam: Any) -> float:
    """Variance in bins² of the line of each beamlet, by its change of speckle."""
    if beam.speckle_level == 0:
        return 0.0
    way = speckle_way(model, beam.speckle_drift_per_s)
    variance: float = LINE_BIN2 * way * way
    return variance


@kernel
def _inner_bin(model: ReceiverModel, place: float) -> float:
    """Nearest bin that can hold a target."""
    k: float = min(max(np.rint(place), 1.0), 0.5 * model.fft_length - 1.0)
    return k


@kernel
def _sum_at_peak(tones: FloatArray, centre: float) -> tuple[float, float, float, float]:
    """Frequency of the peak near the tones' centre of power, its quadrature (`peak_shape`), and the sum at the peak.

    `centre` is in bins from the first tone's whole bin.
    """
    step, quadrature = _step_to_peak(tones, centre)
    if abs(step) > _FAR_BIN:
        further, quadrature = _step_to_peak(tones, centre + step)
        step += further
    centre += step
    re = im = 0.0
    for i in range(tones.shape[1]):
        d = (tones[0, i] - tones[0, 0]) + tones[1, i] - centre + _OFF_ZERO
        kernel = sin_pi_anywhere(d) / (pi * d)
        re += tones[2, i] * kernel
        im += tones[3, i] * kernel
    return tones[0, 0] + centre, quadrature, re, im


@kernel
def _step_to_peak(tones: FloatArray, centre: float) -> tuple[float, float]:
    """Offset and quadrature of the single tone that has the same three Hann-windowed bins about a place.

    q = (Y₊ - Y₋) / (2Y₀ - Y₋ - Y₊) = 3δ/(2(1 - δ²)); `centre` is in bins from the first tone's whole bin.
    """
    rise_re = rise_im = whole_re = whole_im = 0.0
    for i in range(tones.shape[1]):
        d = (tones[0, i] - tones[0, 0]) + tones[1, i] - centre + _OFF_ZERO
        beside = 1.0 - d * d
        # The bins are sin(πd) / (d (1 - d²)), in terms of their own distances: common denominators of their sums.
        common = sin_pi_anywhere(d) / (d * beside * (4.0 - d * d))
        rise, whole = 3.0 * d * common, 2.0 * beside * common
        rise_re += tones[2, i] * rise
        rise_im += tones[3, i] * rise
        whole_re += tones[2, i] * whole
        whole_im += tones[3, i] * whole
    power = whole_re * whole_re + whole_im * whole_im
    if power <= 0.0:
        return 0.0, 0.0
    q = (rise_re * whole_re + rise_im * whole_im) / power
    offset = 4.0 * q / (3.0 + sqrt(9.0 + 16.0 * q * q))
    square = min(offset * offset, 0.5)
    per_slope = (1.0 - square) ** 2 / (1.5 * (1.0 + square))
    quadrature = (rise_im * whole_re - rise_re * whole_im) / power * per_slope
    # The offset is from the place that the distances were moved to: without it the next ones could be 0 again.
    return offset - _OFF_ZERO, min(max(quadrature, -MOST_QUADRATURE), MOST_QUADRATURE)


@kernel
def _centre_of_power(tones: FloatArray, columns: int) -> tuple[float, float]:
    """Mean frequency of the beamlets by their power at the record's centre, in bins from the first tone's whole bin,
    and their second moment about it in bins²."""
    power = moment = second = 0.0
    blocks = tones.shape[1] // columns
    per_block = 1.0 / blocks
    for i in range(columns):
        re = im = place = 0.0
        for block in range(blocks):
            tone = block * columns + i
            re += tones[2, tone]
            im += tones[3, tone]
            place += (tones[0, tone] - tones[0, 0]) + tones[1, tone]
        strength = re * re + im * im
        power += strength
        place *= per_block
        moment += strength * place
        second += strength * place * place
    if power <= 0.0:
        return 0.0, 0.0
    middle = moment / power
    return middle, min(max(second / power - middle * middle, 0.0), 0.5 * WIDTH_BINS**2)


@kernel
def window_gain(model: ReceiverModel, offset: float) -> float:
    """Magnitude of a windowed bin beside a tone of unit weight."""
    d = offset + _OFF_ZERO
    sides = 2.0 * d / (1.0 - d * d)
    gain: float = sin_pi_anywhere(d) / pi * (model.window_centre / d - model.window_side * sides)
    return gain


@kernel(inline="always")
def _filter_loss(
    model: ReceiverModel, work: Workspace, segment: int, closing_acceleration_mps2: float
) -> float:
    """Amplitude of the central tap under smear and the laser's line, unless the line's taps are drawn."""
    smear = smear_bins(model, segment, work.beamlets[SPEED_MPS, 0], closing_acceleration_mps2)
    # For a chirp of β bins the peak falls as 1 - (πβ)²/360, and as β^-1/2 for large β.
    chirped: float = 1.0 / sqrt(sqrt(1.0 + (pi * smear) ** 2 / 90.0))
    range_m = work.beamlets[RANGE_M, 0]
    if peak_wanders(model, range_m):
        return chirped
    return chirped * sqrt(line_share(model, range_m))


@kernel
def _draw_errors(beam: Any, segment: int, look: int, line: int) -> tuple[float, float]:
    """Normal numbers of variance 1/2 for the errors of a record's frequency and of its quadrature."""
    index = (segment + 3 * look + 1) * SEGMENT_INDICES - 1 - line
    x, y = complex_normal(beam.seed, beam.shot, beam.beam, NOISE_BINS, index)
    return x, y


@kernel
def _set_frequency(model: ReceiverModel, frequency_bin: float, snr: float, target: Any) -> None:
    """Set the frequency, rounded where the instrument rounds it, and variances by noise."""
    method = model.peak_method
    target.frequency_bin = frequency_bin
    target.variance_bin2 = max(noise_bin2(method, snr), 1e-12)
    target.quadrature_variance_bin2 = max(noise_bin2(HANN, snr), 1e-12)
    if method == BIN_CENTRE:
        target.frequency_bin = min(max(np.rint(frequency_bin), 1.0), 0.5 * model.fft_length - 1.0)
        target.variance_bin2 = BIN_VARIANCE
