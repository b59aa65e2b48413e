"""Result of one beam from the targets of three segments: range, closing speed, or the reason why there is none."""

from __future__ import annotations

from functools import partial
from typing import Literal, assert_never

import numpy as np

from lidar_emu.fmcw.range_speed_estimation import ALL
from lidar_emu.fmcw.residual_limit import ResidualLimit, largest_residual_bin
from lidar_emu.fmcw.returns import Reason, Returns
from lidar_emu.fmcw.stated_variance import VarianceLaw, build_variance_law, inconsistency, state_variances
from lidar_emu.fmcw.waveform.detection import Targets, window_gain, window_noise_power
from lidar_emu.fmcw.waveform.estimation import Combined, chirp_minus_doppler, least_squares
from lidar_emu.fmcw.workspace import TARGET
from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import interpreted, with_fields
from lidar_emu.scenario.instrument import Detection, Waveform


def to_beam_result(
    waveform: Waveform,
    detection: Detection,
    targets: tuple[Targets, Targets, Targets],
    windowed_level: FloatArray,
    residual_limit: ResidualLimit | None = None,
) -> Returns:
    """Range and closing speed (records,) from the strongest target of each segment, or the reason why there are none.

    Args:
        waveform, detection: parts of the instrument; slope and frequency are the nominal ones.
        targets: targets of up-chirp, constant segment and down-chirp.
        windowed_level: mean noise power of a windowed bin, one for all or (N/2 + 1,).
        residual_limit: limit of the residual; None: none.
    """
    range_per_bin_m, speed_per_bin_mps = waveform.range_bin_m, waveform.speed_bin_mps
    detected = np.isfinite([target.frequency_bin[:, 0] for target in targets])
    everywhere = detected.all(axis=0)
    law = build_variance_law(waveform, detection)
    combined = _combine(waveform, detection, law, targets, 0)
    range_m = combined.range_bin * range_per_bin_m
    reason = np.full(range_m.shape, Reason.BELOW_THRESHOLD, dtype=np.int8)
    reason[everywhere] = Reason.VALID
    reason[everywhere & ~(range_m >= 0.0)] = Reason.AMBIGUOUS
    reason[everywhere & (range_m > detection.maximum_range_m)] = Reason.BEYOND_RANGE
    if residual_limit is not None and detection.combine != "chirp_minus_doppler":
        largest = np.vectorize(partial(interpreted(largest_residual_bin), residual_limit), otypes=[float])
        largest_bin = largest(combined.range_bin, combined.doppler_bin, combined.residual_variance)
        reason[everywhere & (np.abs(combined.residual_bin) > largest_bin)] = Reason.AMBIGUOUS
    valid = reason == Reason.VALID
    second_m = _combine(waveform, detection, law, targets, 1).range_bin * range_per_bin_m
    second_m[~((second_m >= 0.0) & (second_m <= detection.maximum_range_m))] = np.nan
    return Returns.with_columns(
        range_m.shape,
        range_m=np.where(valid, range_m, np.nan),
        closing_speed_mps=np.where(valid, combined.doppler_bin * speed_per_bin_mps, np.nan),
        range_valid=valid,
        speed_valid=valid,
        reason=reason,
        sign_resolved=valid & combined.sign_resolved,
        segments=np.packbits(detected, axis=0, bitorder="little")[0],
        snr_db=_snr_db(waveform, detection, targets, windowed_level),
        residual_mps=0.5 * combined.residual_bin * speed_per_bin_mps,
        sigma_range_m=np.where(valid, np.sqrt(combined.range_variance) * range_per_bin_m, np.nan),
        sigma_speed_mps=np.where(valid, np.sqrt(combined.doppler_variance) * speed_per_bin_mps, np.nan),
        returns=np.min([np.isfinite(t.power).sum(axis=1) for t in targets], axis=0).astype(np.uint8),
        second_range_m=second_m,
        segment_peak_hz=np.stack([t.frequency_bin[:, 0] for t in targets], axis=-1) * waveform.bin_width_hz,
    )


def unseen(range_m: FloatArray, edge_m: float) -> Reason:
    """Reason why nothing was detected."""
    if np.isnan(range_m).all():
        return Reason.NO_SURFACE
    return Reason.BELOW_THRESHOLD if np.nanmin(range_m) <= edge_m else Reason.BEYOND_RANGE


def nothing(reason: Reason) -> Returns:
    """Report of a beam that is not measured."""
    return Returns.with_columns((1,), reason=np.array([reason], dtype=np.int8))


def _combine(
    waveform: Waveform,
    detection: Detection,
    law: VarianceLaw,
    targets: tuple[Targets, Targets, Targets],
    rank: Literal[0, 1],
) -> Combined:
    """Combine the targets of one rank where all three segments have one; NaN elsewhere. Variances are as stated."""
    observed = np.stack([target.frequency_bin[:, rank] for target in targets], axis=-1)
    there = np.asarray(np.isfinite(observed).all(axis=-1))
    variance, common = _stated_variances(law, targets, rank, there)
    farthest_bin = waveform.record_edge_range_m / waveform.range_bin_m
    if detection.combine == "chirp_minus_doppler":
        some = chirp_minus_doppler(observed[there], variance[there], waveform.fft_length, farthest_bin)
    elif detection.combine == "least_squares":
        some = least_squares(observed[there], variance[there], waveform.fft_length, farthest_bin)
    else:
        assert_never(detection.combine)

    resolved = np.zeros(len(observed), dtype=bool)
    resolved[there] = some.sign_resolved
    columns = {}
    for name in Combined._fields[:-1]:
        columns[name] = np.full(len(observed), np.nan)
        columns[name][there] = getattr(some, name)
    factor = [
        interpreted(inconsistency)(*pair)
        for pair in zip(some.residual_bin, some.residual_variance, strict=True)
    ]
    columns["range_variance"][there] *= factor
    columns["doppler_variance"][there] = some.doppler_variance * factor + common[there]
    return Combined(**columns, sign_resolved=resolved)


def _stated_variances(
    law: VarianceLaw, targets: tuple[Targets, Targets, Targets], rank: Literal[0, 1], there: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Variances (records, 3) of the frequencies, and (records,) of the error in common; NaN unless all are there."""
    variance, common = np.full((len(there), 3), np.nan), np.full(len(there), np.nan)
    for row in np.flatnonzero(there):
        three = np.zeros(3, dtype=TARGET)
        for name in (
            "frequency_bin",
            "variance_bin2",
            "quadrature_bin",
            "quadrature_variance_bin2",
            "width_bin2",
        ):
            three[name] = [getattr(target, name)[row, rank] for target in targets]
        common[row] = state_variances(law, ALL, with_fields(three))
        variance[row] = three["variance_bin2"]
    return variance, common


def _snr_db(
    waveform: Waveform,
    detection: Detection,
    targets: tuple[Targets, Targets, Targets],
    windowed_level: FloatArray,
) -> FloatArray:
    """Mean SNR over the segments with a detection, referred to a rectangular bin before the window."""
    place = np.stack([target.peak_bin[:, 0] for target in targets])
    detected = np.isfinite(place)
    level = np.broadcast_to(windowed_level, waveform.fft_length // 2 + 1)
    here = level[np.where(detected, place, 0.0).astype(int)]
    over = np.where(detected, [target.power[:, 0] for target in targets] / here, 0.0)
    count = detected.sum(axis=0)
    mean = np.where(count > 0, over.sum(axis=0) / np.maximum(count, 1), np.nan)
    window = detection.window
    rectangular = window_noise_power(window, waveform.fft_length) / window_gain(window) ** 2
    return np.asarray(10.0 * np.log10(rectangular * mean))
