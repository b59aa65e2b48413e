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

from lidar_emu.numerics.arrays import FloatArray, IntArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import LINE, Normals, reserve_numbers
from lidar_emu.numerics.vectors import FAST, bounded
from lidar_emu.receiver.beat_tones import RANGE_M, SPEED_MPS, signed_bin
from lidar_emu.receiver.laser_phase_noise import (
    WIDE_DRIFT,
    has_normal_taps,
    line_centre,
    line_matters,
    line_numbers,
    normal_taps,
    peak_wanders,
    phase_drift,
    set_line_amplitudes,
    walked_taps,
)
from lidar_emu.receiver.motion_smear import LEAST_TAPS, smear_bins, smear_taps
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.spectrum import whole_vectors
from lidar_emu.receiver.sweep_error import ripple_index, ripple_reach, ripple_taps
from lidar_emu.receiver.workspace import Workspace

_MOST_TAPS = 511

_INDICES = 2**13
"""Random number indices reserved for the line in each record, more than `line_numbers` are for the most taps."""

_SEPARATE_SMEAR_BINS = 0.5
"""Smear below which it leaves the line's numbers as they are. It would turn their phase noise by πβ/2 at the ends of
the record, and with it 2 % of the variance at most."""

_MOST_SMEAR_BINS = 128.0
"""Limit of the change of a beat: larger changes are spread over this many bins, and scaled to their true strength."""


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


@kernel
def set_filter(model: ReceiverModel, work: Workspace, beam: Beam) -> None:
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


@kernel
def reserve_line(
    model: ReceiverModel, range_m: float, beam: Beam, segment: int, look: int, at: int, into: Normals
) -> int:
    """Reserve the line's numbers in one record, where it matters, in columns `at`, even, and on.

    Returns:
        The column behind the last.
    """
    if beam.filter_taps == 0 or not line_matters(model, range_m, beam.left_out_bin2):
        return at
    first = (segment + 3 * look) * _INDICES
    numbers = line_numbers(model, range_m, beam.filter_taps)
    return reserve_numbers(beam.beam, LINE, first, numbers, at, into)


@kernel
def filter_beam(
    model: ReceiverModel,
    work: Workspace,
    beam: Beam,
    segment: int,
    look: int,
    ends: IntArray,
    bins: SingleArray,
) -> None:
    """Apply smear, linewidth and ripple, where they matter, to the bins (2, capacity) of one record.

    Args:
        ends: ends of the intervals, from `lay_bins`.
    """
    at = work.offsets[segment + 3 * look, 1]
    half = beam.filter_taps
    range_m, speed_mps = work.beamlets[RANGE_M, 0], work.beamlets[SPEED_MPS, 0]
    by_smear, by_line, both = work.taps[0], work.taps[1], work.taps[2]
    smear = smear_bins(model, segment, speed_mps, beam.closing_acceleration_mps2)
    smeared, lined = abs(smear) > model.least_smear_bins, line_matters(model, range_m, beam.left_out_bin2)
    delay = model.delay_per_m * range_m
    if lined and peak_wanders(model, range_m):
        walked_taps(model.linewidth_bins, delay, half, at, work.drawn, work.laser_line, by_line)
    elif lined:
        normal_taps(model.linewidth_bins, delay, half, at, work.drawn, work.laser_line, by_line)
    if smeared:
        computed = min(max(smear, -_MOST_SMEAR_BINS), _MOST_SMEAR_BINS)
        smear_taps(computed, half, by_smear)
        if computed != smear:
            scale = np.float32(sqrt(computed / smear))
            for m in range(2 * half + 1):
                by_smear[0, m], by_smear[1, m] = scale * by_smear[0, m], scale * by_smear[1, m]
    if smeared and lined:
        if (
            abs(smear) < _SEPARATE_SMEAR_BINS
            and model.least_smear_bins > 0.0
            and not peak_wanders(model, range_m)
        ):
            _superpose(line_centre(model, range_m), half, by_smear, by_line, both)
        else:
            convolve_taps(by_smear, by_line, half, both)
    taps = both if smeared and lined else (by_smear if smeared else by_line)
    index = ripple_index(model, range_m, beam.left_out_bin2) if segment != 1 else 0.0
    if index > 0.0:
        by_ripple = work.taps[3]
        ripple_taps(model, beam, segment, look, index, half, by_ripple)
        if smeared or lined:
            other = by_smear if smeared and lined else both
            convolve_taps(taps, by_ripple, half, other)
            taps = other
        else:
            taps = by_ripple
    if smeared or lined or index > 0.0:
        beat = signed_bin(model, segment, range_m, speed_mps)
        nearest = beat - model.fft_length * np.rint(beat / model.fft_length)
        filter_bins(taps, half, nearest < 0.0, ends, bins, work.filtered)


@kernel
def _superpose(
    centre: np.float32, half: int, by_smear: SingleArray, by_line: SingleArray, taps: SingleArray
) -> None:
    """Taps of smear and line where the smear is weak: its own, of what the line leaves in its centre, and the line's
    others, whose numbers are as random when they are smeared."""
    for part in range(2):
        for m in range(2 * half + 1):
            taps[part, m] = centre * by_smear[part, m] + by_line[part, m]
    taps[0, half] -= centre


@kernel
def convolve_taps(first: SingleArray, second: SingleArray, half: int, result: SingleArray) -> None:
    """Taps of a product of two factors, truncated at `half` on each side; arrays (2, 2 half + 1 or more)."""
    width = 2 * half + 1
    result[:, :width] = 0.0
    for a in range(width):
        start, stop = max(0, half - a), min(width, width + half - a)
        to = a + start - half
        _add_product(
            first[0, a],
            first[1, a],
            second[0, start:stop],
            second[1, start:stop],
            result[0, to:],
            result[1, to:],
        )


@kernel(fastmath=FAST)
def _add_product(
    re: np.float32,
    im: np.float32,
    from_re: SingleArray,
    from_im: SingleArray,
    to_re: SingleArray,
    to_im: SingleArray,
) -> None:
    for b in range(len(from_re)):
        to_re[b] += re * from_re[b] - im * from_im[b]
        to_im[b] += re * from_im[b] + im * from_re[b]


@kernel
def filter_bins(
    taps: SingleArray, half: int, mirrored: bool, ends: IntArray, bins: SingleArray, scratch: SingleArray
) -> None:
    """Apply a common factor's taps to bins; `mirrored` for tones folded at 0 or N/2.

    Bins outside the computed intervals count as empty, and the images of tones within `half` bins of 0 and N/2 are
    filtered like the tones themselves.

    Args:
        ends: ends of the intervals, from `lay_bins`.
        scratch: (6, capacity + 2 half or more) overwritten.
    """
    tap_re, tap_im = scratch[4], scratch[5]
    _set_taps(taps[0], taps[1], half, mirrored, tap_re, tap_im)
    from_re, from_im, to_re, to_im = scratch[0], scratch[1], scratch[2], scratch[3]
    start = 0
    for interval in range(ends[0]):
        stop = ends[interval + 1]
        bins_re, bins_im = bins[0, start:stop], bins[1, start:stop]
        # Zeros on both sides and whole vectors: each tap is then one loop without special cases at the ends.
        width = whole_vectors(stop - start)
        _copy_between_zeros(bins_re, half, width + 2 * half, from_re)
        _copy_between_zeros(bins_im, half, width + 2 * half, from_im)
        _set_zero(width, to_re, to_im)
        for m in range(2 * half + 1):
            at = 2 * half - m
            _add_product(tap_re[m], tap_im[m], from_re[at : at + width], from_im[at:], to_re, to_im)
        _copy(to_re, to_im, bins_re, bins_im)
        start = stop


@kernel
def _set_taps(
    re: SingleArray, im: SingleArray, half: int, mirrored: bool, to_re: SingleArray, to_im: SingleArray
) -> None:
    """Taps as they apply to bins.

    A folded tone has the complex conjugate factor, whose taps are conjugate and in reverse order. Bins referred to the
    centre, as in `spectrum`, alternate in sign, and so do the taps.
    """
    width = 2 * half + 1
    sign = np.float32(-1.0 if half % 2 else 1.0)
    for m in range(width):
        i = width - 1 - m if mirrored else m
        to_re[m], to_im[m] = sign * re[i], (-sign if mirrored else sign) * im[i]
        sign = -sign


@kernel
def _copy_between_zeros(values: SingleArray, before: int, width: int, to: SingleArray) -> None:
    for j in range(before):
        to[j] = 0.0
    for j in range(len(values)):
        to[before + j] = values[j]
    for j in range(before + len(values), width):
        to[j] = 0.0


@kernel
def _set_zero(width: int, re: SingleArray, im: SingleArray) -> None:
    for j in range(width):
        re[j] = im[j] = 0.0


@kernel
def _copy(from_re: SingleArray, from_im: SingleArray, to_re: SingleArray, to_im: SingleArray) -> None:
    for j in range(len(to_re)):
        to_re[j], to_im[j] = from_re[j], from_im[j]
