"""Tones of one segment: beat frequencies and complex weights of the beamlets.

Frequency plan: the up-chirp ends at the carrier, the constant segment stays there, and the down-chirp starts from it.
For a beamlet at range R, delay τ = 2R/c and closing speed v the beats at a record's centre are

    g₊ = Sτ - (f - Sτ) 2v/c, g₀ = f 2v/c, g₋ = Sτ + (f + Sτ) 2v/c,

with the optical frequency f at that time; range and speed are the values at the record's own time. The samples of a
tone are Re[w exp(j2πg t)], with t from the record's centre.
"""

from __future__ import annotations

from math import pi, sin, sqrt
from typing import Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import unit_phasor
from lidar_emu.numerics.vectors import FAST
from lidar_emu.receiver.analog_response import is_flat, tone_gain
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Reason
from lidar_emu.receiver.speckle import tone_count, tone_offset_bin
from lidar_emu.receiver.spectrum import fold

RANGE_M, RANGE_RATE_MPS, SPEED_MPS, AMPLITUDE, SHARE = range(5)
"""Rows of a beam's beamlets; echoes that return light, square root of SNR, and SNR over the square root of the beam's.
"""

_FASTEST_MPS = 2.9e8
"""Speed limit beyond which a beamlet counts as without light."""

_MOST_SNR = 1e30
"""Limit of the echo power, so that powers stay finite for any input."""

_NO_SURFACE = int(Reason.NO_SURFACE)
_BELOW_THRESHOLD = int(Reason.BELOW_THRESHOLD)
_BEYOND_RANGE = int(Reason.BEYOND_RANGE)
_INSIDE_GROUND = int(Reason.INSIDE_GROUND)


@kernel
def gather_beamlets(
    model: ReceiverModel,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    power_w: FloatArray,
    range_rate_mps: FloatArray,
    beam: Any,
    beamlets: FloatArray,
) -> int:
    """Fill `beamlets`, with one column per column of `range_m` plus padding, and the beam's light in `beam`.

    A column without light equals the first column with light, except for its power of 0, so that all arrays of a beam
    have the same length and are contiguous.

    Returns:
        The reason to report if nothing is detected.
    """
    reason = _NO_SURFACE
    furthest_s = model.furthest_record_s
    beam.lit_beamlets, beam.power_w = 0, 0.0
    count, first = 0, 0
    beamlets[SHARE] = 0.0
    total_w = 0.0
    for i in range(len(range_m)):
        distance_m, power = range_m[i], power_w[i]
        rate_mps = range_rate_mps[i] if abs(range_rate_mps[i]) < _FASTEST_MPS else 0.0
        if distance_m <= furthest_s * abs(rate_mps):
            return _INSIDE_GROUND
        if distance_m > model.record_edge_range_m:
            # The echo arrives after the start of the record; the remainder is detected, but reported as beyond range.
            power *= _record_share(model, (distance_m - model.record_edge_range_m) * model.delay_per_m) ** 2
            if reason == _NO_SURFACE:
                reason = _BEYOND_RANGE
        elif distance_m > 0.0:
            reason = _BELOW_THRESHOLD
        if distance_m > 0.0 and 0.0 < power < np.inf and abs(closing_speed_mps[i]) < _FASTEST_MPS:
            beamlets[RANGE_M, i] = distance_m
            beamlets[RANGE_RATE_MPS, i] = rate_mps
            beamlets[SPEED_MPS, i] = closing_speed_mps[i]
            beamlets[SHARE, i] = power
            total_w += power
            first = i if count == 0 else first
            count += 1
    if count > 0:
        scale = min(model.snr_per_w, _MOST_SNR / total_w)
        for i in range(beamlets.shape[1]):
            if beamlets[SHARE, i] == 0.0:
                for row in (RANGE_M, RANGE_RATE_MPS, SPEED_MPS):
                    beamlets[row, i] = beamlets[row, first]
        share, amplitude = beamlets[SHARE], beamlets[AMPLITUDE]
        per_root = 1.0 / sqrt(total_w * scale)
        for i in range(len(share)):
            snr = share[i] * scale
            amplitude[i] = sqrt(snr)
            share[i] = snr * per_root
    elif model.haze.snr_per_m > 0.0:
        beamlets[:] = 0.0
    beam.lit_beamlets, beam.power_w = count, total_w
    return reason


@kernel
def _record_share(model: ReceiverModel, lost: float) -> float:
    """Amplitude ratio of a windowed bin between a line that misses the first part of its record and a whole line.

    The window is centre + 2 side cos(2πx), x from 0 to 1 over the record.
    """
    if lost >= 1.0:
        return 0.0
    return 1.0 - lost - model.window_side / model.window_centre * sin(2.0 * pi * lost) / pi


@kernel
def record_time(model: ReceiverModel, segment: int, look: int) -> float:
    """Time of a record's centre from the time of validity, in records."""
    from_validity: float = (segment - 1) * model.segment_records
    return from_validity + (look - 0.5 * (model.looks - 1)) * model.cycle_records


@kernel
def record_time_s(model: ReceiverModel, segment: int, look: int) -> float:
    """Time of a record's centre from the time of validity."""
    return record_time(model, segment, look) * model.record_time_s


@kernel
def speed_change_mps(beam: Any, time_s: float) -> float:
    """Change of all closing speeds of a beam, from the time of validity."""
    return float((beam.closing_acceleration_mps2 + 0.5 * beam.closing_jerk_mps3 * time_s) * time_s)


@kernel(fastmath=FAST, forceinline=True)
def field_sense(segment: int) -> float:
    """-1 in the up-chirp, where the beat rises with the delay and the echo field enters as its conjugate."""
    return -1.0 if segment == 0 else 1.0


@kernel(fastmath=FAST, forceinline=True)
def signed_bin(model: ReceiverModel, segment: int, range_m: float, speed_mps: float) -> float:
    """Beat in bins: g₊, g₀ or g₋."""
    per_m, per_mps, per_m_mps = _beat_terms(model, segment)
    return per_m * range_m + (per_mps + per_m_mps * range_m) * speed_mps


@kernel(fastmath=FAST)
def _beat_terms(model: ReceiverModel, segment: int) -> tuple[float, float, float]:
    """Coefficients of the beat in bins: per range, per closing speed, and per product of the two."""
    per_mps = model.carrier_ratio[segment] / model.speed_bin_mps
    if segment == 1:
        return 0.0, per_mps, 0.0
    per_m_mps = model.slope_over_carrier_per_m / model.speed_bin_mps
    return model.beat_bin_per_m, (-per_mps if segment == 0 else per_mps), per_m_mps


@kernel(fastmath=FAST, forceinline=True)
def relative_turn(
    model: ReceiverModel,
    segment: int,
    time_records: float,
    range_m: float,
    ahead_m: float,
    delta_speed_mps: float,
) -> float:
    """Phase of one beamlet's echo relative to another's, in turns, from the time of validity.

    The echo has the phase of exp(-2jkL), with the wave number k of the returning light: it rotates with the difference
    of the Doppler shifts, and from segment to segment with the optical frequency, in proportion to the difference of
    the ranges.

    Args:
        time_records: time from the time of validity, in records.
        range_m: range of the other beamlet, whose delay selects the returning light.
        ahead_m, delta_speed_mps: range and closing speed minus the other's, at the time of validity.
    """
    carrier = model.carrier_ratio[segment] - 1.0
    if segment != 1:
        shift = model.slope_over_carrier_per_m * range_m
        carrier += -shift if segment == 0 else shift
    off_carrier = carrier / model.speed_bin_mps / model.record_time_s
    return delta_speed_mps / model.speed_bin_mps * time_records - off_carrier * ahead_m


@kernel(fastmath=FAST)
def set_segment_tones(
    model: ReceiverModel,
    segment: int,
    time_records: float,
    delta_speed_mps: float,
    curvature_m: float,
    common_turn: float,
    beamlets: FloatArray,
    weights: FloatArray,
    speckle_level: int,
    tones: FloatArray,
) -> None:
    """Tones of a record whose centre lies `time_records` after the time of validity.

    Relative to the first beamlet, the phase of a beamlet rotates with the difference of their Doppler shifts, and with
    the segment's optical frequency times the difference of their ranges: with the Doppler shifts this is the part of
    the speckle's change that is not an exchange of scatterers. Without speckle all beamlets add in phase.

    Args:
        delta_speed_mps: change of all closing speeds since the time of validity.
        curvature_m: change of all ranges since then by the curvature of the motion, beside the one by their rates.
        beamlets: (5, n) from `gather_beamlets`.
        weights: (tones, 2, n) echo field of each beamlet, set by `set_tone_weights`.
        speckle_level: from `speckle.needed_level`.
        tones: (4, m n) receives n, δ and the complex weight: a block of n columns for each of the m tones of a
            beamlet.
    """
    _set_places(
        model, segment, time_records * model.record_time_s, delta_speed_mps, curvature_m, beamlets, tones[0]
    )
    if model.speckle:
        _set_phasors(model, segment, time_records, common_turn, beamlets, tones[2], tones[3])
        # The first block holds the places and phases that all blocks are made from.
        for block in range(tone_count(speckle_level) - 1, -1, -1):
            _set_speckled(
                segment, block, tone_offset_bin(speckle_level, block), beamlets, weights[block], tones
            )
    else:
        cosine, sine = unit_phasor(common_turn + 0.5 - np.floor(common_turn + 0.5))
        for i in range(tones.shape[1]):
            tones[2, i], tones[3, i] = beamlets[SHARE, i] * cosine, beamlets[SHARE, i] * sine
    if not is_flat(model.response):
        for i in range(tones.shape[1]):
            gain_re, gain_im = tone_gain(model.response, tones[0, i])
            re, im = tones[2, i], tones[3, i]
            tones[2, i], tones[3, i] = re * gain_re - im * gain_im, re * gain_im + im * gain_re
    _fold(model.fft_length, tones)


# Each stage is a separate loop and reads the model beforehand, so that it is vectorised.


@kernel(fastmath=FAST)
def _set_places(
    model: ReceiverModel,
    segment: int,
    time_s: float,
    delta_speed_mps: float,
    curvature_m: float,
    beamlets: FloatArray,
    beat: FloatArray,
) -> None:
    per_m, per_mps, per_m_mps = _beat_terms(model, segment)
    range_m, rate_mps, speed_mps = beamlets[RANGE_M], beamlets[RANGE_RATE_MPS], beamlets[SPEED_MPS]
    for i in range(len(range_m)):
        distance_m, closing_mps = (
            range_m[i] + rate_mps[i] * time_s + curvature_m,
            speed_mps[i] + delta_speed_mps,
        )
        beat[i] = per_m * distance_m + (per_mps + per_m_mps * distance_m) * closing_mps


@kernel(fastmath=FAST)
def _set_phasors(
    model: ReceiverModel,
    segment: int,
    time_records: float,
    common_turn: float,
    beamlets: FloatArray,
    cosine: FloatArray,
    sine: FloatArray,
) -> None:
    sense = field_sense(segment)
    range_m, speed_mps = beamlets[RANGE_M], beamlets[SPEED_MPS]
    # The phase is linear in the differences between a beamlet and the first.
    per_m = sense * relative_turn(model, segment, time_records, range_m[0], 1.0, 0.0)
    per_mps = sense * relative_turn(model, segment, time_records, range_m[0], 0.0, 1.0)
    first_m, first_mps = range_m[0], speed_mps[0]
    for i in range(len(range_m)):
        turn = common_turn + per_m * (range_m[i] - first_m) + per_mps * (speed_mps[i] - first_mps) + 0.5
        cosine[i] = turn - np.floor(turn)
    for i in range(len(range_m)):
        cosine[i], sine[i] = unit_phasor(cosine[i])


@kernel(fastmath=FAST)
def _set_speckled(
    segment: int, block: int, offset_bin: float, beamlets: FloatArray, weights: FloatArray, tones: FloatArray
) -> None:
    """Set one tone of each beamlet in its block of columns, from places and phasors in the first block."""
    sense = field_sense(segment)
    amplitude, field_re, field_im = beamlets[AMPLITUDE], weights[0], weights[1]
    columns = len(amplitude)
    first = block * columns
    beat, cosines, sines = tones[0], tones[2], tones[3]
    to_beat, to_re, to_im = tones[0, first:], tones[2, first:], tones[3, first:]
    for i in range(columns):
        re, im = amplitude[i] * field_re[i], sense * amplitude[i] * field_im[i]
        cosine, sine = cosines[i], sines[i]
        to_beat[i] = beat[i] + sense * offset_bin
        to_re[i], to_im[i] = re * cosine - im * sine, re * sine + im * cosine


@kernel(fastmath=FAST)
def _fold(length: float, tones: FloatArray) -> None:
    """Convert signed beats in the first row to n and δ, and fold the weights; see `fold`."""
    whole, rest, tone_re, tone_im = tones[0], tones[1], tones[2], tones[3]
    for i in range(len(whole)):
        observed_bin, factor_re, factor_im = fold(whole[i], length)
        nearest = np.rint(observed_bin)
        whole[i], rest[i] = nearest, observed_bin - nearest
        tone_re[i], tone_im[i] = factor_re * tone_re[i], factor_im * tone_im[i]
