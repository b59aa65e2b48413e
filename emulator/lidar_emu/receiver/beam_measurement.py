"""The kernel over shots and beams of level `spectral`: targets, range and closing speed."""

from __future__ import annotations

from math import log10, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import bounded
from lidar_emu.receiver.beat_tones import RANGE_M, gather_beamlets
from lidar_emu.receiver.detection import find_targets
from lidar_emu.receiver.range_speed_estimation import (
    CHIRP_MINUS_DOPPLER,
    DOWN,
    UP,
    Estimate,
    estimate_range_speed,
    with_opposite_sign,
)
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.residual_limit import largest_residual_bin
from lidar_emu.receiver.returns import DUST_W, RETURN_COLUMNS, Echoes, Reason
from lidar_emu.receiver.segment_spectrum import lay_spectra, set_spectrum
from lidar_emu.receiver.skip_limits import negligible_bin2
from lidar_emu.receiver.speckle import needed_level, streak_drift, travel_per_s
from lidar_emu.receiver.spectrum import fold
from lidar_emu.receiver.stated_variance import inconsistency, state_variances
from lidar_emu.receiver.volume_light import haze_snr
from lidar_emu.receiver.workspace import Workspace, as_workspace

BEAM_RETURN = np.dtype(
    [(name, column.dtype, column.components) for name, column in RETURN_COLUMNS.items()], align=True
)
"""One row of `Returns`."""

_VALID = int(Reason.VALID)
_NOT_FIRED = int(Reason.NOT_FIRED)
_BEYOND_RANGE = int(Reason.BEYOND_RANGE)
_INSIDE_GROUND = int(Reason.INSIDE_GROUND)
_AMBIGUOUS = int(Reason.AMBIGUOUS)


@kernel(outermost=True)
def measure_beams(
    models: NDArray[Any],
    work_arrays: tuple[Any, ...],
    echo_arrays: tuple[Any, ...],
    shot: NDArray[np.int64],
    seed: np.uint64,
    rows: NDArray[Any],
) -> None:
    """Measure every beam that fires.

    Structures of arrays are passed as plain tuples, because numba resolves their types faster than named tuples.

    Args:
        models: (1,) constants of the receiver.
        work_arrays: arrays of a `Workspace`, overwritten.
        echo_arrays: arrays of `Echoes`, in C order.
        shot: (shots,) numbers of the shots.
        seed: seed of the run.
        rows: (shots, beams) of BEAM_RETURN, zeroed.
    """
    model = models[0]
    work, echoes = as_workspace(work_arrays), Echoes(*echo_arrays)
    beam = work.beam[0]
    beam.seed = seed
    for s in range(rows.shape[0]):
        beam.shot = shot[s]
        for b in range(rows.shape[1]):
            row = rows[s, b]
            if not set_beam(model, work, echoes, s, b, row):
                continue
            lit = lay_spectra(model, work, beam, echoes, s, b)
            for segment in range(3):
                bins = set_spectrum(model, work, beam, segment) if lit else 0
                targets = find_targets(model, work, beam, segment, bins)
                _count_targets(model, row, segment, targets, work.targets[segment])
            _conclude(model, work.targets, row)


@kernel
def set_beam(model: ReceiverModel, work: Workspace, echoes: Echoes, s: int, b: int, row: Any) -> bool:
    """Set beam and beamlets of `work` for beam `b` of the shots' row `s`, and blank its row of BEAM_RETURN.

    Returns:
        Whether there is anything to measure; otherwise `row` has the reason.
    """
    beam = work.beam[0]
    _blank(row, echoes.fired[s, b], echoes.inside[s, b])
    if row.reason != _VALID:
        return False
    row.reason = gather_beamlets(model, echoes, s, b, beam, work.beamlets)
    if row.reason == _INSIDE_GROUND:
        return False
    beam.beam, beam.beamlets = b, echoes.range_m.shape[2]
    _set_motion(model, beam, echoes, s, b)
    beam.left_out_bin2 = negligible_bin2(model, beam.power_w)
    if model.haze.snr_per_m > 0.0:
        _set_haze(model, work, beam, echoes.air_speed_mps[s, b])
    beam.dust_snr = 0.0
    if echoes.dust.shape[2] > 0 and echoes.dust[s, b, DUST_W] > 0.0:
        _set_dust(model, beam, echoes.dust[s, b])
    beam.speckle_level = needed_level(model, beam.travel_per_s, beam.left_out_bin2)
    return True


@kernel
def _set_motion(model: ReceiverModel, beam: Beam, echoes: Echoes, s: int, b: int) -> None:
    beam.closing_acceleration_mps2 = bounded(echoes.closing_acceleration_mps2[s, b])
    beam.closing_jerk_mps3 = bounded(echoes.closing_jerk_mps3[s, b])
    beam.range_curvature_mps2 = bounded(echoes.range_curvature_mps2[s, b])
    beam.travel_per_s = travel_per_s(model, echoes.speckle_motion[s, b])
    beam.streak_drift_per_s = streak_drift(model, echoes, s, b)


@kernel
def _set_haze(model: ReceiverModel, work: Workspace, beam: Beam, air_speed_mps: float) -> None:
    beam.air_speed_mps = bounded(air_speed_mps)
    beam.haze_range_m = model.record_edge_range_m
    if beam.lit_beamlets > 0:
        beam.haze_range_m = min(beam.haze_range_m, work.beamlets[RANGE_M, 0])
    beam.haze_snr = haze_snr(model, beam.haze_range_m)
    beam.power_w += beam.haze_snr / model.snr_per_w


@kernel
def _set_dust(model: ReceiverModel, beam: Beam, dust: FloatArray) -> None:
    for column in range(len(dust)):
        beam.dust[column] = bounded(dust[column])
    beam.dust_snr = beam.dust[DUST_W] * model.snr_per_w
    beam.power_w += beam.dust[DUST_W]


@kernel
def _count_targets(model: ReceiverModel, row: Any, segment: int, count: int, targets: NDArray[Any]) -> None:
    """Number of targets of a segment: none in a lost one; frequencies are folded again where samples are missing."""
    if model.lost_segments & (1 << segment):
        count = 0
    if model.sampled_length < model.fft_length:
        for t in range(count):
            targets[t].frequency_bin, _, _ = fold(targets[t].frequency_bin, model.sampled_length)
    if count > 0:
        row.segments |= 1 << segment
    row.returns = count if segment == 0 else min(row.returns, count)


@kernel
def _blank(row: Any, fired: bool, inside: bool) -> None:
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
def _conclude(model: ReceiverModel, targets: NDArray[Any], row: Any) -> None:
    power = 0.0
    detections = 0
    for segment in range(3):
        if row.segments & (1 << segment):
            row.segment_peak_hz[segment] = targets[segment, 0].frequency_bin * model.bin_width_hz
            power += targets[segment, 0].power_over_noise
            detections += 1
    if detections > 0:
        scale = model.noise_power / model.window.centre**2
        row.snr_db = 10.0 * log10(scale * power / detections)
    segments: Any = np.int64(row.segments)
    if detections >= model.least_segments:
        common = state_variances(model.variance_law, segments, targets[:, 0])
        _report(model, _estimate(model, segments, targets[:, 0]), common, row)
    if row.returns > 1:
        state_variances(model.variance_law, segments, targets[:, 1])
        second = _estimate(model, segments, targets[:, 1])
        distance_m = second.range_bin * model.range_bin_m
        if second.found and 0.0 <= distance_m <= model.maximum_range_m:
            row.second_range_m = distance_m


@kernel
def _estimate(model: ReceiverModel, segments: int, targets: NDArray[Any]) -> Estimate:
    farthest_bin = model.record_edge_range_m / model.range_bin_m
    estimate = estimate_range_speed(model.combine_method, segments, targets, model.fft_length, farthest_bin)
    if model.opposite_doppler_sign:
        return with_opposite_sign(estimate, segments, targets)
    return estimate


@kernel
def _report(model: ReceiverModel, estimate: Estimate, common_bin2: float, row: Any) -> None:
    distance_m = estimate.range_bin * model.range_bin_m
    row.residual_mps = 0.5 * estimate.residual_bin * model.speed_bin_mps
    # The published detector has no such check, and two segments have no residual.
    gross = model.combine_method != CHIRP_MINUS_DOPPLER and abs(estimate.residual_bin) > largest_residual_bin(
        model.residual_limit, estimate.range_bin, estimate.doppler_bin, estimate.residual_variance
    )
    # Two chirps alone fit with range and Doppler shift exchanged.
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
        factor = inconsistency(estimate.residual_bin, estimate.residual_variance)
        row.sigma_range_m = sqrt(factor * estimate.range_variance) * model.range_bin_m
        row.sigma_speed_mps = sqrt(factor * estimate.doppler_variance + common_bin2) * model.speed_bin_mps
