"""The speckle of a beam that hardly moves between shots, as a field over the sensor's place and the beam's direction.

Scatterers far away send plane waves from all directions n. With the sensor at p and the beam along u, the echo field is

    a(p, u) = Σ A(n) exp(-2 |n - u|²/θ0²) exp(j 4π n·p/λ),    θ0 = λ/(π w0),

with independent circular Gaussian amplitudes A: the angular spectrum of a monostatic Gaussian mode, used once on the
way out and once on the way back. From one shot to another the field of a sensor that moved by D across the beam, by z
along it, and turned by θ, has the correlation

    exp(-D²/w0²),    1/(1 + jz/(2 zR)),    exp(-(π w0 θ/λ)²),

at any range: the first two are those of the mode's overlap with itself in other places (zR is the Rayleigh range). The
waves come from cells of the sphere of directions, one from each, at a random place in its cell that belongs to the
beamlet.

A cell has the same waves whatever the shot, as long as the sensor stays in one square across its direction. If it had
them everywhere, a beam of steady direction would have the same few waves for a whole flight: the mean power of each
beamlet would be off by 0.4 of itself, and the scatter of the ranges by 8 %. The squares of the cells end at different
places, so that waves change one by one; the correlation over D becomes smaller by the factor 1 - (|Da| + |Db|)/L, L
their side.

The cells are squares of the two smaller components of the direction, on one face of a cube around it.
"""

from __future__ import annotations

from math import floor, pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import FloatArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import (
    WAVES,
    Normals,
    draw_words,
    normals,
    set_normals,
    single_phasor,
    uniform_pair,
)
from lidar_emu.numerics.vectors import FAST, Vector, nan_to_zero, norm
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam
from lidar_emu.receiver.returns import (
    ACROSS_A,
    ACROSS_B,
    ALONG,
    COSINE_A,
    COSINE_B,
    DRIFT_A,
    DRIFT_B,
    FACE,
    TRAVEL,
)

PITCH_W = pi * sqrt(2.0 / 27.0)
"""Distance of the corners of `speckle` as a multiple of the radius w of the correlation exp(-D²/w²)."""

CELL = 0.53
"""Side of a cell in θ0: 1.5 standard deviations of the spectrum's power."""

_SQUARE_W = 64.0
"""Side L of the squares of sensor places in which a cell has the same waves, as a multiple of w0."""

_REACH = 2
"""Cells to either side of the beam's own; beyond is 0.3 % of the power at most."""

_SIDE = 2 * _REACH + 1

_FARTHEST_M = 1e12
"""Distance beyond which no sensor is from the origin."""

_CELL_MASK = 0xFFFFF
_SQUARE_MASK = 0x3FF
_STAGGER = 0.7548776662466927, 0.5698402909980532
"""Irrational shifts of the squares from cell to cell, as shares of their side."""
_JITTER_NUMBERS = 2**16

_HALF, _PER_31_BITS, _PER_32_BITS = np.float32(0.5), np.float32(2.0**-31), np.float32(2.0**-32)


class FieldWaves(NamedTuple):
    """The waves that a beam receives, one cell after another, each `beam.columns` long."""

    drawn: Normals
    """Amplitudes, with the mode's weights, whose squares sum to 1 for each beamlet."""
    place: SingleArray
    """(2, columns) Places of a cell's waves in it, from 0 to 1, overwritten."""
    turn: SingleArray
    """Phases at the time of validity, in turns."""
    turn_per_s: SingleArray
    weight: SingleArray
    """Weights of the mode."""
    power: SingleArray
    """(columns,) Overwritten."""


def field_waves(columns: int) -> FieldWaves:
    """Allocate the waves of beams of up to `columns` columns."""
    count = _SIDE * _SIDE * columns
    return FieldWaves(
        drawn=normals(count),
        place=np.empty((2, columns), dtype=np.float32),
        turn=np.empty(count, dtype=np.float32),
        turn_per_s=np.empty(count, dtype=np.float32),
        weight=np.empty(count, dtype=np.float32),
        power=np.empty(columns, dtype=np.float32),
    )


@kernel
def as_waves(arrays: tuple[Any, ...]) -> FieldWaves:
    """Named tuple from plain ones."""
    drawn, place, turn, turn_per_s, weight, power = arrays
    return FieldWaves(Normals(*drawn), place, turn, turn_per_s, weight, power)


@kernel
def set_place(
    axis: FloatArray, sensor: Vector, drift_mps: Vector, waist_m: float, place: FloatArray, motion: FloatArray
) -> None:
    """Set rows of `Echoes.speckle_place` and `Echoes.speckle_motion` of a beam.

    Args:
        axis: unit vector of the beam, in the frame of the ground.
        sensor: place of the sensor relative to the ground that it measures, in metres.
        drift_mps: motion across the beam over which the speckle changes as it does at the waist.
    """
    face = 2
    for i in range(2):
        if abs(axis[i]) > abs(axis[face]):
            face = i
    a, b = (face + 1) % 3, (face + 2) % 3
    toward = axis[face]
    lean_a, lean_b = axis[a] / toward, axis[b] / toward
    place[FACE] = face + 1.0 if toward > 0.0 else -(face + 1.0)
    place[COSINE_A], place[COSINE_B] = nan_to_zero(axis[a]), nan_to_zero(axis[b])
    place[ACROSS_A] = nan_to_zero(sensor[a] - sensor[face] * lean_a)
    place[ACROSS_B] = nan_to_zero(sensor[b] - sensor[face] * lean_b)
    place[ALONG] = nan_to_zero(sensor[face] / toward)
    motion[TRAVEL] = nan_to_zero(norm(drift_mps) / (PITCH_W * waist_m))
    motion[DRIFT_A] = nan_to_zero(drift_mps[a] - drift_mps[face] * lean_a)
    motion[DRIFT_B] = nan_to_zero(drift_mps[b] - drift_mps[face] * lean_b)


@kernel
def is_in_field(place: FloatArray, motion: FloatArray) -> bool:
    """Whether a beam with these rows of `Echoes.speckle_place` and `Echoes.speckle_motion` has the field's speckle: not
    one that moves too far between shots, nor one whose place is no number."""
    if not (1.0 <= abs(place[FACE]) <= 3.0 and abs(place[COSINE_A]) <= 1.0 and abs(place[COSINE_B]) <= 1.0):
        return False
    for column in (ACROSS_A, ACROSS_B, ALONG):
        if not abs(place[column]) < _FARTHEST_M:
            return False
    return bool(abs(motion[DRIFT_A]) < _FARTHEST_M and abs(motion[DRIFT_B]) < _FARTHEST_M)


@kernel
def set_waves(
    model: ReceiverModel, beam: Beam, place: FloatArray, motion: FloatArray, waves: FieldWaves
) -> None:
    """Draw the waves of a beam.

    Args:
        place, motion: rows of `Echoes.speckle_place` and `Echoes.speckle_motion`.
    """
    cell, columns = CELL * model.divergence_rad, beam.columns
    middle_a, middle_b = floor(place[COSINE_A] / cell), floor(place[COSINE_B] / cell)
    start_a, start_b = uniform_pair(beam.seed, 0, beam.beam, WAVES, 2 * _JITTER_NUMBERS)
    at = 0
    for k in range(_SIDE * _SIDE):
        a, b = middle_a + k // _SIDE - _REACH, middle_b + k % _SIDE - _REACH
        corner = a * cell - place[COSINE_A], b * cell - place[COSINE_B]
        stagger = _STAGGER[0] * a + _STAGGER[1] * b
        square = _square(model, place, corner, (start_a + stagger, start_b + stagger))
        key = _cell_key(place[FACE], a, b, square)
        draw_words(beam.seed, key, beam.beam, WAVES, _JITTER_NUMBERS, columns, at, waves.drawn.words)
        _set_places(at, columns, waves)
        next_at = draw_words(beam.seed, key, beam.beam, WAVES, 0, columns, at, waves.drawn.words)
        _set_cell(model, corner, place, motion, columns, waves, at)
        at = next_at
    set_normals(at, waves.drawn)
    _apply_mode(columns, waves)


@kernel
def _square(
    model: ReceiverModel, place: FloatArray, corner: tuple[float, float], start: tuple[float, float]
) -> tuple[int, int]:
    """Square of the sensor's place across a cell: across the beam, it would change with turns about a far origin."""
    x, y = corner
    a, b = place[COSINE_A], place[COSINE_B]
    leaning = (a * x + b * y) / (1.0 - a * a - b * b)
    across_a = place[ACROSS_A] - place[ALONG] * (x + a * leaning)
    across_b = place[ACROSS_B] - place[ALONG] * (y + b * leaning)
    per_m = pi * model.divergence_rad / (model.wavelength_m * _SQUARE_W)
    return floor(across_a * per_m + start[0]), floor(across_b * per_m + start[1])


@kernel
def _cell_key(face: float, a: float, b: float, square: tuple[int, int]) -> int:
    """Number of a cell and a square, in the place of a shot's."""
    squares = ((square[0] & _SQUARE_MASK) << 10) | (square[1] & _SQUARE_MASK)
    cell = ((int(face) + 3) << 40) | ((int(a) & _CELL_MASK) << 20) | (int(b) & _CELL_MASK)
    return (squares << 43) | cell


@kernel(fastmath=FAST)
def _set_places(at: int, columns: int, waves: FieldWaves) -> None:
    words_0, words_1 = waves.drawn.words[0, at // 2 :], waves.drawn.words[1, at // 2 :]
    words_2, words_3 = waves.drawn.words[2, at // 2 :], waves.drawn.words[3, at // 2 :]
    a, b = waves.place[0], waves.place[1]
    for i in range(columns // 2):
        a[2 * i], a[2 * i + 1] = np.float32(words_0[i]) * _PER_31_BITS, np.float32(words_2[i]) * _PER_31_BITS
        b[2 * i] = np.float32(words_1[i]) * _PER_32_BITS + _HALF
        b[2 * i + 1] = np.float32(words_3[i]) * _PER_32_BITS + _HALF


@kernel(fastmath=FAST)
def _set_cell(
    model: ReceiverModel,
    corner: tuple[float, float],
    place: FloatArray,
    motion: FloatArray,
    columns: int,
    waves: FieldWaves,
    at: int,
) -> None:
    """Set phases and weights of a cell's waves, the weights in the columns that the amplitudes are multiplied into."""
    cell, turns_per_m = CELL * model.divergence_rad, 2.0 / model.wavelength_m
    a, b, tilt = place[COSINE_A], place[COSINE_B], 1.0 - place[COSINE_A] ** 2 - place[COSINE_B] ** 2
    across_a, across_b = turns_per_m * place[ACROSS_A], turns_per_m * place[ACROSS_B]
    along, decay = 0.5 * turns_per_m * place[ALONG], 2.0 / model.divergence_rad**2
    drift_a, drift_b = turns_per_m * motion[DRIFT_A], turns_per_m * motion[DRIFT_B]
    corner_a, corner_b = corner
    place_a, place_b = waves.place[0], waves.place[1]
    turn, turn_per_s, weight = waves.turn[at:], waves.turn_per_s[at:], waves.weight[at:]
    for i in range(columns):
        x, y = corner_a + cell * place_a[i], corner_b + cell * place_b[i]
        leaning = a * x + b * y
        angle2 = x * x + y * y + leaning * leaning / tilt
        phase = across_a * x + across_b * y - along * angle2
        turn[i] = np.float32(phase - np.rint(phase))
        turn_per_s[i] = np.float32(drift_a * x + drift_b * y)
        weight[i] = np.float32(_exp_minus(decay * angle2))


@kernel(fastmath=FAST)
def _exp_minus(x: float) -> float:
    """exp(-x) for x from 0 to 30 to 2e-4 of itself, in a form that is vectorised."""
    y = -x / 32.0
    root = 1.0 + y * (1.0 + y / 2 * (1.0 + y / 3 * (1.0 + y / 4 * (1.0 + y / 5 * (1.0 + y / 6)))))
    for _ in range(5):
        root = root * root
    return root


@kernel
def _apply_mode(columns: int, waves: FieldWaves) -> None:
    """Multiply the amplitudes by the mode's weights, whose squares then sum to 1 for each beamlet."""
    power = waves.power[:columns]
    power[:] = 0.0
    for k in range(_SIDE * _SIDE):
        _add_squares(waves.weight[k * columns :], power)
    for i in range(columns):
        power[i] = np.float32(1.0) / np.sqrt(power[i])
    for k in range(_SIDE * _SIDE):
        at = k * columns
        _weigh(waves.weight[at:], power, waves.drawn.re[at:], waves.drawn.im[at:])


@kernel(fastmath=FAST)
def _add_squares(weight: SingleArray, power: SingleArray) -> None:
    for i in range(len(power)):
        power[i] += weight[i] * weight[i]


@kernel(fastmath=FAST)
def _weigh(weight: SingleArray, norm: SingleArray, re: SingleArray, im: SingleArray) -> None:
    for i in range(len(norm)):
        scale = weight[i] * norm[i]
        re[i], im[i] = scale * re[i], scale * im[i]


@kernel
def set_field(beam: Beam, time_s: float, waves: FieldWaves, value: SingleArray) -> None:
    """Set the field of each beamlet at a time from the time of validity, (2, columns).

    A single beamlet has the waves of all columns: the more waves, the less is left of a correlation far away.
    """
    columns = beam.columns
    value[:, :columns] = 0.0
    for k in range(_SIDE * _SIDE):
        at = k * columns
        _add_waves(
            np.float32(time_s), waves.turn[at:], waves.turn_per_s[at:], waves.drawn.re[at:], waves.drawn.im[at:],
            value[0, :columns], value[1, :columns],
        )  # fmt: skip
    if beam.beamlets == 1:
        scale = np.float32(1.0 / sqrt(columns))
        for part in range(2):
            for i in range(1, columns):
                value[part, 0] += value[part, i]
            value[part, 0] *= scale


@kernel(fastmath=FAST)
def _add_waves(
    time_s: np.float32,
    turn: SingleArray,
    turn_per_s: SingleArray,
    wave_re: SingleArray,
    wave_im: SingleArray,
    re: SingleArray,
    im: SingleArray,
) -> None:
    for i in range(len(re)):
        now = turn[i] + turn_per_s[i] * time_s
        cosine, sine = single_phasor(now - np.rint(now))
        re[i] += wave_re[i] * cosine - wave_im[i] * sine
        im[i] += wave_re[i] * sine + wave_im[i] * cosine
