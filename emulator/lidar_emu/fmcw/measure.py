"""The kernel over shots and beams: tones, spectra, targets, estimate."""

from __future__ import annotations

from math import cos, log10, pi, sin, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.arrays import FloatArray
from lidar_emu.fmcw.detect import BIN_VARIANCE, MAX_GROUPS, find_groups, hann_peak
from lidar_emu.fmcw.estimate import Estimate, chirp_minus_doppler, least_squares
from lidar_emu.fmcw.philox import uniform_pair, unit_phasor
from lidar_emu.fmcw.reasons import Reason
from lidar_emu.fmcw.spectrum import (
    BIN,
    BINS_PER_TONE,
    POWER,
    ROWS,
    add_noise,
    fold,
    lay_bins,
    mirror_ends,
    set_power,
    set_tones,
)
from lidar_emu.kernels import njit

if TYPE_CHECKING:
    from lidar_emu.fmcw.receiver import ReceiverModel

BEAM_RETURN = np.dtype(
    [
        ("range_m", "f8"),
        ("closing_speed_mps", "f8"),
        ("snr_db", "f8"),
        ("residual_mps", "f8"),
        ("sigma_range_m", "f8"),
        ("sigma_speed_mps", "f8"),
        ("second_range_m", "f8"),
        ("segment_peak_hz", "f8", (3,)),
        ("range_valid", "?"),
        ("speed_valid", "?"),
        ("sign_resolved", "?"),
        ("reason", "i1"),
        ("segments", "u1"),
        ("returns", "u1"),
    ],
    align=True,
)
"""One row of `Returns`."""

_PHASE = 1
_NOISE = 2
"""What a random number is for; part of its counter."""

_SEGMENT_INDICES = 2**24
"""Indices kept for the bins of each segment; N is at most 2**24."""

_MOST_SNR = 1e30
"""Echoes are held below it, so that powers stay finite for any input."""

_VALID = int(Reason.VALID)
_NOT_FIRED = int(Reason.NOT_FIRED)
_NO_SURFACE = int(Reason.NO_SURFACE)
_BELOW_THRESHOLD = int(Reason.BELOW_THRESHOLD)
_BEYOND_RANGE = int(Reason.BEYOND_RANGE)
_INSIDE_GROUND = int(Reason.INSIDE_GROUND)
_AMBIGUOUS = int(Reason.AMBIGUOUS)


@njit(cache=True)
def measure_beams(
    model: ReceiverModel,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    power_w: FloatArray,
    fired: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    shot: NDArray[np.int64],
    seed: np.uint64,
    rows: NDArray[Any],
) -> None:
    """Fill `rows` (shots, beams) from beamlets (shots, beams, beamlets); see `receive`."""
    beamlets = range_m.shape[2]
    beats = np.empty((4, beamlets))
    tones = np.empty((4, beamlets))
    spectrum = np.empty((ROWS, beamlets * BINS_PER_TONE))
    targets = np.empty((3, MAX_GROUPS, 2))
    for s in range(range_m.shape[0]):
        for b in range(range_m.shape[1]):
            row = rows[s, b]
            _blank(row)
            if not fired[s, b]:
                row.reason = _NOT_FIRED
            elif inside[s, b]:
                row.reason = _INSIDE_GROUND
            else:
                row.reason, count = _gather_beats(
                    model, range_m[s, b], closing_speed_mps[s, b], power_w[s, b], beats
                )
                if count > 0:
                    _measure_beam(
                        model, beats[:, :count], tones[:, :count], spectrum, targets, shot[s], b, seed, row
                    )


@njit(cache=True)
def _blank(row: Any) -> None:
    row.range_m = np.nan
    row.closing_speed_mps = np.nan
    row.snr_db = np.nan
    row.residual_mps = np.nan
    row.sigma_range_m = np.nan
    row.sigma_speed_mps = np.nan
    row.second_range_m = np.nan
    row.segment_peak_hz[:] = np.nan


@njit(cache=True, error_model="numpy")
def _gather_beats(
    model: ReceiverModel,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    power_w: FloatArray,
    beats: FloatArray,
) -> tuple[int, int]:
    """Fill rows 0 to 2 of `beats`: range beat, Doppler shift and amplitude of the beamlets that return light.

    Returns:
        The reason why nothing can be detected, for the case that nothing is, and the number of tones.
    """
    reason = _NO_SURFACE
    count = 0
    total_w = 0.0
    for i in range(len(range_m)):
        distance_m, power = range_m[i], power_w[i]
        if distance_m <= 0.0:
            return _INSIDE_GROUND, 0
        if distance_m > model.record_edge_range_m:
            if reason == _NO_SURFACE:
                reason = _BEYOND_RANGE
        elif distance_m > 0.0:
            reason = _BELOW_THRESHOLD
            if 0.0 < power < np.inf and np.isfinite(closing_speed_mps[i]):
                beats[0, count] = distance_m / model.range_bin_m
                beats[1, count] = closing_speed_mps[i] / model.speed_bin_mps
                beats[2, count] = power
                total_w += power
                count += 1
    amplitude = sqrt(min(total_w * model.snr_per_w, _MOST_SNR))
    for i in range(count):
        beats[2, i] *= amplitude / total_w
    return reason, count


@njit(cache=True)
def _measure_beam(
    model: ReceiverModel,
    beats: FloatArray,
    tones: FloatArray,
    spectrum: FloatArray,
    targets: FloatArray,
    shot: int,
    beam: int,
    seed: np.uint64,
    row: Any,
) -> None:
    """Three segments of one beam, and what they say together."""
    returns = MAX_GROUPS
    power = 0.0
    detections = 0
    for segment in range(3):
        count, highest = _measure_segment(
            model, beats, tones, spectrum, targets[segment], segment, shot, beam, seed
        )
        returns = min(returns, count)
        if count > 0:
            row.segments |= 1 << segment
            row.segment_peak_hz[segment] = targets[segment, 0, 0] * model.bin_width_hz
            power += highest
            detections += 1
    row.returns = returns
    if detections > 0:
        scale = model.noise_power / model.window_centre**2
        row.snr_db = 10.0 * log10(scale * power / detections)
    if detections == 3:
        _report(model, _estimate(model, targets[:, 0]), row)
    if returns > 1:
        second = _estimate(model, targets[:, 1])
        distance_m = second.range_bin * model.range_bin_m
        if second.found and 0.0 <= distance_m <= model.maximum_range_m:
            row.second_range_m = distance_m


@njit(cache=True)
def _measure_segment(
    model: ReceiverModel,
    beats: FloatArray,
    tones: FloatArray,
    spectrum: FloatArray,
    targets: FloatArray,
    segment: int,
    shot: int,
    beam: int,
    seed: np.uint64,
) -> tuple[int, float]:
    """Spectrum and targets of one segment.

    Fills `targets` (MAX_GROUPS, 2) with frequency and its variance in bins, strongest first.

    Returns:
        Number of targets, and power of the highest bin over the mean noise power.
    """
    length = model.fft_length
    range_sign = 0.0 if segment == 1 else 1.0
    doppler_sign = -1.0 if segment == 0 else 1.0
    turn, _ = uniform_pair(seed, shot, beam, _PHASE, segment)
    phase_re, phase_im = unit_phasor(turn)
    for i in range(tones.shape[1]):
        signed_bin = range_sign * beats[0, i] + doppler_sign * beats[1, i]
        observed_bin, factor_re, factor_im = fold(signed_bin, length)
        tones[0, i] = np.rint(observed_bin)
        tones[1, i] = observed_bin - tones[0, i]
        tones[2, i] = factor_re * beats[2, i] * phase_re
        tones[3, i] = factor_im * beats[2, i] * phase_im
    count = lay_bins(tones[0], length, beats[3], spectrum)
    set_tones(tones, length, spectrum, count)
    add_noise(seed, shot, beam, _NOISE, segment * _SEGMENT_INDICES, length, spectrum, count)
    mirror_ends(length, spectrum, count)
    cosine, sine = cos(pi / length), sin(pi / length)
    set_power(model.window_centre, model.window_side, cosine, sine, length, spectrum, count)

    peaks = np.empty(MAX_GROUPS, dtype=np.int64)
    threshold = model.threshold * model.noise_power
    groups = find_groups(spectrum[POWER, :count], threshold, model.group_power_share, peaks)
    for g in range(groups):
        offset, variance = 0.0, BIN_VARIANCE
        if model.three_bin_peak:
            offset, variance = hann_peak(spectrum, peaks[g], cosine, sine)
            if _touches_its_image(spectrum[BIN, peaks[g]], length):
                variance = max(variance, BIN_VARIANCE)
        targets[g, 0] = spectrum[BIN, peaks[g]] + offset
        targets[g, 1] = variance
    return groups, spectrum[POWER, peaks[0]] / model.noise_power if groups > 0 else 0.0


@njit(cache=True)
def _touches_its_image(peak_bin: float, length: float) -> bool:
    """Within two bins of 0 or N/2 a tone's own image biases the three-bin peak by up to half a bin."""
    return peak_bin <= 2.0 or peak_bin >= 0.5 * length - 2.0


@njit(cache=True)
def _estimate(model: ReceiverModel, targets: FloatArray) -> Estimate:
    """One target of each segment, (3, 2), combined."""
    up, constant, down = targets[0, 0], targets[1, 0], targets[2, 0]
    up_var, constant_var, down_var = targets[0, 1], targets[1, 1], targets[2, 1]
    if model.joint_estimate:
        farthest_bin = model.record_edge_range_m / model.range_bin_m
        return least_squares(
            up, constant, down, up_var, constant_var, down_var, model.fft_length, farthest_bin
        )
    return chirp_minus_doppler(up, constant, down, up_var, constant_var, down_var)


@njit(cache=True)
def _report(model: ReceiverModel, estimate: Estimate, row: Any) -> None:
    """An estimate in SI, if it may be reported, else the reason why not."""
    distance_m = estimate.range_bin * model.range_bin_m
    row.residual_mps = 0.5 * estimate.residual_bin * model.speed_bin_mps
    row.sign_resolved = estimate.sign_resolved
    if not (estimate.found and distance_m >= 0.0):
        row.reason = _AMBIGUOUS
    elif distance_m > model.maximum_range_m:
        row.reason = _BEYOND_RANGE
    else:
        row.reason = _VALID
        row.range_valid = True
        row.speed_valid = True
        row.range_m = distance_m
        row.closing_speed_mps = estimate.doppler_bin * model.speed_bin_mps
        row.sigma_range_m = sqrt(estimate.range_variance) * model.range_bin_m
        row.sigma_speed_mps = sqrt(estimate.doppler_variance) * model.speed_bin_mps
