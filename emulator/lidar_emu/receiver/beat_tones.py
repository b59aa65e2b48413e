"""Tones of one segment: beat frequencies and complex weights of the beamlets.

Frequency plan: the up-chirp ends at the carrier, the constant segment stays there, and the down-chirp starts from it.
For a beamlet at range R, delay τ = 2R/c and closing speed v the beats at a record's centre are

    g₊ = Sτ - (f - Sτ) 2v/c, g₀ = f 2v/c, g₋ = Sτ + (f + Sτ) 2v/c,

with the optical frequency f at that time; range and speed are the values at the record's own time. The samples of a
tone are Re[w exp(j2πg t)], with t from the record's centre.
"""

from __future__ import annotations

from math import pi, sin, sqrt

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import PHASE, single_phasor, uniform_pair
from lidar_emu.numerics.vectors import FAST
from lidar_emu.receiver.analog_response import is_flat, tone_gain
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.returns import Echoes, Reason
from lidar_emu.receiver.speckle import tone_count, tone_offset_bin
from lidar_emu.receiver.spectrum import LANES, fold

RANGE_M, RANGE_RATE_MPS, SPEED_MPS, AMPLITUDE, SHARE = range(5)
"""Rows of a beam's beamlets; echoes that return light, square root of SNR, and SNR over the square root of the beam's.
"""

_FASTEST_MPS = 2.9e8
"""Speed limit beyond which a beamlet counts as without light."""

_MOST_SNR = 1e24
"""Limit of the echo power, so that powers stay finite for any input."""

_NO_SURFACE = int(Reason.NO_SURFACE)
_BELOW_THRESHOLD = int(Reason.BELOW_THRESHOLD)
_BEYOND_RANGE = int(Reason.BEYOND_RANGE)
_INSIDE_GROUND = int(Reason.INSIDE_GROUND)


@kernel
def gather_beamlets(
    model: ReceiverModel, echoes: Echoes, s: int, b: int, beam: Beam, beamlets: FloatArray
) -> int:
    """Fill the first `beam.columns` columns of `beamlets`, as many as hold all beamlets with light, and set the beam's
    light.

    A column without light equals the first column with light, except for its power of 0, so that all arrays of a beam
    have the same length and are contiguous. With haze, the last column has no light.

    Returns:
        The reason to report if nothing is detected.
    """
    range_m, power_w, rates_mps = echoes.range_m[s, b], echoes.power_w[s, b], echoes.range_rate_mps[s, b]
    speeds_mps = echoes.closing_speed_mps[s, b]
    reason, edge_m = _NO_SURFACE, model.record_edge_range_m
    furthest_s = model.furthest_record_s
    count, first, columns = 0, 0, 0
    total_w = 0.0
    for i in range(len(range_m)):
        distance_m, power, speed_mps = range_m[i], power_w[i], speeds_mps[i]
        rate_mps = rates_mps[i] if abs(rates_mps[i]) < _FASTEST_MPS else 0.0
        if distance_m <= furthest_s * abs(rate_mps):
            return _INSIDE_GROUND
        if distance_m > edge_m:
            # The echo arrives after the start of the record; the remainder is detected, but reported as beyond range.
            power *= _record_share(model, (distance_m - edge_m) * model.delay_per_m) ** 2
            if reason == _NO_SURFACE:
                reason = _BEYOND_RANGE
        elif distance_m > 0.0:
            reason = _BELOW_THRESHOLD
        lit = distance_m > 0.0 and 0.0 < power < np.inf and abs(speed_mps) < _FASTEST_MPS
        beamlets[SHARE, i] = power if lit else 0.0
        if lit:
            beamlets[RANGE_M, i], beamlets[RANGE_RATE_MPS, i] = distance_m, rate_mps
            beamlets[SPEED_MPS, i] = speed_mps
            total_w += power
            first = i if count == 0 else first
            count, columns = count + 1, i + 1
    hazy = model.haze.snr_per_m > 0.0
    beam.columns = -(-max(columns + (1 if hazy else 0), 1) // LANES) * LANES
    beam.lit_beamlets, beam.power_w = count, total_w
    beamlets[SHARE, len(range_m) :] = 0.0
    if count > 0:
        _set_amplitudes(min(model.snr_per_w, _MOST_SNR / total_w), total_w, first, beam.columns, beamlets)
    elif hazy:
        beamlets[:] = 0.0
    return reason


@kernel
def _set_amplitudes(snr_per_w: float, total_w: float, first: int, columns: int, beamlets: FloatArray) -> None:
    share, amplitude = beamlets[SHARE, :columns], beamlets[AMPLITUDE, :columns]
    for i in range(len(share)):
        if share[i] == 0.0:
            for row in (RANGE_M, RANGE_RATE_MPS, SPEED_MPS):
                beamlets[row, i] = beamlets[row, first]
    per_root = 1.0 / sqrt(total_w * snr_per_w)
    for i in range(len(share)):
        snr = share[i] * snr_per_w
        amplitude[i] = sqrt(snr)
        share[i] = snr * per_root


@kernel
def _record_share(model: ReceiverModel, lost: float) -> float:
    """Amplitude ratio of a windowed bin between a line that misses the first part of its record and a whole line.

    The window is centre + 2 side cos(2πx), x from 0 to 1 over the record.
    """
    if lost >= 1.0:
        return 0.0
    return 1.0 - lost - model.window.side / model.window.centre * sin(2.0 * pi * lost) / pi


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
def speed_change_mps(beam: Beam, time_s: float) -> float:
    """Change of all closing speeds of a beam, from the time of validity."""
    return float((beam.closing_acceleration_mps2 + 0.5 * beam.closing_jerk_mps3 * time_s) * time_s)


@kernel(fastmath=FAST)
def field_sense(segment: int) -> float:
    """-1 in the up-chirp, where the beat rises with the delay and the echo field enters as its conjugate."""
    return -1.0 if segment == 0 else 1.0


@kernel(fastmath=FAST)
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


@kernel(fastmath=FAST)
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


@kernel
def place_tones(
    model: ReceiverModel,
    beam: Beam,
    segment: int,
    time_records: float,
    shift: tuple[float, float],
    beamlets: FloatArray,
    beats: FloatArray,
    tones: SingleArray,
) -> None:
    """Set beats of the beamlets, and n and δ of their tones, in a record whose centre lies `time_records` after the
    time of validity.

    Args:
        shift: change of all closing speeds since the time of validity, and change of all ranges since then beside the
            one by their rates.
        beamlets: (5, columns or more) from `gather_beamlets`.
        beats: (columns or more,) receives the signed beats of the beamlets.
        tones: (4, m columns or more) receives n and δ: a block of columns for each of the m tones of a beamlet.
    """
    columns, time_s = beam.columns, time_records * model.record_time_s
    _set_beats(_beat_terms(model, segment), time_s, shift, columns, beamlets, beats)
    whole, rest = tones[0], tones[1]
    for block in range(tone_count(beam.speckle_level)):
        first = block * columns
        offset_bin = field_sense(segment) * tone_offset_bin(beam.speckle_level, block)
        _set_places(model.fft_length, offset_bin, columns, beats, whole[first:], rest[first:])


@kernel
def weigh_tones(
    model: ReceiverModel,
    beam: Beam,
    segment: int,
    look: int,
    beamlets: FloatArray,
    beats: FloatArray,
    weights: SingleArray,
    tones: SingleArray,
) -> None:
    """Set the complex weights of a record's tones.

    Relative to the first beamlet, the phase of a beamlet rotates with the difference of their Doppler shifts, and with
    the segment's optical frequency times the difference of their ranges: with the Doppler shifts this is the part of
    the speckle's change that is not an exchange of scatterers. Without speckle all beamlets add in phase.

    Args:
        beats: from `place_tones`.
        weights: (tones, 2, columns or more) echo field of each beamlet, set by `speckle.set_weights`.
        tones: as in `place_tones`.
    """
    columns, poles = beam.columns, not is_flat(model.response)
    re, im = tones[2], tones[3]
    if model.speckle:
        if segment != 1:
            _set_phasors(model, segment, record_time(model, segment, look), columns, beamlets, re, im)
        # The first block holds the phasors that all blocks are made from.
        for block in range(tone_count(beam.speckle_level) - 1, -1, -1):
            first = block * columns
            to_re, to_im = re[first:], im[first:]
            _set_speckled(segment, columns, beamlets, weights[block], re, im, to_re, to_im)
            offset_bin = field_sense(segment) * tone_offset_bin(beam.speckle_level, block)
            _receive(model, poles, offset_bin, columns, beats, to_re, to_im)
    else:
        turn, _ = uniform_pair(beam.seed, beam.shot, beam.beam, PHASE, segment + 3 * look)
        cosine, sine = single_phasor(np.float32(turn - 0.5))
        share = beamlets[SHARE]
        for i in range(columns):
            re[i], im[i] = np.float32(share[i]) * cosine, np.float32(share[i]) * sine
        _receive(model, poles, 0.0, columns, beats, re, im)


# Each stage is a separate loop and reads the model beforehand, so that it is vectorised. Rows are passed whole, with
# the number of columns: to slice them takes as long as to compute eight columns.


@kernel(fastmath=FAST)
def _set_beats(
    terms: tuple[float, float, float],
    time_s: float,
    shift: tuple[float, float],
    columns: int,
    beamlets: FloatArray,
    beats: FloatArray,
) -> None:
    per_m, per_mps, per_m_mps = terms
    delta_speed_mps, delta_range_m = shift
    range_m, rate_mps, speed_mps = beamlets[RANGE_M], beamlets[RANGE_RATE_MPS], beamlets[SPEED_MPS]
    for i in range(columns):
        distance_m = range_m[i] + rate_mps[i] * time_s + delta_range_m
        closing_mps = speed_mps[i] + delta_speed_mps
        beats[i] = per_m * distance_m + (per_mps + per_m_mps * distance_m) * closing_mps


@kernel(fastmath=FAST)
def _set_places(
    length: float, offset_bin: float, columns: int, beats: FloatArray, whole: SingleArray, rest: SingleArray
) -> None:
    for i in range(columns):
        observed_bin, _, _ = fold(beats[i] + offset_bin, length)
        nearest = np.rint(observed_bin)
        whole[i], rest[i] = np.float32(nearest), np.float32(observed_bin - nearest)


@kernel(fastmath=FAST)
def _set_phasors(
    model: ReceiverModel,
    segment: int,
    time_records: float,
    columns: int,
    beamlets: FloatArray,
    cosine: SingleArray,
    sine: SingleArray,
) -> None:
    """Set the phasors of the beamlets relative to the first one."""
    sense = field_sense(segment)
    range_m, speed_mps = beamlets[RANGE_M], beamlets[SPEED_MPS]
    # The phase is linear in the differences between a beamlet and the first.
    per_m = sense * relative_turn(model, segment, time_records, range_m[0], 1.0, 0.0)
    per_mps = sense * relative_turn(model, segment, time_records, range_m[0], 0.0, 1.0)
    first_m, first_mps = range_m[0], speed_mps[0]
    for i in range(columns):
        turn = per_m * (range_m[i] - first_m) + per_mps * (speed_mps[i] - first_mps)
        cosine[i] = np.float32(turn - np.rint(turn))
    for i in range(columns):
        cosine[i], sine[i] = single_phasor(cosine[i])


@kernel(fastmath=FAST, noalias=False)
def _set_speckled(
    segment: int,
    columns: int,
    beamlets: FloatArray,
    weights: SingleArray,
    cosine: SingleArray,
    sine: SingleArray,
    to_re: SingleArray,
    to_im: SingleArray,
) -> None:
    """Set one tone of each beamlet from its field and phasor, which it may overwrite; in the constant segment all
    phasors are alike."""
    amplitude = beamlets[AMPLITUDE]
    sense, field_re, field_im = np.float32(field_sense(segment)), weights[0], weights[1]
    if segment == 1:
        for i in range(columns):
            scale = np.float32(amplitude[i])
            to_re[i], to_im[i] = scale * field_re[i], scale * field_im[i]
        return
    for i in range(columns):
        scale = np.float32(amplitude[i])
        re, im = scale * field_re[i], sense * scale * field_im[i]
        c, s = cosine[i], sine[i]
        to_re[i], to_im[i] = re * c - im * s, re * s + im * c


@kernel(fastmath=FAST)
def _receive(
    model: ReceiverModel,
    poles: bool,
    offset_bin: float,
    columns: int,
    beats: FloatArray,
    tone_re: SingleArray,
    tone_im: SingleArray,
) -> None:
    """Apply the receiver's poles and fold the weights; see `spectrum.fold`."""
    response, length = model.response, model.fft_length
    if poles:
        for i in range(columns):
            gain_re, gain_im = tone_gain(response, beats[i] + offset_bin)
            re, im = tone_re[i], tone_im[i]
            tone_re[i] = np.float32(re * gain_re - im * gain_im)
            tone_im[i] = np.float32(re * gain_im + im * gain_re)
    for i in range(columns):
        _, factor_re, factor_im = fold(beats[i] + offset_bin, length)
        tone_re[i], tone_im[i] = np.float32(factor_re * tone_re[i]), np.float32(factor_im * tone_im[i])
