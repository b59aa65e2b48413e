"""The kernel over shots and beams: three spectra, their targets, range and closing speed."""

from __future__ import annotations

from math import log10, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.fmcw.beat_tones import RANGE_M, SPEED_MPS, gather_beamlets
from lidar_emu.fmcw.bin_filter import widest_filter
from lidar_emu.fmcw.detection import find_targets
from lidar_emu.fmcw.doppler_sign_ambiguity import with_opposite_sign
from lidar_emu.fmcw.estimation import DOWN, UP, Estimate, chirp_minus_doppler, least_squares
from lidar_emu.fmcw.reasons import Reason
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.returns import RETURN_COLUMNS
from lidar_emu.fmcw.segment_spectrum import set_spectrum
from lidar_emu.fmcw.skip_limits import GROSS_RESIDUAL_BINS
from lidar_emu.fmcw.speckle import forget
from lidar_emu.fmcw.spectrum import fold
from lidar_emu.fmcw.statistical_model import draw_targets
from lidar_emu.fmcw.workspace import Workspace
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel

BEAM_RETURN = np.dtype(
    [(name, column.dtype, column.components) for name, column in RETURN_COLUMNS.items()], align=True
)
"""One row of `Returns`."""

_FASTEST = 1e12
"""Largest acceleration, place or drift."""

_VALID = int(Reason.VALID)
_NOT_FIRED = int(Reason.NOT_FIRED)
_BEYOND_RANGE = int(Reason.BEYOND_RANGE)
_INSIDE_GROUND = int(Reason.INSIDE_GROUND)
_AMBIGUOUS = int(Reason.AMBIGUOUS)


@kernel(outermost=True)
def prepare(
    models: NDArray[Any],
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    motions: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    bounded: FloatArray,
) -> int:
    """Fill `bounded` with flat `motions`, one after another, as far as the kernels' arithmetic bears them; return the
    taps of the widest filter that any beam needs. The first of them is the smear's acceleration."""
    model = models[0]
    place = 0
    for motion in motions:
        for i in range(len(motion)):
            bounded[place] = _bounded(motion[i])
            place += 1
    widest = 0
    for s in range(range_m.shape[0]):
        for b in range(range_m.shape[1]):
            smear_mps2 = bounded[s * range_m.shape[1] + b]
            for i in range(range_m.shape[2]):
                needed = widest_filter(model, range_m[s, b, i], closing_speed_mps[s, b, i], smear_mps2)
                widest = max(widest, needed)
    return widest


@kernel
def _bounded(value: float) -> float:
    """Within what the kernels' arithmetic bears, far beyond any motion; 0 where nothing is known."""
    return 0.0 if np.isnan(value) else min(max(value, -_FASTEST), _FASTEST)


@kernel(outermost=True)
def measure_spectra(
    models: NDArray[Any],
    work: Workspace,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    power_w: FloatArray,
    range_rate_mps: FloatArray,
    closing_acceleration_mps2: FloatArray,
    smear_acceleration_mps2: FloatArray,
    speckle_place: FloatArray,
    speckle_drift_per_s: FloatArray,
    fired: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    shot: NDArray[np.int64],
    seed: np.uint64,
    rows: NDArray[Any],
) -> None:
    model = models[0]
    for s in range(range_m.shape[0]):
        for b in range(range_m.shape[1]):
            row = rows[s, b]
            _blank(row, fired[s, b], inside[s, b])
            if row.reason != _VALID:
                continue
            row.reason, count, total_w = gather_beamlets(
                model,
                range_m[s, b],
                closing_speed_mps[s, b],
                power_w[s, b],
                range_rate_mps[s, b],
                work.beamlets,
            )
            if row.reason == _INSIDE_GROUND:
                continue
            smear_mps2 = smear_acceleration_mps2[s, b]
            half = 0
            if count > 0:
                first_m, first_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
                half = widest_filter(model, first_m, first_mps, smear_mps2)
            forget(work.held)
            for segment in range(3):
                bins = set_spectrum(
                    model,
                    work,
                    count,
                    half,
                    segment,
                    closing_acceleration_mps2[s, b],
                    smear_mps2,
                    speckle_place[s, b],
                    speckle_drift_per_s[s, b],
                    total_w,
                    shot[s],
                    b,
                    seed,
                )
                targets = find_targets(model, work, bins, segment, shot[s], b, seed)
                _count_targets(model, row, segment, targets, work.targets[segment])
            _conclude(model, work.targets, row)


@kernel(outermost=True)
def measure_statistically(
    models: NDArray[Any],
    work: Workspace,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    power_w: FloatArray,
    range_rate_mps: FloatArray,
    closing_acceleration_mps2: FloatArray,
    smear_acceleration_mps2: FloatArray,
    speckle_place: FloatArray,
    speckle_drift_per_s: FloatArray,
    fired: NDArray[np.bool_],
    inside: NDArray[np.bool_],
    shot: NDArray[np.int64],
    seed: np.uint64,
    rows: NDArray[Any],
) -> None:
    model = models[0]
    for s in range(range_m.shape[0]):
        for b in range(range_m.shape[1]):
            row = rows[s, b]
            _blank(row, fired[s, b], inside[s, b])
            if row.reason != _VALID:
                continue
            row.reason, count, total_w = gather_beamlets(
                model,
                range_m[s, b],
                closing_speed_mps[s, b],
                power_w[s, b],
                range_rate_mps[s, b],
                work.beamlets,
            )
            if row.reason == _INSIDE_GROUND:
                continue
            forget(work.held)
            for segment in range(3):
                targets = draw_targets(
                    model,
                    work,
                    count,
                    segment,
                    closing_acceleration_mps2[s, b],
                    smear_acceleration_mps2[s, b],
                    speckle_place[s, b],
                    speckle_drift_per_s[s, b],
                    total_w,
                    shot[s],
                    b,
                    seed,
                )
                _count_targets(model, row, segment, targets, work.targets[segment])
            _conclude(model, work.targets, row)


@kernel(forceinline=True)
def _count_targets(model: ReceiverModel, row: Any, segment: int, count: int, targets: FloatArray) -> None:
    """Note the `count` targets of a segment, as far as a faulty receiver has them."""
    if model.lost_segments & (1 << segment):
        count = 0
    if model.sampled_length < model.fft_length:
        for t in range(count):
            targets[t, 0], _, _ = fold(targets[t, 0], model.sampled_length)
    if count > 0:
        row.segments |= 1 << segment
    row.returns = count if segment == 0 else min(row.returns, count)


@kernel
def _blank(row: Any, fired: bool, inside: bool) -> None:
    """Nothing is known, and why if that is known."""
    row.reason = _VALID if fired and not inside else (_INSIDE_GROUND if fired else _NOT_FIRED)
    row.range_m = np.nan
    row.closing_speed_mps = np.nan
    row.snr_db = np.nan
    row.residual_mps = np.nan
    row.sigma_range_m = np.nan
    row.sigma_speed_mps = np.nan
    row.second_range_m = np.nan
    row.segment_peak_hz[:] = np.nan


@kernel(inline="always")
def _conclude(model: ReceiverModel, targets: FloatArray, row: Any) -> None:
    """What the targets of three segments, (3, MAX_TARGETS, 3), say together."""
    power = 0.0
    detections = 0
    for segment in range(3):
        if row.segments & (1 << segment):
            row.segment_peak_hz[segment] = targets[segment, 0, 0] * model.bin_width_hz
            power += targets[segment, 0, 2]
            detections += 1
    if detections > 0:
        scale = model.noise_power / model.window_centre**2
        row.snr_db = 10.0 * log10(scale * power / detections)
    segments: Any = np.int64(row.segments)
    if detections >= model.least_segments:
        _report(model, _estimate(model, segments, targets[:, 0]), row)
    if row.returns > 1:
        second = _estimate(model, segments, targets[:, 1])
        distance_m = second.range_bin * model.range_bin_m
        if second.found and 0.0 <= distance_m <= model.maximum_range_m:
            row.second_range_m = distance_m


@kernel
def _estimate(model: ReceiverModel, segments: int, targets: FloatArray) -> Estimate:
    """One target of each segment, (3, 4), combined."""
    up, constant, down = targets[0, 0], targets[1, 0], targets[2, 0]
    up_var, constant_var, down_var = targets[0, 1], targets[1, 1], targets[2, 1]
    if model.joint_estimate:
        farthest_bin = model.record_edge_range_m / model.range_bin_m
        estimate = least_squares(
            segments, up, constant, down, up_var, constant_var, down_var, model.fft_length, farthest_bin
        )
    else:
        estimate = chirp_minus_doppler(up, constant, down, up_var, constant_var, down_var)
    if model.opposite_doppler_sign:
        return with_opposite_sign(estimate, segments, up, constant, down, up_var, constant_var, down_var)
    return estimate


@kernel
def _report(model: ReceiverModel, estimate: Estimate, row: Any) -> None:
    """An estimate in SI, if it may be reported, else the reason why not."""
    distance_m = estimate.range_bin * model.range_bin_m
    row.residual_mps = 0.5 * estimate.residual_bin * model.speed_bin_mps
    gross = model.joint_estimate and abs(estimate.residual_bin) > GROSS_RESIDUAL_BINS
    # Two chirps alone fit range and Doppler shift either way round.
    swapped = row.segments == UP | DOWN and not estimate.sign_resolved
    if gross or swapped or not (estimate.found and distance_m >= 0.0):
        row.reason = _AMBIGUOUS
    elif distance_m > model.maximum_range_m:
        row.reason = _BEYOND_RANGE
    else:
        row.reason = _VALID
        row.range_valid = True
        row.speed_valid = True
        row.sign_resolved = estimate.sign_resolved
        row.range_m = distance_m
        row.closing_speed_mps = estimate.doppler_bin * model.speed_bin_mps
        row.sigma_range_m = sqrt(estimate.range_variance) * model.range_bin_m
        row.sigma_speed_mps = sqrt(estimate.doppler_variance) * model.speed_bin_mps
