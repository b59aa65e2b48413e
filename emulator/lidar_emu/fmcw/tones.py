"""From beamlets to the tones of one segment: beat frequencies and complex weights.

Frequency plan: the up-chirp ends at the carrier, the constant segment stays there, the down-chirp starts from it. A
beamlet at range R, delay τ = 2R/c, whose ground closes with v, beats in a record's centre at

    g₊ = Sτ - (f - Sτ) 2v/c,   g₀ = f 2v/c,   g₋ = Sτ + (f + Sτ) 2v/c,

f the optical frequency then; range and speed are those of the record's own time. The sample sequence of a tone is
Re[w exp(j2πg t)] with t from the record's centre.
"""

from __future__ import annotations

from math import pi, sin, sqrt

import numpy as np

from lidar_emu.arrays import FloatArray
from lidar_emu.fmcw.model import ReceiverModel
from lidar_emu.fmcw.philox import unit_phasor
from lidar_emu.fmcw.reasons import Reason
from lidar_emu.fmcw.response import tone_gain
from lidar_emu.fmcw.sine import FAST
from lidar_emu.fmcw.spectrum import fold
from lidar_emu.kernels import njit

RANGE_M, RANGE_RATE_MPS, SPEED_MPS, AMPLITUDE, SHARE, ORDER = range(6)
"""Rows of a beam's beamlets: what returns light, square root of its SNR, SNR over the root of the beam's, and its place
among the beamlets, lit or not."""

_FASTEST_MPS = 2.9e8
"""Nothing is faster; what claims to be returns no light."""

_MOST_SNR = 1e30
"""Echoes are held below it, so that powers stay finite for any input."""

_NO_SURFACE = int(Reason.NO_SURFACE)
_BELOW_THRESHOLD = int(Reason.BELOW_THRESHOLD)
_BEYOND_RANGE = int(Reason.BEYOND_RANGE)
_INSIDE_GROUND = int(Reason.INSIDE_GROUND)


@njit(cache=True, error_model="numpy")
def gather_beamlets(
    model: ReceiverModel,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    power_w: FloatArray,
    range_rate_mps: FloatArray,
    beamlets: FloatArray,
) -> tuple[int, int, float]:
    """Fill the first columns of `beamlets` with those that return light.

    Returns:
        The reason why nothing can be detected, for the case that nothing is; the number of beamlets; their power.
    """
    reason = _NO_SURFACE
    count = 0
    total_w = 0.0
    for i in range(len(range_m)):
        distance_m, power = range_m[i], power_w[i]
        if distance_m <= 0.0:
            return _INSIDE_GROUND, 0, 0.0
        if distance_m > model.record_edge_range_m:
            # The echo arrives when the record has begun; what is left of it is heard, but not believed.
            power *= _heard_share(model, (distance_m - model.record_edge_range_m) * model.delay_per_m) ** 2
            if reason == _NO_SURFACE:
                reason = _BEYOND_RANGE
        elif distance_m > 0.0:
            reason = _BELOW_THRESHOLD
        if distance_m > 0.0 and 0.0 < power < np.inf and abs(closing_speed_mps[i]) < _FASTEST_MPS:
            beamlets[RANGE_M, count] = distance_m
            beamlets[RANGE_RATE_MPS, count] = (
                range_rate_mps[i] if abs(range_rate_mps[i]) < _FASTEST_MPS else 0.0
            )
            beamlets[ORDER, count] = i
            beamlets[SPEED_MPS, count] = closing_speed_mps[i]
            beamlets[SHARE, count] = power
            total_w += power
            count += 1
    if count > 0:
        scale = min(model.snr_per_w, _MOST_SNR / total_w)
        for i in range(count):
            snr = beamlets[SHARE, i] * scale
            beamlets[AMPLITUDE, i] = sqrt(snr)
            beamlets[SHARE, i] = snr / sqrt(total_w * scale)
    return reason, count, total_w


@njit(cache=True)
def _heard_share(model: ReceiverModel, lost: float) -> float:
    """Amplitude of a windowed bin, of a line that misses the first part of its record, over that of a whole one.

    The window is centre - 2 side cos(2πx), x over the record.
    """
    if lost >= 1.0:
        return 0.0
    return 1.0 - lost - model.window_side / model.window_centre * sin(2.0 * pi * lost) / pi


@njit(cache=True, fastmath=FAST)
def signed_bin(model: ReceiverModel, segment: int, range_m: float, speed_mps: float) -> float:
    """The beat in bins, g₊, g₀ or g₋."""
    carrier = model.carrier_ratio[segment]
    doppler_bin = speed_mps / model.speed_bin_mps
    if segment == 1:
        return carrier * doppler_bin
    shift = model.slope_over_carrier_per_m * range_m
    beat_bin = model.beat_bin_per_m * range_m
    return (
        beat_bin - (carrier - shift) * doppler_bin
        if segment == 0
        else beat_bin + (carrier + shift) * doppler_bin
    )


@njit(cache=True, fastmath=FAST)
def relative_turn(
    model: ReceiverModel, segment: int, time_records: float, range_m: float, ahead_m: float, faster_mps: float
) -> float:
    """Phase of one beamlet's echo beside that of another, in turns, from what it is at the time of validity.

    With k of the light that returns the phase is that of exp(-2jkL): it turns with the beamlets' own Doppler shifts,
    and from segment to segment as the optical frequency changes, over a beamlet's range beside the other's.

    Args:
        time_records: from the time of validity, in records.
        range_m: of the other, whose delay says which light returns.
        ahead_m, faster_mps: range and closing speed less those of the other, at the time of validity.
    """
    carrier = model.carrier_ratio[segment] - 1.0
    if segment != 1:
        shift = model.slope_over_carrier_per_m * range_m
        carrier += -shift if segment == 0 else shift
    off_carrier = carrier / model.speed_bin_mps / model.record_time_s
    return faster_mps / model.speed_bin_mps * time_records - off_carrier * ahead_m


@njit(cache=True, fastmath=FAST, error_model="numpy")
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
        beamlets: (6, n) from `gather_beamlets`.
        weights: (2, n or more).
        tones: (4, n) receives n, δ and the complex weight.
    """
    time_s = time_records * model.record_time_s
    # In the up-chirp the beat rises with the delay: the echo's field enters as its conjugate.
    sense = -1.0 if segment == 0 else 1.0
    first_range_m, first_speed_mps = beamlets[RANGE_M, 0], beamlets[SPEED_MPS, 0]
    for i in range(tones.shape[1]):
        range_m = beamlets[RANGE_M, i] + beamlets[RANGE_RATE_MPS, i] * time_s
        speed_mps = beamlets[SPEED_MPS, i] + acceleration_mps2 * time_s
        beat = signed_bin(model, segment, range_m, speed_mps)
        if model.speckle:
            ahead_m, faster_mps = (
                beamlets[RANGE_M, i] - first_range_m,
                beamlets[SPEED_MPS, i] - first_speed_mps,
            )
            turn = relative_turn(model, segment, time_records, first_range_m, ahead_m, faster_mps)
            scale = beamlets[AMPLITUDE, i]
            re, im = scale * weights[0, i], sense * scale * weights[1, i]
            turn = sense * turn + common_turn
        else:
            turn = common_turn
            re, im = beamlets[SHARE, i], 0.0
        cosine, sine = unit_phasor(turn + 0.5 - np.floor(turn + 0.5))
        gain_re, gain_im = tone_gain(model.response, beat)
        cosine, sine = cosine * gain_re - sine * gain_im, cosine * gain_im + sine * gain_re
        observed_bin, factor_re, factor_im = fold(beat, model.fft_length)
        tones[0, i] = np.rint(observed_bin)
        tones[1, i] = observed_bin - tones[0, i]
        tones[2, i] = factor_re * (re * cosine - im * sine)
        tones[3, i] = factor_im * (re * sine + im * cosine)
