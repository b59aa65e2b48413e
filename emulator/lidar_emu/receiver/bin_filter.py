"""Filter over the bins of one beam's record: smear by motion, the laser's linewidth and the ripple of the chirps,
where they matter.

A factor m(t) common to all tones is a filter over rectangular bins, whose taps are the Fourier coefficients of m
over the record.
"""

from __future__ import annotations

from math import ceil, floor, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.vectors import FAST, bounded
from lidar_emu.receiver.beat_tones import RANGE_M, SPEED_MPS, signed_bin
from lidar_emu.receiver.laser_phase_noise import (
    WIDE_DRIFT,
    has_normal_taps,
    line_matters,
    normal_taps,
    peak_wanders,
    phase_drift,
    set_line_amplitudes,
    walked_taps,
)
from lidar_emu.receiver.motion_smear import LEAST_TAPS, smear_bins, smear_taps
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.spectrum import BIN
from lidar_emu.receiver.sweep_error import ripple_index, ripple_reach, ripple_taps
from lidar_emu.receiver.workspace import SpectrumWorkspace, Workspace

_MOST_TAPS = 511

_INDICES = 2048
"""Random number indices reserved for the line in each record, as many as `walked_taps` needs for the most taps."""

_MOST_SMEAR_BINS = 128.0
"""Limit of the change of a beat: larger changes are spread over this many bins, and scaled to their true strength."""

_LANES = 4
"""Numbers in a vector register."""


@kernel
def widest_filter(
    model: ReceiverModel, range_m: float, speed_mps: float, acceleration_mps2: float, left_out_bin2: float
) -> int:
    """Taps on each side that the segments of a beam need; 0 if none does.

    Args:
        left_out_bin2: variance of a beat below which a line or a ripple is left out.
    """
    smear = 0.0
    for segment in range(3):
        smear = max(smear, abs(smear_bins(model, segment, speed_mps, acceleration_mps2)))
    needed = 0.0
    if smear > model.least_smear_bins:
        needed = LEAST_TAPS + floor(0.5 * min(smear, _MOST_SMEAR_BINS))
    if line_matters(model, range_m, left_out_bin2):
        # Wide lines lose their central tap; the rest is as wide as the line itself.
        narrow = phase_drift(model, range_m) < WIDE_DRIFT
        needed = max(needed, LEAST_TAPS + (0.0 if narrow else ceil(2.0 * model.linewidth_bins)))
    if ripple_index(model, range_m, left_out_bin2) > 0.0:
        needed = max(needed, LEAST_TAPS + ripple_reach(model))
    return int(min(needed, float(_MOST_TAPS)))


@kernel(outermost=True)
def most_taps(
    models: NDArray[Any], range_m: FloatArray, closing_speed_mps: FloatArray, smear_mps2: FloatArray
) -> int:
    """Taps on each side that are enough for all beams (shots, beams, beamlets), whatever their power.

    A filter widens with speed, acceleration and range, except by the ripple, whose effect is periodic in range.
    """
    farthest_m, fastest_mps, steepest_mps2 = 0.0, 0.0, 0.0
    shots, beams, beamlets = range_m.shape
    for s in range(shots):
        for b in range(beams):
            steepest_mps2 = max(steepest_mps2, abs(bounded(smear_mps2[s, b])))
            for i in range(beamlets):
                farthest_m = max(farthest_m, bounded(range_m[s, b, i]))
                fastest_mps = max(fastest_mps, abs(bounded(closing_speed_mps[s, b, i])))
    model = models[0]
    most = widest_filter(model, farthest_m, fastest_mps, steepest_mps2, 0.0)
    if model.ripple.largest_index > 0.0:
        most = max(most, int(min(LEAST_TAPS + ripple_reach(model), float(_MOST_TAPS))))
    return most


@kernel(inline="always")
def set_filter(model: ReceiverModel, work: Workspace, beam: Any) -> None:
    """Set the taps of the widest filter that the beam needs, and the powers of the line's taps in all its records."""
    beam.filter_taps = 0
    if beam.lit_beamlets == 0:
        return
    range_m, speed_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
    beam.filter_taps = widest_filter(
        model, range_m, speed_mps, beam.closing_acceleration_mps2, beam.left_out_bin2
    )
    if beam.filter_taps > 0 and has_normal_taps(model, range_m, beam.left_out_bin2):
        delay = model.delay_per_m * range_m
        set_line_amplitudes(model.linewidth_bins, delay, beam.filter_taps, work.laser_line.amplitudes)


@kernel(inline="always")
def filter_beam(
    model: ReceiverModel,
    work: Workspace,
    spectra: SpectrumWorkspace,
    beam: Any,
    segment: int,
    look: int,
    count: int,
) -> None:
    """Apply smear, linewidth and ripple, where they matter, to the first `count` bins of one record."""
    half = beam.filter_taps
    range_m, speed_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
    by_smear, by_line, both = spectra.taps[0], spectra.taps[1], spectra.taps[2]
    smear = smear_bins(model, segment, speed_mps, beam.closing_acceleration_mps2)
    smeared, lined = abs(smear) > model.least_smear_bins, line_matters(model, range_m, beam.left_out_bin2)
    index = (segment + 3 * look) * _INDICES
    delay = model.delay_per_m * range_m
    if lined and peak_wanders(model, range_m):
        walked_taps(model.linewidth_bins, delay, beam, index, half, work.laser_line, by_line)
    elif lined:
        normal_taps(model.linewidth_bins, delay, beam, index, half, work.laser_line, by_line)
    if smeared:
        computed = min(max(smear, -_MOST_SMEAR_BINS), _MOST_SMEAR_BINS)
        smear_taps(computed, half, by_smear)
        if computed != smear:
            for part in range(2):
                for m in range(2 * half + 1):
                    by_smear[part, m] *= sqrt(computed / smear)
    if smeared and lined:
        convolve_taps(by_smear, by_line, half, both)
    taps = both if smeared and lined else (by_smear if smeared else by_line)
    index_of_ripple = ripple_index(model, range_m, beam.left_out_bin2) if segment != 1 else 0.0
    if index_of_ripple > 0.0:
        by_ripple = spectra.taps[3]
        ripple_taps(model, beam, segment, look, index_of_ripple, half, by_ripple)
        if smeared or lined:
            other = by_smear if smeared and lined else both
            convolve_taps(taps, by_ripple, half, other)
            taps = other
        else:
            taps = by_ripple
    if smeared or lined or index_of_ripple > 0.0:
        beat = signed_bin(model, segment, range_m, speed_mps)
        nearest = beat - model.fft_length * np.rint(beat / model.fft_length)
        filter_bins(taps, half, nearest < 0.0, spectra.grid, count, spectra.bins[look], spectra.filtered)


@kernel(fastmath=FAST)
def convolve_taps(first: FloatArray, second: FloatArray, half: int, result: FloatArray) -> None:
    """Taps of a product of two factors, truncated at `half` on each side; arrays (2, 2 half + 1 or more)."""
    width = 2 * half + 1
    result[:, :width] = 0.0
    for a in range(width):
        re, im = first[0, a], first[1, a]
        start, stop = max(0, half - a), min(width, width + half - a)
        from_re, from_im = second[0, start:stop], second[1, start:stop]
        to_re, to_im = result[0, a + start - half :], result[1, a + start - half :]
        for b in range(len(from_re)):
            to_re[b] += re * from_re[b] - im * from_im[b]
            to_im[b] += re * from_im[b] + im * from_re[b]


@kernel(fastmath=FAST)
def filter_bins(
    taps: FloatArray,
    half: int,
    mirrored: bool,
    grid: FloatArray,
    count: int,
    bins: FloatArray,
    scratch: FloatArray,
) -> None:
    """Apply a common factor's taps to the first `count` bins; `mirrored` for tones folded at 0 or N/2.

    Bins outside the computed intervals count as empty, and the images of tones within `half` bins of 0 and N/2 are
    filtered like the tones themselves.

    Args:
        scratch: (4, capacity + 2 half + 4) overwritten.
    """
    sign = -1.0 if mirrored else 1.0
    from_re, from_im, to_re, to_im = scratch[0], scratch[1], scratch[2], scratch[3]
    start = 0
    while start < count:
        stop = start + 1
        while stop < count and grid[BIN, stop] - grid[BIN, stop - 1] == 1.0:
            stop += 1
        # Zeros on both sides and whole vectors: each tap is then one loop without special cases at the ends.
        width = -(-(stop - start) // _LANES) * _LANES
        scratch[:, : width + 2 * half] = 0.0
        for j in range(stop - start):
            from_re[half + j], from_im[half + j] = bins[0, start + j], bins[1, start + j]
        for m in range(-half, half + 1):
            # A folded tone has the complex conjugate factor, whose taps are conjugate and in reverse order. Bins
            # referred to the centre, as in `spectrum`, alternate in sign, and so do the taps.
            turn = -1.0 if m % 2 else 1.0
            re = turn * (taps[0, half - m] if mirrored else taps[0, half + m])
            im = turn * sign * (taps[1, half - m] if mirrored else taps[1, half + m])
            at_re, at_im = from_re[half - m :], from_im[half - m :]
            for j in range(width):
                to_re[j] += re * at_re[j] - im * at_im[j]
                to_im[j] += re * at_im[j] + im * at_re[j]
        for j in range(stop - start):
            bins[0, start + j], bins[1, start + j] = to_re[j], to_im[j]
        start = stop
