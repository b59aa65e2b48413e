"""Sources of peaks that are not the surface's, by the beats that they would have."""

from __future__ import annotations

from math import log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.receiver.beat_tones import signed_bin
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import (
    DUST_FAR_M,
    DUST_FASTEST_MPS,
    DUST_NEAR_M,
    DUST_SLOWEST_MPS,
    DUST_W,
    FalseTarget,
)

_signed_bin: Any = interpreted(signed_bin)

_NEAR_BINS = 3.0
"""Largest distance of a peak from the line of its source."""

_FOOTPRINT_BINS = 10.0
"""Largest distance of a peak from the line of a surface, over its footprint and the motion between the segments."""


def has_false_targets(model: ReceiverModel) -> bool:
    """Whether a receiver has a source of false targets."""
    return model.back_reflection.snr > 0.0 or model.ripple.largest_index > 0.0 or model.haze.snr_per_m > 0.0


def false_targets(
    model: ReceiverModel,
    segment_peak_hz: FloatArray,
    range_m: FloatArray,
    closing_speed_mps: FloatArray,
    leakage: bool = False,
    air_speed_mps: FloatArray | None = None,
    dust: FloatArray | None = None,
) -> NDArray[np.uint8]:
    """Find the source of a peak that lies nearer to its line than to the surface's, in any segment.

    A peak in a band of haze or dust is its own where the light makes it at least twice as likely as noise does.

    Args:
        model: from `build_receiver`.
        segment_peak_hz: (shots, beams, 3) frequencies of the strongest peaks; NaN where there is none.
        range_m, closing_speed_mps: (shots, beams) truth at the time of validity; NaN where there is no surface.
        leakage: whether beams receive the echoes of others.
        air_speed_mps: (shots, beams) closing speed of the air; None marks no haze.
        dust: see `Echoes`; None marks no dust.

    Returns:
        (shots, beams) codes of `FalseTarget`.
    """
    found = np.zeros(range_m.shape, dtype=np.uint8)
    hazy, dusty = np.zeros((2, *range_m.shape), dtype=bool)
    for segment in range(3):
        peak_bin = segment_peak_hz[..., segment] / model.bin_width_hz
        then_m = range_m - (segment - 1) * model.segment_records * model.record_time_s * closing_speed_mps
        surface = _observed(model, segment, then_m, closing_speed_mps)
        if air_speed_mps is not None:
            hazy |= _is_haze(model, segment, peak_bin, surface, range_m, air_speed_mps)
        if dust is not None:
            dusty |= _is_dust(model, segment, peak_bin, surface, dust)
        if leakage:
            others = np.abs(peak_bin[..., None] - surface[:, None, :])
            near = (others <= _FOOTPRINT_BINS).any(axis=-1)
            found[near & ~(np.abs(peak_bin - surface) <= _FOOTPRINT_BINS)] = FalseTarget.LEAKAGE
        if segment == 1:
            continue
        if model.ripple.largest_index > 0.0:
            beside = np.abs(peak_bin - surface)
            spacing, orders = model.ripple.frequency_bin, model.ripple.orders
            order = np.clip(np.rint(beside / spacing), 1.0, orders)
            away = np.abs(beside - order * spacing)
            found[(away <= _NEAR_BINS) & (away < beside)] = FalseTarget.SIDE_LINE
        if model.back_reflection.snr == 0.0:
            continue
        reflection = _observed(model, segment, np.asarray(model.back_reflection.range_m), np.zeros(()))
        away = np.abs(peak_bin - reflection)
        nearer = ~(np.abs(peak_bin - surface) <= away)
        found[(away <= _NEAR_BINS) & nearer] = FalseTarget.BACK_REFLECTION
    found[hazy & (found == FalseTarget.NONE)] = FalseTarget.HAZE
    found[dusty & (found == FalseTarget.NONE)] = FalseTarget.DUST
    return found


def _is_dust(
    model: ReceiverModel, segment: int, peak_bin: FloatArray, surface_bin: FloatArray, dust: FloatArray
) -> BoolArray:
    near_m, far_m = dust[..., DUST_NEAR_M], dust[..., DUST_FAR_M]
    slow_bin = _signed_bin(model, segment, near_m, dust[..., DUST_SLOWEST_MPS])
    fast_bin = _signed_bin(model, segment, near_m, dust[..., DUST_FASTEST_MPS])
    length_bin = _signed_bin(model, segment, far_m, dust[..., DUST_SLOWEST_MPS]) - slow_bin
    first_bin = np.minimum(slow_bin, fast_bin) - _NEAR_BINS
    last_bin = np.maximum(slow_bin, fast_bin) + length_bin + _NEAR_BINS
    width_bin = np.maximum(np.abs(fast_bin - slow_bin), 1.0)
    within = np.zeros(peak_bin.shape, dtype=bool)
    for image_bin in (peak_bin, -peak_bin):
        folds = np.ceil((first_bin - image_bin) / model.fft_length)
        within |= image_bin + folds * model.fft_length <= last_bin
    strong = _is_likely(model, dust[..., DUST_W] * model.snr_per_w / width_bin)
    return np.asarray(within & strong & ~(np.abs(peak_bin - surface_bin) <= _FOOTPRINT_BINS))


def _is_haze(
    model: ReceiverModel,
    segment: int,
    peak_bin: FloatArray,
    surface_bin: FloatArray,
    range_m: FloatArray,
    air_speed_mps: FloatArray,
) -> BoolArray:
    beside = np.abs(peak_bin - surface_bin)
    if segment == 1:
        away = np.abs(peak_bin - _observed(model, 1, np.zeros(()), air_speed_mps))
        return np.asarray((away <= _NEAR_BINS) & ~(beside <= away))
    zero_bin = _signed_bin(model, segment, 0.0, air_speed_mps)
    end_m = np.where(np.isnan(range_m), np.inf, range_m) - _FOOTPRINT_BINS / model.beat_bin_per_m
    end_m = np.minimum(end_m, model.record_edge_range_m)
    length, power = model.fft_length, np.zeros(range_m.shape)
    for beat_bin in (peak_bin, -peak_bin, peak_bin - length, length - peak_bin):
        r = (beat_bin - zero_bin) / model.beat_bin_per_m
        spread = 1.0 + (r / model.haze.rayleigh_range_m) ** 2
        density = np.exp(-2.0 * model.haze.extinction_per_m * np.maximum(r, 0.0)) / spread
        power += np.where((r * model.beat_bin_per_m > -1.0) & (r < end_m), density, 0.0)
    power *= model.haze.snr_per_m / model.beat_bin_per_m
    return np.asarray(_is_likely(model, power) & ~(beside <= _FOOTPRINT_BINS))


def _is_likely(model: ReceiverModel, power: FloatArray) -> BoolArray:
    """Whether light of this power in a bin makes a peak there twice as likely as noise does."""
    return np.asarray(model.looks * model.threshold * power / (1.0 + power) > log(2.0))


def _observed(
    model: ReceiverModel, segment: int, range_m: FloatArray, closing_speed_mps: FloatArray
) -> FloatArray:
    beat = _signed_bin(model, segment, range_m, closing_speed_mps)
    return np.asarray(np.abs(beat - model.fft_length * np.rint(beat / model.fft_length)))
