"""Speckle: each beamlet's echo is a circular Gaussian number that changes as the footprint moves over the ground.

Within a measurement the footprint glides along a straight path, on which the number is a random process: independent
Gaussian numbers at equal distances, the corners, interpolated with the weights cos²(πx/3) √(8/9) of the three nearest
at distances x. The squares of the weights sum to 1 at any place, and the squares of their slopes to 4π²/27. Averaged
over a pitch, the correlation over a distance x in pitches is

    2/9 [(3 - |x|) (1 + ½ cos(2πx/3)) + 9/(4π) sin(2π|x|/3)] for |x| < 3,

which has the curvature of the Gaussian exp(-D²/w²) at x = 0 with the pitch π √(2/27) w, and is within 0.03 of it.

From shot to shot the process is another one. Where a beam hardly moves between shots and fades last, it is taken from a
field instead, which any shot can compute alone (`speckle_field`).

The footprint moves during a record, too. The sum of Q tones, spaced evenly about the beamlet's own frequency, takes the
values of the process at the Q Gauss-Legendre nodes of the record:

    a(t) = Σ c_q exp(j2π s (q - (Q - 1)/2) t/T),    c = E⁻¹ a,    E_pq = exp(j2π s (q - (Q - 1)/2) t_p/T).

It follows the process between the nodes to 3 to 7 % of its change within the record (`_CHANGES`), and all that is made
for steady tones applies: bins, images, folds, the receiver's poles. With many tones E is ill-conditioned between the
nodes: there are more nodes than tones, and E⁻¹ is the inverse by least squares.
"""

from __future__ import annotations

from math import floor, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import (
    PATH,
    SPECKLE,
    STREAK,
    Normals,
    complex_normal,
    reserve_numbers,
    uniform_pair,
)
from lidar_emu.numerics.vectors import FAST, sin_pi
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.returns import TRAVEL, Echoes
from lidar_emu.receiver.speckle_field import (
    PITCH_W,
    FieldWaves,
    as_waves,
    field_waves,
    is_in_field,
    set_field,
    set_waves,
)

_SHARE = sqrt(8.0 / 9.0)

_CORNER_NUMBERS = 2**16
"""Random number indices reserved for the beamlets at each corner."""

_LOW_WORD = np.int64(0x7FFFFFFF)
"""Mask of a coordinate, whose index is not negative."""

_CHANGES = (
    (1, 0.0, 0.0),
    (3, 0.2, 0.5),
    (5, 0.4, 1.5),
    (9, 0.6, 3.5),
    (13, 0.65, 5.5),
    (17, 0.65, 8.0),
    (25, 0.6, 12.0),
    (33, 0.6, 20.0),
    (47, 0.8, 32.0),
    (75, 0.8, 48.0),
    (111, 0.8, 72.0),
)
"""Tones, their spacing s in bins, and the way of the footprint in pitches per record up to which they suffice."""

_TONES = np.array([tones for tones, _, _ in _CHANGES])
_NODES = np.where(_TONES <= 17, _TONES, _TONES * 4 // 3)
"""Times within a record at which the field is evaluated."""
_SPACING_BIN = np.array([spacing for _, spacing, _ in _CHANGES])
_FARTHEST = np.array([way for _, _, way in _CHANGES])

MOST_TRAVEL_PITCHES = float(_FARTHEST[-1])
"""Way in pitches per record beyond which lines are narrower than in truth."""

_LEAST_SINGULAR = 1e-2
"""Singular values of E that are left out, relative to the largest, where there are more nodes than tones."""

LINE_BIN2 = PITCH_W**2 / (2.0 * np.pi**2)
"""Variance of the line's frequencies in bins² for a way of one pitch per record: (V⊥ T/(π √2 w))²."""

_LEAST_TRAVEL = 1e-6
"""Way in pitches per record in which the field changes by rounding."""


class SpeckleWork(NamedTuple):
    """The process of one beam, and the weights of its tones in one record."""

    weights: SingleArray
    """(tones, 2, columns) Real and imaginary parts of the weight of each beamlet's tones; the process has unit mean
    power."""
    values: SingleArray
    """(nodes, 2, columns) The process at the nodes of a record."""
    node: FloatArray
    """(levels, nodes) Times in records from the record's centre, for each number of tones in `_CHANGES`."""
    tone_from_node: SingleArray
    """(levels, 2, tones, nodes) E⁻¹, real and imaginary parts."""
    waves: FieldWaves


def corner_numbers(columns: int, level: int, records: float) -> int:
    """Largest number of random numbers at the corners, up to `level`, for a measurement as long as so many records."""
    return (int(records * _FARTHEST[level]) + 4) * columns


def speckle_work(columns: int, level: int) -> SpeckleWork:
    """Allocate and compute what beams of up to `columns` columns need, up to `level`."""
    most, tones = int(_NODES[level]), int(_TONES[level])
    node = np.zeros((level + 1, most))
    tone_from_node = np.zeros((level + 1, 2, tones, most), dtype=np.float32)
    for i, (count, spacing, _) in enumerate(_CHANGES[: level + 1]):
        nodes = int(_NODES[i])
        place, weight = np.polynomial.legendre.leggauss(nodes)
        node[i, :nodes] = place / 2.0
        turns = spacing * np.outer(node[i, :nodes], np.arange(count) - (count - 1) / 2.0)
        matrix = np.exp(2j * np.pi * turns)
        if nodes == count:
            inverse = np.linalg.inv(matrix)
        else:
            root = np.sqrt(weight)
            inverse = np.linalg.pinv(root[:, None] * matrix, rcond=_LEAST_SINGULAR) * root
        tone_from_node[i, 0, :count, :nodes] = inverse.real
        tone_from_node[i, 1, :count, :nodes] = inverse.imag
    return SpeckleWork(
        weights=np.empty((tones, 2, columns), dtype=np.float32),
        values=np.empty((most, 2, columns), dtype=np.float32),
        node=node,
        tone_from_node=tone_from_node,
        waves=field_waves(columns),
    )


@kernel
def as_speckle_work(arrays: tuple[Any, ...]) -> SpeckleWork:
    """Named tuple from plain ones."""
    weights, values, node, tone_from_node, waves = arrays
    return SpeckleWork(weights, values, node, tone_from_node, as_waves(waves))


@kernel
def level_for_travel(pitches: float) -> int:
    """First level of `_CHANGES` whose tones suffice for this travel in pitches per record; the last for longer ones."""
    level = 0
    while level < len(_FARTHEST) - 1 and pitches > _FARTHEST[level]:
        level += 1
    return level


@kernel
def needed_level(model: ReceiverModel, pitches_per_s: float, left_out_bin2: float) -> int:
    """Level of a beam with this motion; 0, a constant field, where the line's scatter is at most `left_out_bin2`.

    At the mean power the peak of a line of variance s² wanders by s²/2.
    """
    pitches = pitches_per_s * model.record_time_s
    if pitches < _LEAST_TRAVEL or 0.5 * LINE_BIN2 * pitches * pitches <= left_out_bin2:
        return 0
    return level_for_travel(pitches)


@kernel
def tone_count(level: int) -> int:
    """Tones of each beamlet."""
    return int(_TONES[level])


@kernel
def tone_offset_bin(level: int, tone: int) -> float:
    """Frequency of a tone from the beamlet's own, in bins."""
    return float(_SPACING_BIN[level] * (tone - 0.5 * (_TONES[level] - 1)))


@kernel
def travel_per_s(model: ReceiverModel, motion: FloatArray) -> float:
    """Travel of the footprint with this row of `Echoes.speckle_motion`, in pitches; 0 without speckle."""
    if not (model.speckle and motion[TRAVEL] > 0.0):
        return 0.0
    return float(min(motion[TRAVEL], MOST_TRAVEL_PITCHES / model.record_time_s))


@kernel(outermost=True)
def highest_level(models: NDArray[Any], motion: FloatArray) -> int:
    """Highest level that any of the beams (shots, beams) may need, whatever its power."""
    farthest = 0.0
    for s in range(motion.shape[0]):
        for b in range(motion.shape[1]):
            farthest = max(farthest, travel_per_s(models[0], motion[s, b]))
    return level_for_travel(farthest * models[0].record_time_s)


@kernel
def reserve_speckle(
    model: ReceiverModel, echoes: Echoes, s: int, b: int, beam: Beam, waves: FieldWaves, into: Normals
) -> int:
    """Reserve the first columns for the corners of a beam's path, or set the waves of the field.

    Returns:
        The column behind the last.
    """
    if is_in_field(echoes.speckle_place[s, b], echoes.speckle_motion[s, b]):
        set_waves(model, beam, echoes.speckle_place[s, b], echoes.speckle_motion[s, b], waves)
        beam.speckle_phase = -1.0
        return 0
    before = beam.travel_per_s * (model.furthest_record_s + 0.5 * model.record_time_s)
    start, _ = uniform_pair(beam.seed, beam.shot, beam.beam, PATH, 0)
    # The first corner is the neighbour of the one that is nearest to the path's start.
    beam.speckle_phase = 0.5 + start + before
    corners = int(1.0 + start + 2.0 * before) + 2
    at = 0
    for corner in range(corners):
        at = reserve_numbers(beam.beam, SPECKLE, corner * _CORNER_NUMBERS, beam.columns, at, into)
    return at


@kernel
def set_weights(model: ReceiverModel, beam: Beam, time_s: float, work: SpeckleWork, drawn: Normals) -> None:
    """Set the weights of the tones of the record whose centre is `time_s` after the time of validity.

    Args:
        drawn: the numbers that `reserve_speckle` reserved: one corner after another, each `beam.columns` long.
    """
    level = beam.speckle_level
    if level == 0:
        _set_value(beam, time_s, work.waves, drawn, work.weights[0])
        return
    count, nodes = tone_count(level), int(_NODES[level])
    for p in range(nodes):
        _set_value(
            beam, time_s + model.record_time_s * work.node[level, p], work.waves, drawn, work.values[p]
        )
    for q in range(count):
        to_re, to_im = work.weights[q, 0, : beam.columns], work.weights[q, 1, : beam.columns]
        to_re[:] = 0.0
        to_im[:] = 0.0
        for p in range(nodes):
            re, im = work.tone_from_node[level, 0, q, p], work.tone_from_node[level, 1, q, p]
            _add_product(re, im, work.values[p, 0], work.values[p, 1], to_re, to_im)


@kernel(fastmath=FAST)
def _add_product(
    re: np.float32,
    im: np.float32,
    at_re: SingleArray,
    at_im: SingleArray,
    to_re: SingleArray,
    to_im: SingleArray,
) -> None:
    for i in range(len(to_re)):
        to_re[i] += re * at_re[i] - im * at_im[i]
        to_im[i] += re * at_im[i] + im * at_re[i]


@kernel
def _set_value(beam: Beam, time_s: float, waves: FieldWaves, drawn: Normals, value: SingleArray) -> None:
    """Set the process at a time, (2, columns)."""
    columns = beam.columns
    if beam.speckle_phase < 0.0:
        set_field(beam, time_s, waves, value)
        return
    place = beam.speckle_phase + beam.travel_per_s * time_s
    nearest = floor(place + 0.5)
    x = place - nearest
    first = (int(nearest) - 1) * columns
    shares = np.float32(_share(x + 1.0)), np.float32(_share(x)), np.float32(_share(x - 1.0))
    _interpolate(shares, columns, drawn.re[first:], value[0])
    _interpolate(shares, columns, drawn.im[first:], value[1])


@kernel(fastmath=FAST)
def _interpolate(
    shares: tuple[np.float32, np.float32, np.float32], columns: int, corners: SingleArray, value: SingleArray
) -> None:
    a, b, c = shares
    before, here, after = corners, corners[columns:], corners[2 * columns :]
    for i in range(columns):
        value[i] = a * before[i] + b * here[i] + c * after[i]


@kernel
def _share(distance: float) -> float:
    """Weight of a corner at the distance x <= 3/2, cos²(πx/3) √(8/9)."""
    cosine = sin_pi(0.5 - abs(distance) / 3.0)
    return _SHARE * cosine * cosine


@kernel
def streak_weight(seed: np.uint64, shot: int, beam: int, place: float) -> tuple[float, float]:
    """Field of a streak of dust that a beam meets in a shot, at a position in pitches along the way of the streak."""
    nearest = floor(place + 0.5)
    re = im = 0.0
    for step in range(-1, 2):
        share = _share(place - nearest - step)
        x, y = complex_normal(seed, shot, beam, STREAK, int((int(nearest) + step) & _LOW_WORD))
        re, im = re + share * x, im + share * y
    return re, im


@kernel
def streak_drift(model: ReceiverModel, echoes: Echoes, s: int, b: int) -> float:
    """Motion of the streak that a beam meets, in pitches per second; -1 without one."""
    drifts_per_s = echoes.streak_drift_per_s
    if drifts_per_s.size == 0 or echoes.range_m.shape[2] <= model.ground_beamlets:
        return -1.0
    drift_per_s: float = drifts_per_s[s, b]
    return drift_per_s if drift_per_s >= 0.0 else -1.0


@kernel
def set_streak_weights(beam: Beam, time_s: float, column: int, work: SpeckleWork) -> None:
    """Set the weights of a streak's tones of the record at a time.

    A streak moves by a fraction of a pitch within a record: its field is constant there.
    """
    if column >= beam.columns:
        return
    count, weights = tone_count(beam.speckle_level), work.weights
    weights[:count, :, column] = 0.0
    re, im = streak_weight(beam.seed, beam.shot, beam.beam, beam.streak_drift_per_s * time_s)
    weights[count // 2, 0, column], weights[count // 2, 1, column] = np.float32(re), np.float32(im)
