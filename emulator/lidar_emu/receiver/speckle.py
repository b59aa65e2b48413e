"""Speckle: each beamlet's echo is a circular Gaussian number that changes as the footprint moves over the ground.

The numbers are a random field over the position of the footprint, so that any shot can be computed alone: independent
Gaussian numbers at the corners of a lattice, interpolated along each axis with the weights cos²(πx/3) √(8/9) of the
three nearest corners at distances x. The squares of the weights sum to 1 at any place, and the squares of their
slopes to 4π²/27. Averaged over the cell, the correlation over a distance x in pitches is

    2/9 [(3 - |x|) (1 + ½ cos(2πx/3)) + 9/(4π) sin(2π|x|/3)] for |x| < 3,

which has the curvature of the Gaussian exp(-D²/w²) at x = 0 with the pitch π √(2/27) w, and is within 0.03 of it.

The field of a beamlet is known at any position of the footprint, and the footprint glides over the ground during a
record. The sum of Q tones, spaced evenly about the beamlet's own frequency, takes the values of the field at the Q
Gauss-Legendre nodes of the record:

    a(t) = Σ c_q exp(j2π s (q - (Q - 1)/2) t/T),    c = E⁻¹ a,    E_pq = exp(j2π s (q - (Q - 1)/2) t_p/T).

It follows the field between the nodes to 3 to 7 % of its change within the record (`_CHANGES`), and all that is made
for steady tones applies: bins, images, folds, the receiver's poles. With many tones E is ill-conditioned between the
nodes: there are more nodes than tones, and E⁻¹ is the inverse by least squares.
"""

from __future__ import annotations

from math import floor, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import SPECKLE, STREAK, complex_normal, fill_normals_of_shots
from lidar_emu.numerics.vectors import sin_pi
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Echoes

PITCH_W = pi * sqrt(2.0 / 27.0)
"""Pitch of the lattice as a multiple of the radius w of the correlation exp(-D²/w²)."""

SLOTS = 9
"""Corners cached, by their coordinates modulo 3: the corners of one position."""

_SHARE = sqrt(8.0 / 9.0)

_LOW_WORD = np.int64(0x7FFFFFFF)
"""Mask of a coordinate: two of them fit into a word beside the sign bit."""


class SpeckleField(NamedTuple):
    """The field of one beam in one record, and the surrounding corners of the lattice."""

    weights: FloatArray
    """(tones, 2, beamlets) Real and imaginary parts of the weight of each beamlet's tones; the field has unit mean
    power."""
    held: NDArray[np.int64]
    """(SLOTS, 2) Coordinates of the corners in `corners`."""
    places: NDArray[np.int64]
    """(SLOTS,) Coordinates of corners to be drawn, overwritten."""
    corners: FloatArray
    """(2, SLOTS, beamlets) Real and imaginary parts of the numbers at these corners."""
    numbers: FloatArray
    """(2, SLOTS * beamlets) The same numbers, one slot after another."""
    words: NDArray[np.uint64]
    """(4, SLOTS * beamlets / 2) Random words, overwritten."""


def speckle_field(beamlets: int, tones: int = 1) -> SpeckleField:
    """Allocate the field of beams with up to `beamlets` beamlets, an even number, of up to `tones` tones each;
    `forget_corners` clears it."""
    numbers = np.empty((2, SLOTS * beamlets))
    return SpeckleField(
        weights=np.empty((tones, 2, beamlets)),
        held=np.empty((SLOTS, 2), dtype=np.int64),
        places=np.empty(SLOTS, dtype=np.int64),
        corners=numbers.reshape(2, SLOTS, beamlets),
        numbers=numbers,
        words=np.empty((4, SLOTS * beamlets // 2), dtype=np.uint64),
    )


@kernel
def set_weights(
    seed: np.uint64, beam: int, east: float, north: float, field: SpeckleField, weights: FloatArray
) -> None:
    """Set `weights`, (2, beamlets), to the field at a position in pitches."""
    nearest_east, nearest_north = floor(east + 0.5), floor(north + 0.5)
    x, y = int(nearest_east), int(nearest_north)
    _draw_corners(seed, beam, x, y, field)
    weights[:] = 0.0
    east -= nearest_east
    north -= nearest_north
    south_share, share, north_share = _share(north + 1.0), _share(north), _share(north - 1.0)
    for step in range(-1, 2):
        share_east = _share(east - step)
        slot = 3 * ((x + step) % 3)
        for part in range(2):
            below, here, above = (
                field.corners[part, slot + (y - 1) % 3],
                field.corners[part, slot + y % 3],
                field.corners[part, slot + (y + 1) % 3],
            )
            weight = weights[part]
            a, b, c = share_east * south_share, share_east * share, share_east * north_share
            for i in range(len(weight)):
                weight[i] = weight[i] + a * below[i] + b * here[i] + c * above[i]


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
def forget_corners(field: SpeckleField) -> None:
    """Clear the cached corners, before each beam."""
    field.held[:] = np.iinfo(np.int64).max


@kernel
def _share(distance: float) -> float:
    """Weight of a corner at the distance x <= 3/2, cos²(πx/3) √(8/9)."""
    cosine = sin_pi(0.5 - abs(distance) / 3.0)
    return _SHARE * cosine * cosine


@kernel
def _draw_corners(seed: np.uint64, beam: int, east: int, north: int, field: SpeckleField) -> None:
    held, numbers, columns = field.held, field.numbers, field.corners.shape[2]
    drawn = 0
    for slot in range(SLOTS + 1):
        if slot < SLOTS:
            x, y = east - 1 + (slot // 3 + 1 - east) % 3, north - 1 + (slot % 3 + 1 - north) % 3
            if held[slot, 0] != x or held[slot, 1] != y:
                held[slot, 0], held[slot, 1] = x, y
                field.places[drawn] = ((x & _LOW_WORD) << 32) | (y & _LOW_WORD)
                drawn += 1
                continue
        if drawn > 0:
            first, last = (slot - drawn) * columns, slot * columns
            re, im = numbers[0, first:last], numbers[1, first:last]
            fill_normals_of_shots(seed, field.places[:drawn], beam, SPECKLE, columns, field.words, re, im)
            drawn = 0


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
_NODES = np.where(_TONES <= 33, _TONES, _TONES * 4 // 3)
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


class SpeckleChange(NamedTuple):
    """Nodes and matrices for each number of tones in `_CHANGES`, up to the largest that is needed."""

    node: FloatArray
    """(levels, nodes) Times in records from the record's centre."""
    tone_from_node: FloatArray
    """(levels, 2, tones, nodes) E⁻¹, real and imaginary parts."""
    values: FloatArray
    """(nodes, 2, beamlets) The field at the nodes, overwritten."""


def speckle_change(beamlets: int, level: int) -> SpeckleChange:
    """Allocate and compute what beams of up to `beamlets` beamlets need, up to `level`."""
    most = int(_NODES[level])
    node, tone_from_node = np.zeros((level + 1, most)), np.zeros((level + 1, 2, int(_TONES[level]), most))
    for i, (tones, spacing, _) in enumerate(_CHANGES[: level + 1]):
        nodes = int(_NODES[i])
        place, weight = np.polynomial.legendre.leggauss(nodes)
        node[i, :nodes] = place / 2.0
        turns = spacing * np.outer(node[i, :nodes], np.arange(tones) - (tones - 1) / 2.0)
        matrix = np.exp(2j * np.pi * turns)
        if nodes == tones:
            inverse = np.linalg.inv(matrix)
        else:
            root = np.sqrt(weight)
            inverse = np.linalg.pinv(root[:, None] * matrix, rcond=_LEAST_SINGULAR) * root
        tone_from_node[i, 0, :tones, :nodes] = inverse.real
        tone_from_node[i, 1, :tones, :nodes] = inverse.imag
    return SpeckleChange(node, tone_from_node, np.empty((most, 2, beamlets)))


@kernel
def level_for_travel(pitches: float) -> int:
    """First level of `_CHANGES` whose tones suffice for this travel in pitches per record; the last for longer ones."""
    level = 0
    while level < len(_FARTHEST) - 1 and pitches > _FARTHEST[level]:
        level += 1
    return level


@kernel
def travel_pitches(model: ReceiverModel, drift_per_s: FloatArray) -> float:
    """Pitches of the field that the footprint of a beam of this drift (2,) travels in a record."""
    if not model.speckle:
        return 0.0
    return float(sqrt(drift_per_s[0] ** 2 + drift_per_s[1] ** 2) * model.record_time_s)


@kernel
def needed_level(model: ReceiverModel, drift_per_s: FloatArray, left_out_bin2: float) -> int:
    """Level of a beam with this drift; 0, a constant field, where the line's scatter is at most `left_out_bin2`.

    At the mean power the peak of a line of variance s² wanders by s²/2.
    """
    pitches = travel_pitches(model, drift_per_s)
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


@kernel(outermost=True)
def highest_level(models: NDArray[Any], drift_per_s: FloatArray) -> int:
    """Highest level that any of the beams with these drifts (shots, beams, 2) may need, whatever its power."""
    farthest = 0.0
    for s in range(drift_per_s.shape[0]):
        for b in range(drift_per_s.shape[1]):
            farthest = max(farthest, travel_pitches(models[0], drift_per_s[s, b]))
    return level_for_travel(farthest)


@kernel
def set_tone_weights(
    seed: np.uint64,
    beam: int,
    place: FloatArray,
    drift_per_s: FloatArray,
    time_s: float,
    record_s: float,
    level: int,
    field: SpeckleField,
    change: SpeckleChange,
) -> None:
    """Set the weights of the tones of one record in `field`.

    Args:
        place: (2,) position at the time of validity, in pitches.
        drift_per_s: (2,) its motion.
        time_s: time from there to the record's centre.
        record_s: length of the record.
        level: of `_CHANGES`.
    """
    if level == 0:
        east, north = place[0] + drift_per_s[0] * time_s, place[1] + drift_per_s[1] * time_s
        set_weights(seed, beam, east, north, field, field.weights[0])
        return
    count, nodes = tone_count(level), int(_NODES[level])
    for p in range(nodes):
        then_s = time_s + record_s * change.node[level, p]
        east, north = place[0] + drift_per_s[0] * then_s, place[1] + drift_per_s[1] * then_s
        set_weights(seed, beam, east, north, field, change.values[p])
    field.weights[:count] = 0.0
    for q in range(count):
        to_re, to_im = field.weights[q, 0], field.weights[q, 1]
        for p in range(nodes):
            re, im = change.tone_from_node[level, 0, q, p], change.tone_from_node[level, 1, q, p]
            at_re, at_im = change.values[p, 0], change.values[p, 1]
            for i in range(len(to_re)):
                to_re[i] += re * at_re[i] - im * at_im[i]
                to_im[i] += re * at_im[i] + im * at_re[i]


@kernel
def streak_drift(model: ReceiverModel, echoes: Echoes, s: int, b: int) -> float:
    """Motion of the streak that a beam meets, in pitches per second; -1 without one."""
    drifts_per_s = echoes.streak_drift_per_s
    if drifts_per_s.size == 0 or echoes.range_m.shape[2] <= model.ground_beamlets:
        return -1.0
    drift_per_s: float = drifts_per_s[s, b]
    return drift_per_s if drift_per_s >= 0.0 else -1.0


@kernel
def set_streak_weights(
    seed: np.uint64, shot: int, beam: int, way: float, level: int, column: int, field: SpeckleField
) -> None:
    """Set the weights of a streak's tones of one record in `field`, at its way across the beam in pitches.

    A streak moves by a fraction of a pitch within a record: its field is constant there.
    """
    count = tone_count(level)
    field.weights[:count, :, column] = 0.0
    re, im = streak_weight(seed, shot, beam, way)
    field.weights[count // 2, 0, column], field.weights[count // 2, 1, column] = re, im
