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
from lidar_emu.receiver.range_speed_estimation import ALL, CHIRP_MINUS_DOPPLER, DOWN, UP
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam, Candidate
from lidar_emu.receiver.returns import DUST_W, RETURN_COLUMNS, Echoes, Reason
from lidar_emu.receiver.segment_spectrum import lay_spectra, set_spectrum
from lidar_emu.receiver.skip_limits import negligible_bin2
from lidar_emu.receiver.speckle import needed_level, streak_drift, travel_per_s
from lidar_emu.receiver.spectrum import fold
from lidar_emu.receiver.target_pairs import explain, pair_targets, take_strongest
from lidar_emu.receiver.volume_light import haze_snr
from lidar_emu.receiver.workspace import Workspace, as_workspace

BEAM_RETURN = np.dtype(
    [(name, column.dtype, column.components) for name, column in RETURN_COLUMNS.items()], align=True
)
"""One row of `Returns`."""

_VALID = int(Reason.VALID)
_NOT_FIRED = int(Reason.NOT_FIRED)
_BELOW_THRESHOLD = int(Reason.BELOW_THRESHOLD)
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
        rows: (shots, beams) of BEAM_RETURN.
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
                _count_targets(model, work, row, segment, targets)
            _conclude(model, work, row)


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
        row.second_reason = _INSIDE_GROUND
        return False
    row.second_reason = _BELOW_THRESHOLD
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
def _count_targets(model: ReceiverModel, work: Workspace, row: Any, segment: int, count: int) -> None:
    """Number of targets of a segment: none in a lost one; frequencies are folded again where samples are missing."""
    if model.lost_segments & (1 << segment):
        count = 0
    if model.sampled_length < model.fft_length:
        for t in range(count):
            target = work.targets[segment, t]
            target.frequency_bin, _, _ = fold(target.frequency_bin, model.sampled_length)
    if count > 0:
        row.segments |= 1 << segment
    work.counts[segment] = count


@kernel
def _blank(row: Any, fired: bool, inside: bool) -> None:
    row.reason = _VALID if fired and not inside else (_INSIDE_GROUND if fired else _NOT_FIRED)
    row.range_valid = row.speed_valid = row.sign_resolved = False
    row.segments = row.returns = 0
    row.range_m = np.nan
    row.closing_speed_mps = np.nan
    row.snr_db = np.nan
    row.residual_mps = np.nan
    row.sigma_range_m = np.nan
    row.sigma_speed_mps = np.nan
    row.second_range_m = np.nan
    row.second_sigma_range_m = np.nan
    row.range_degrees_of_freedom = np.nan
    row.second_reason = row.reason
    row.segment_peak_hz[:] = np.nan
    row.speckle_bin2[:] = 0.0


@kernel
def _conclude(model: ReceiverModel, work: Workspace, row: Any) -> None:
    segments: Any = np.int64(row.segments)
    candidates, accepted, first = work.candidates, 0, 0
    if segments == ALL:
        accepted = pair_targets(model, work.counts, work.targets, work.triple, candidates)
        row.returns = accepted
        if accepted > 0:
            first = take_strongest(work.counts, candidates)
    else:
        candidate = candidates[0]
        candidate.up = candidate.constant = candidate.down = 0
        if _detections(segments) >= model.least_segments:
            explain(model, segments, work.targets, work.triple, candidate)
    best = candidates[first]
    _report_peaks(model, segments, work.targets, best, row)
    if _detections(segments) < model.least_segments:
        return
    row.residual_mps = 0.5 * best.residual_bin * model.speed_bin_mps
    row.reason = _reason(model, segments, best, accepted)
    if row.reason == _VALID:
        if segments == ALL:
            row.returns = max(accepted, 1)
        row.range_valid = row.speed_valid = True
        row.sign_resolved = best.sign_resolved
        row.range_m = best.range_bin * model.range_bin_m
        row.closing_speed_mps = best.doppler_bin * model.speed_bin_mps
        row.sigma_range_m = sqrt(best.range_variance) * model.range_bin_m
        row.sigma_speed_mps = sqrt(best.doppler_variance) * model.speed_bin_mps
        row.speckle_bin2[0, 0], row.speckle_bin2[0, 1] = best.speckle_bin2[0], best.speckle_bin2[1]
    _report_second(model, work, row)


@kernel
def _detections(segments: int) -> int:
    return (segments & 1) + (segments >> 1 & 1) + (segments >> 2)


@kernel
def _report_peaks(
    model: ReceiverModel, segments: int, targets: NDArray[Any], best: Candidate, row: Any
) -> None:
    """Beats of the first return, or of the strongest targets, and the mean of their signal-to-noise ratios."""
    power = 0.0
    for segment in range(3):
        if segments & (1 << segment):
            rank = best.up if segment == 0 else (best.constant if segment == 1 else best.down)
            target = targets[segment, rank]
            row.segment_peak_hz[segment] = target.frequency_bin * model.bin_width_hz
            power += target.power_over_noise
    if segments:
        scale = model.noise_power / model.window.centre**2
        row.snr_db = 10.0 * log10(scale * power / _detections(segments))


@kernel
def _reason(model: ReceiverModel, segments: int, best: Candidate, accepted: int) -> int:
    # The published detector does not check its residual, and two segments have none.
    checked = segments == ALL and model.combine_method != CHIRP_MINUS_DOPPLER
    # Two chirps alone fit with range and Doppler shift exchanged.
    swapped = segments == UP | DOWN and not best.sign_resolved
    if (checked and accepted == 0) or swapped or not best.range_bin >= 0.0:
        return _AMBIGUOUS
    return _BEYOND_RANGE if best.range_bin * model.range_bin_m > model.maximum_range_m else _VALID


@kernel
def _report_second(model: ReceiverModel, work: Workspace, row: Any) -> None:
    if row.returns < 2:
        if max(work.counts[0], work.counts[2]) > 1:
            row.second_reason = _AMBIGUOUS
        return
    second = work.candidates[take_strongest(work.counts, work.candidates)]
    row.second_reason = _BEYOND_RANGE
    if second.range_bin * model.range_bin_m <= model.maximum_range_m:
        row.second_reason = _VALID
        row.second_range_m = second.range_bin * model.range_bin_m
        row.second_sigma_range_m = sqrt(second.range_variance) * model.range_bin_m
        row.speckle_bin2[1, 0], row.speckle_bin2[1, 1] = second.speckle_bin2[0], second.speckle_bin2[1]
