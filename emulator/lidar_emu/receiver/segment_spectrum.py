"""The spectra of a beam's three segments: tones, their filtering by motion and linewidth, and noise."""

from __future__ import annotations

import numpy as np

from lidar_emu.numerics.arrays import SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import draw_reserved, set_normals
from lidar_emu.receiver.analog_response import clipping, may_clip, set_noise
from lidar_emu.receiver.back_reflection import add_reflection, reflection_bin, reflection_power
from lidar_emu.receiver.beat_tones import (
    RANGE_M,
    SPEED_MPS,
    place_tones,
    record_time,
    record_time_s,
    speed_change_mps,
    weigh_tones,
)
from lidar_emu.receiver.bin_filter import filter_beam, reserve_line, set_filter
from lidar_emu.receiver.motion_smear import LEAST_TAPS
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.returns import Echoes
from lidar_emu.receiver.speckle import reserve_speckle, set_streak_weights, set_weights
from lidar_emu.receiver.spectrum import (
    NOISE,
    POWER,
    REACH,
    SEGMENT_INDICES,
    add_noise,
    fold,
    lay_bins,
    mirror_ends,
    reserve_noise,
    set_power,
    whole_vectors,
)
from lidar_emu.receiver.sweep_error import sweep_error
from lidar_emu.receiver.tone_bins import set_close_tones, set_tones, tones_are_close
from lidar_emu.receiver.volume_light import (
    add_band_places,
    band_snr,
    has_band,
    set_bands,
    set_haze_tone,
    set_level,
)
from lidar_emu.receiver.workspace import Workspace, tones_in_use


@kernel
def lay_spectra(model: ReceiverModel, work: Workspace, beam: Beam, echoes: Echoes, s: int, b: int) -> bool:
    """Place the tones of all records, lay the bins of all segments around them, and draw all random numbers of speckle,
    noise and laser line at once.

    Returns:
        Whether there is any light; if not, there are no bins.
    """
    if beam.lit_beamlets == 0 and not (
        model.haze.snr_per_m > 0.0 or model.back_reflection.snr > 0.0 or beam.dust_snr > 0.0
    ):
        return False
    set_filter(model, work, beam)
    at = 0
    if model.speckle and beam.lit_beamlets > 0:
        at = reserve_speckle(model, echoes, s, b, beam, work.speckle.waves, work.drawn)
    for segment in range(3):
        _lay_segment(model, work, beam, segment)
        for look in range(model.looks):
            record, first = segment + 3 * look, (segment + 3 * look) * SEGMENT_INDICES
            work.offsets[record, 0] = at
            at = reserve_noise(beam.beam, first, work.grid[segment], work.ends[segment], at, work.drawn)
            work.offsets[record, 1] = at
            at = reserve_line(model, work.beamlets[RANGE_M, 0], beam, segment, look, at, work.drawn)
    draw_reserved(beam.seed, beam.shot, at, work.drawn.counters, work.drawn.words)
    set_normals(at, work.drawn)
    return True


@kernel
def _lay_segment(model: ReceiverModel, work: Workspace, beam: Beam, segment: int) -> None:
    """Place the tones of a segment's records, and lay its bins around them."""
    places, reach = work.places[0], float(REACH + max(0, beam.filter_taps - LEAST_TAPS))
    set_bands(model, beam, segment, record_time_s(model, segment, 0))
    count = 0
    if has_band(beam):
        count = add_band_places(model, beam, 2.0 * reach + 1.0, places)
    for look in range(model.looks):
        count = _place_record(model, work, beam, segment, look, count)
    if model.back_reflection.snr > 0.0:
        place, _, _ = fold(np.rint(reflection_bin(model, segment)), model.fft_length)
        places[count] = np.float32(place)
        count += 1
    grid, ends = work.grid[segment], work.ends[segment]
    lay_bins(places[:count], reach, model.fft_length, work.places[1], grid, ends)


@kernel
def _place_record(
    model: ReceiverModel, work: Workspace, beam: Beam, segment: int, look: int, count: int
) -> int:
    """Place the tones of one record, and append their bins to `work.places`, which has `count`."""
    record, in_use, places = segment + 3 * look, tones_in_use(beam), work.places[0]
    tones, whole, rest = work.tones[record], work.tones[record, 0], work.tones[record, 1]
    if beam.lit_beamlets > 0:
        time_records = record_time(model, segment, look)
        time_s = time_records * model.record_time_s
        error_m, error_mps = sweep_error(model, beam, segment, look, work.beamlets[RANGE_M, 0])
        shift = (
            speed_change_mps(beam, time_s) + error_mps,
            error_m + 0.5 * beam.range_curvature_mps2 * time_s * time_s,
        )
        place_tones(model, beam, segment, time_records, shift, work.beamlets, work.beats[record], tones)
    else:
        # Without power, at the beat of the back-reflection, the only light.
        work.beamlets[RANGE_M] = model.back_reflection.range_m
        work.beamlets[SPEED_MPS] = 0.0
        place, _, _ = fold(np.rint(reflection_bin(model, segment)), model.fft_length)
        for i in range(in_use):
            whole[i], rest[i] = np.float32(place), np.float32(0.0)
    if model.haze.snr_per_m > 0.0 and segment == 1:
        set_haze_tone(model, beam, look, tones[:, in_use - 1])
    for i in range(in_use):
        places[count + i] = whole[i]
    return count + in_use


@kernel
def set_spectrum(model: ReceiverModel, work: Workspace, beam: Beam, segment: int) -> int:
    """Fill grid and bins of one segment of a beam with light, whose bins are laid.

    Returns:
        The number of bins.
    """
    grid, ends = work.grid[segment], work.ends[segment]
    count, wide = ends[ends[0]], whole_vectors(ends[ends[0]])
    for look in range(model.looks):
        _weigh_record(model, work, beam, segment, look)
    set_bands(model, beam, segment, record_time_s(model, segment, 0))
    others = band_snr(beam) if has_band(beam) else 0.0
    if model.back_reflection.snr > 0.0:
        others += reflection_power(model, segment)
    gain, distortion = 1.0, 0.0
    if may_clip(model.response, model.fft_length, model.snr_per_w * beam.power_w + others):
        tones = work.tones[segment]
        gain, distortion = clipping(model.response, tones, tones_in_use(beam), model.fft_length, others)
    beam.gain, beam.distortion = gain, distortion
    factor = 1.0 + model.signal_shot_per_w * beam.power_w
    set_noise(model.response, model.fft_length, gain * gain, factor, distortion, grid, wide)
    for look in range(model.looks):
        _set_record(model, work, beam, segment, look, gain, count)
    set_power(model.window, model.fft_length, model.lowest_bin, grid, ends, work.bins[segment])
    return int(count)


@kernel
def _weigh_record(model: ReceiverModel, work: Workspace, beam: Beam, segment: int, look: int) -> None:
    """Set the weights of one record's tones, with the speckle at its own time."""
    record, in_use = segment + 3 * look, tones_in_use(beam)
    tones, re, im = work.tones[record], work.tones[record, 2], work.tones[record, 3]
    time_s = record_time_s(model, segment, look)
    # The haze has the last column, which its beamlets leave alone.
    haze_re, haze_im = re[in_use - 1], im[in_use - 1]
    if beam.lit_beamlets > 0:
        if model.speckle:
            set_weights(model, beam, time_s, work.speckle, work.drawn)
            if beam.streak_drift_per_s >= 0.0:
                set_streak_weights(beam, time_s, model.ground_beamlets, work.speckle)
        weigh_tones(
            model, beam, segment, look, work.beamlets, work.beats[record], work.speckle.weights, tones
        )
    else:
        for i in range(in_use):
            re[i] = im[i] = np.float32(0.0)
    if model.haze.snr_per_m > 0.0 and segment == 1:
        re[in_use - 1], im[in_use - 1] = haze_re, haze_im


@kernel
def _set_record(
    model: ReceiverModel, work: Workspace, beam: Beam, segment: int, look: int, gain: float, count: int
) -> None:
    """Set the bins of one record."""
    length, record, columns = model.fft_length, segment + 3 * look, tones_in_use(beam)
    grid, ends, bins = work.grid[segment], work.ends[segment], work.bins[segment, look]
    tones = work.tones[record]
    if gain != 1.0:
        _scale(np.float32(gain), columns, work.tones[record, 2], work.tones[record, 3])
    if tones_are_close(length, grid, count, model.snr_per_w * beam.power_w):
        set_close_tones(tones, columns, length, grid, count, bins, work.residues)
    else:
        set_tones(tones, columns, length, grid, count, bins, work.wide)
    if beam.filter_taps > 0:
        mirror_ends(length, grid, count, bins)
        filter_beam(model, work, beam, segment, look, ends, bins)
    if model.back_reflection.snr > 0.0:
        add_reflection(model, beam, segment, look, gain, grid, count, bins)
    level = NOISE
    if has_band(beam):
        level = POWER
        set_bands(model, beam, segment, record_time_s(model, segment, look))
        set_level(model, beam, gain, grid, count)
    add_noise(length, grid, level, ends, bins, work.offsets[record, 0], work.drawn)
    mirror_ends(length, grid, count, bins)


@kernel
def _scale(factor: np.float32, columns: int, re: SingleArray, im: SingleArray) -> None:
    for i in range(columns):
        re[i], im[i] = factor * re[i], factor * im[i]
