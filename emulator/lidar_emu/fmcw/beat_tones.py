"""Tones of one segment: beat frequencies and complex weights of the beamlets.

Frequency plan: the up-chirp ends at the carrier, the constant segment stays there, the down-chirp starts from it. A
beamlet at range R, delay τ = 2R/c, whose ground closes with v, beats in a record's centre at

    g₊ = Sτ - (f - Sτ) 2v/c,   g₀ = f 2v/c,   g₋ = Sτ + (f + Sτ) 2v/c,

f the optical frequency then; range and speed are those of the record's own time. The sample sequence of a tone is
Re[w exp(j2πg t)] with t from the record's centre.
"""

from __future__ import annotations

from math import pi, sin, sqrt
from typing import Any

import numpy as np

from lidar_emu.fmcw.analog_response import is_flat, tone_gain
from lidar_emu.fmcw.reasons import Reason
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.spectrum import fold
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import unit_phasor
from lidar_emu.numerics.sine import FAST

RANGE_M, RANGE_RATE_MPS, SPEED_MPS, AMPLITUDE, SHARE = range(5)
"""Rows of a beam's beamlets: what returns light, square root of its SNR, and SNR over the root of the beam's."""

_FASTEST_MPS = 2.9e8
"""Nothing is faster; what claims to be returns no light."""

_MOST_SNR = 1e30
"""Echoes are held below it, so that powers stay finite for any input."""

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
    """Fill `beamlets`, whose columns are those of `range_m` and some more, and the beam's light in `beam`.

    A column that returns no light is like the first that does, but for its power of 0: so all of a beam's arrays have
    the same length, and lie in one piece.

    Returns:
        The reason why nothing can be detected, for the case that nothing is.
    """
    reason = _NO_SURFACE
    beam.lit_beamlets, beam.power_w = 0, 0.0
    count, first = 0, 0
    beamlets[SHARE] = 0.0
    total_w = 0.0
    for i in range(len(range_m)):
        distance_m, power = range_m[i], power_w[i]
        if distance_m <= 0.0:
            return _INSIDE_GROUND
        if distance_m > model.record_edge_range_m:
            # The echo arrives when the record has begun; what is left of it is detected, but reported as beyond range.
            power *= _record_share(model, (distance_m - model.record_edge_range_m) * model.delay_per_m) ** 2
            if reason == _NO_SURFACE:
                reason = _BEYOND_RANGE
        elif distance_m > 0.0:
            reason = _BELOW_THRESHOLD
        if distance_m > 0.0 and 0.0 < power < np.inf and abs(closing_speed_mps[i]) < _FASTEST_MPS:
            beamlets[RANGE_M, i] = distance_m
            beamlets[RANGE_RATE_MPS, i] = range_rate_mps[i] if abs(range_rate_mps[i]) < _FASTEST_MPS else 0.0
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
    beam.lit_beamlets, beam.power_w = count, total_w
    return reason


@kernel
def _record_share(model: ReceiverModel, lost: float) -> float:
    """Ratio of the amplitudes of a windowed bin: of a line that misses the first part of its record, to a whole line.

    The window is centre - 2 side cos(2πx), x over the record.
    """
    if lost >= 1.0:
        return 0.0
    return 1.0 - lost - model.window_side / model.window_centre * sin(2.0 * pi * lost) / pi


@kernel(fastmath=FAST, forceinline=True)
def signed_bin(model: ReceiverModel, segment: int, range_m: float, speed_mps: float) -> float:
    """The beat in bins, g₊, g₀ or g₋."""
    per_m, per_mps, per_m_mps = _beat_terms(model, segment)
    return per_m * range_m + (per_mps + per_m_mps * range_m) * speed_mps


@kernel(fastmath=FAST)
def _beat_terms(model: ReceiverModel, segment: int) -> tuple[float, float, float]:
    """The beat in bins per range, per closing speed, and per product of the two."""
    per_mps = model.carrier_ratio[segment] / model.speed_bin_mps
    if segment == 1:
        return 0.0, per_mps, 0.0
    per_m_mps = model.slope_over_carrier_per_m / model.speed_bin_mps
    return model.beat_bin_per_m, (-per_mps if segment == 0 else per_mps), per_m_mps


@kernel(fastmath=FAST, forceinline=True)
def relative_turn(
    model: ReceiverModel, segment: int, time_records: float, range_m: float, ahead_m: float, faster_mps: float
) -> float:
    """Phase of one beamlet's echo relative to another's, in turns, counted from the time of validity.

    With k of the light that returns the phase is that of exp(-2jkL): it turns with the beamlets' own Doppler shifts,
    and from segment to segment as the optical frequency changes, over a beamlet's range beside the other's.

    Args:
        time_records: from the time of validity, in records.
        range_m: of the other, whose delay selects the light that returns.
        ahead_m, faster_mps: range and closing speed minus the other's, at the time of validity.
    """
    carrier = model.carrier_ratio[segment] - 1.0
    if segment != 1:
        shift = model.slope_over_carrier_per_m * range_m
        carrier += -shift if segment == 0 else shift
    off_carrier = carrier / model.speed_bin_mps / model.record_time_s
    return faster_mps / model.speed_bin_mps * time_records - off_carrier * ahead_m


@kernel(fastmath=FAST)
def set_segment_tones(
    model: ReceiverModel,
    segment: int,
    time_records: float,
    acceleration_mps2: float,
    common_turn: float,
    beamlets: FloatArray,
    weights: FloatArray,
    tones: FloatArray,
) -> None:
    """Tones of a record whose centre lies `time_records` after the time of validity.

    Weights are those of `set_weights`, the field of the echo per beamlet. A beamlet's phase turns with its own Doppler
    shift beside that of the first, and with the optical frequency of the segment times its range beside that of the
    first: the part of the speckle's change that is not an exchange of scatterers. Without speckle all add in phase.

    Args:
        beamlets: (5, n) from `gather_beamlets`.
        weights: (2, n).
        tones: (4, n) receives n, δ and the complex weight.
    """
    _set_places(model, segment, time_records * model.record_time_s, acceleration_mps2, beamlets, tones)
    if model.speckle:
        _set_speckled(model, segment, time_records, common_turn, beamlets, weights, tones)
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


# Each stage is a loop of its own, and reads the model ahead of it: so they become vector instructions.


@kernel(fastmath=FAST)
def _set_places(
    model: ReceiverModel,
    segment: int,
    time_s: float,
    acceleration_mps2: float,
    beamlets: FloatArray,
    tones: FloatArray,
) -> None:
    """The signed beats at a record's own time, for now in the first row."""
    per_m, per_mps, per_m_mps = _beat_terms(model, segment)
    range_m, rate_mps, speed_mps = beamlets[RANGE_M], beamlets[RANGE_RATE_MPS], beamlets[SPEED_MPS]
    beat = tones[0]
    for i in range(len(beat)):
        distance_m, closing_mps = range_m[i] + rate_mps[i] * time_s, speed_mps[i] + acceleration_mps2 * time_s
        beat[i] = per_m * distance_m + (per_mps + per_m_mps * distance_m) * closing_mps


@kernel(fastmath=FAST)
def _set_speckled(
    model: ReceiverModel,
    segment: int,
    time_records: float,
    common_turn: float,
    beamlets: FloatArray,
    weights: FloatArray,
    tones: FloatArray,
) -> None:
    """The echo's field of each beamlet."""
    # In the up-chirp the beat rises with the delay: the echo's field enters as its conjugate.
    sense = -1.0 if segment == 0 else 1.0
    range_m, speed_mps, amplitude = beamlets[RANGE_M], beamlets[SPEED_MPS], beamlets[AMPLITUDE]
    # The turn is linear in what sets a beamlet apart from the first.
    per_m = sense * relative_turn(model, segment, time_records, range_m[0], 1.0, 0.0)
    per_mps = sense * relative_turn(model, segment, time_records, range_m[0], 0.0, 1.0)
    first_m, first_mps = range_m[0], speed_mps[0]
    field_re, field_im = weights[0], weights[1]
    tone_re, tone_im = tones[2], tones[3]
    for i in range(len(tone_re)):
        turn = common_turn + per_m * (range_m[i] - first_m) + per_mps * (speed_mps[i] - first_mps) + 0.5
        tone_re[i] = turn - np.floor(turn)
    for i in range(len(tone_re)):
        tone_re[i], tone_im[i] = unit_phasor(tone_re[i])
    for i in range(len(tone_re)):
        re, im = amplitude[i] * field_re[i], sense * amplitude[i] * field_im[i]
        cosine, sine = tone_re[i], tone_im[i]
        tone_re[i], tone_im[i] = re * cosine - im * sine, re * sine + im * cosine


@kernel(fastmath=FAST)
def _fold(length: float, tones: FloatArray) -> None:
    """Signed beats in the first row to n and δ, and what becomes of the weights; see `fold`."""
    whole, rest, tone_re, tone_im = tones[0], tones[1], tones[2], tones[3]
    for i in range(len(whole)):
        observed_bin, factor_re, factor_im = fold(whole[i], length)
        nearest = np.rint(observed_bin)
        whole[i], rest[i] = nearest, observed_bin - nearest
        tone_re[i], tone_im[i] = factor_re * tone_re[i], factor_im * tone_im[i]
