"""The spectrum of one segment: tones, their filtering by motion and linewidth, and noise."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import PHASE, uniform_pair
from lidar_emu.receiver.analog_response import clipping, set_noise
from lidar_emu.receiver.back_reflection import add_reflection, reflection_bin, reflection_power
from lidar_emu.receiver.beat_tones import (
    RANGE_M,
    SPEED_MPS,
    record_time,
    record_time_s,
    set_segment_tones,
    speed_change_mps,
)
from lidar_emu.receiver.bin_filter import filter_beam
from lidar_emu.receiver.close_tones import are_close, set_close_tones
from lidar_emu.receiver.motion_smear import LEAST_TAPS
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.speckle import set_streak_weights, set_tone_weights
from lidar_emu.receiver.spectrum import (
    BIN,
    NOISE,
    POWER,
    REACH,
    add_noise,
    fold,
    lay_bins,
    mirror_ends,
    set_power,
    set_tones,
)
from lidar_emu.receiver.sweep_error import sweep_error
from lidar_emu.receiver.volume_light import (
    add_band_places,
    band_snr,
    has_band,
    set_bands,
    set_haze_tone,
    set_level,
)
from lidar_emu.receiver.workspace import SEGMENT_INDICES, SpectrumWorkspace, Workspace, look_tones


@kernel(inline="always")
def set_spectrum(
    model: ReceiverModel, work: Workspace, spectra: SpectrumWorkspace, beam: Any, segment: int
) -> int:
    """Fill grid and bins of `spectra` with one segment of the beam in `work`.

    Returns:
        The number of bins; 0 without light.
    """
    hazy, reflected = model.haze.snr_per_m > 0.0, model.back_reflection.snr > 0.0
    if beam.lit_beamlets == 0 and not (hazy or reflected or beam.dust_snr > 0.0):
        return 0
    set_bands(model, beam, segment, record_time_s(model, segment, 0))
    banded = has_band(beam)
    reach = float(REACH + max(0, beam.filter_taps - LEAST_TAPS))
    places = spectra.places[0]
    count = 0
    if banded:
        count = add_band_places(model, beam, 2.0 * reach + 1.0, places)
    for look in range(model.looks):
        tones = look_tones(work, beam, look)
        set_record_tones(model, work, beam, segment, look, tones)
        for i in range(tones.shape[1]):
            places[count + i] = tones[0, i]
        count += tones.shape[1]
    if reflected:
        places[count], _, _ = fold(np.rint(reflection_bin(model, segment)), model.fft_length)
        count += 1
    bins = lay_bins(places[:count], reach, model.fft_length, spectra.places[1], spectra.grid)
    others = band_snr(beam) if banded else 0.0
    if reflected:
        others += reflection_power(model, segment)
    gain, distortion = clipping(model.response, look_tones(work, beam, 0), model.fft_length, others)
    factor = 1.0 + model.signal_shot_per_w * beam.power_w
    set_noise(model.response, gain * gain, factor, distortion, spectra.grid, bins)
    for look in range(model.looks):
        _set_look(model, work, spectra, beam, segment, look, gain, bins)
    cosine, sine = cos(pi / model.fft_length), sin(pi / model.fft_length)
    centre, side = model.window_centre, model.window_side
    set_power(centre, side, cosine, sine, model.fft_length, spectra.grid, bins, spectra.bins)
    if model.lowest_bin > 0.0:
        for j in range(bins):
            if spectra.grid[BIN, j] < model.lowest_bin:
                spectra.grid[POWER, j] = 0.0
    return bins


@kernel(inline="always")
def set_record_tones(
    model: ReceiverModel, work: Workspace, beam: Any, segment: int, look: int, tones: FloatArray
) -> None:
    """Set the tones of one record, of surfaces and of haze in the constant segment."""
    if beam.lit_beamlets > 0:
        set_look_tones(model, work, beam, segment, look, tones)
    else:
        # Without power, at the beat of the back-reflection, the only light.
        work.beamlets[RANGE_M] = model.back_reflection.range_m
        work.beamlets[SPEED_MPS] = 0.0
        tones[:] = 0.0
        tones[0], _, _ = fold(np.rint(reflection_bin(model, segment)), model.fft_length)
    if model.haze.snr_per_m > 0.0 and segment == 1:
        set_haze_tone(model, beam, look, record_time_s(model, segment, look), tones)


@kernel(inline="always")
def set_look_tones(
    model: ReceiverModel, work: Workspace, beam: Any, segment: int, look: int, tones: FloatArray
) -> None:
    """Set the tones of one record, with the speckle at its own time and a phase common to the beam."""
    time_records = record_time(model, segment, look)
    time_s = time_records * model.record_time_s
    if model.speckle:
        set_tone_weights(
            beam.seed,
            beam.beam,
            beam.speckle_place,
            beam.speckle_drift_per_s,
            time_s,
            model.record_time_s,
            beam.speckle_level,
            work.speckle,
            work.change,
        )
        if beam.streak_drift_per_s >= 0.0:
            set_streak_weights(
                beam.seed,
                beam.shot,
                beam.beam,
                beam.streak_drift_per_s * time_s,
                beam.speckle_level,
                model.ground_beamlets,
                work.speckle,
            )
    turn, _ = uniform_pair(beam.seed, beam.shot, beam.beam, PHASE, segment + 3 * look)
    sweep_error_m, sweep_error_mps = sweep_error(model, beam, segment, look, work.beamlets[RANGE_M, 0])
    set_segment_tones(
        model,
        segment,
        time_records,
        speed_change_mps(beam, time_s) + sweep_error_mps,
        sweep_error_m + 0.5 * beam.range_curvature_mps2 * time_s * time_s,
        turn,
        work.beamlets,
        work.speckle.weights,
        beam.speckle_level,
        tones,
    )


@kernel(inline="always")
def _set_look(
    model: ReceiverModel,
    work: Workspace,
    spectra: SpectrumWorkspace,
    beam: Any,
    segment: int,
    look: int,
    gain: float,
    count: int,
) -> None:
    length, grid, bins = model.fft_length, spectra.grid, spectra.bins[look]
    lines = look_tones(work, beam, look)
    if gain != 1.0:
        for i in range(lines.shape[1]):
            lines[2, i] *= gain
            lines[3, i] *= gain
    if are_close(length, grid, count):
        set_close_tones(lines, length, grid, count, bins, spectra.residues)
    else:
        set_tones(lines, length, grid, count, bins)
    if beam.filter_taps > 0:
        mirror_ends(length, grid, count, bins)
        filter_beam(model, work, spectra, beam, segment, look, count)
    if model.back_reflection.snr > 0.0:
        add_reflection(model, beam, segment, look, gain, grid, count, bins)
    level = NOISE
    if has_band(beam):
        level = POWER
        set_bands(model, beam, segment, record_time_s(model, segment, look))
        set_level(model, beam, gain, grid, count)
    first = (segment + 3 * look) * SEGMENT_INDICES
    add_noise(beam, first, length, grid, level, count, bins, spectra.words, spectra.noise)
    mirror_ends(length, grid, count, bins)
