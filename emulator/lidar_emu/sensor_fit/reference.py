"""What a log's values are compared with: its ground truth, or the motion smoothed from the values themselves."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.sensor_fit.flight_log import FlightLog

WINDOW = 9
"""Samples of the moving quadratic: short, so that the motion inside is one, and it takes no more than 1 in 4 parts."""
GATE = 20.0
"""Robust standard deviations beyond which a value is a false lock and no noise: 0.2 % of Student's t of 2 degrees."""
LONGEST_GUESS_S = 5.0
"""Time by which a range is continued beyond the first and last sample of a track, to tell dropouts and false locks."""
_GUESS_SHARE = 0.05
_GAP_SHOTS = 5
"""A quadratic bridges four missing shots."""
_LEAST_TRACK = 2 * WINDOW
_SPEED_GATE_MPS, _SPEED_GATE_SHARE = 2.0, 0.15
_HUBER, _ITERATIONS = 1.345, 20
_LEAST_RATE_MPS, _LEAST_SHARE, _GREATEST_SHARE = 5.0, 0.1, 1.2
_STANDING_SHARE = 0.25


class Quantity(NamedTuple):
    """Errors of range or speed, arrays of (shots, beams)."""

    reference: FloatArray
    """Truth, or what stands for it; NaN where it is unknown."""
    residual: FloatArray
    """Noise, as large as white noise would be before the smoothing; NaN for false locks and where it is unknown."""
    is_false: BoolArray
    """Whether there is a value far from the reference."""


class Errors(NamedTuple):
    """Range and speed of a log beside their reference."""

    range: Quantity
    speed: Quantity
    smoothed: bool
    """Whether the reference is smoothed from the values."""
    block: IntArray
    """(shots, beams) Number of the block of time."""

    @property
    def is_held_out(self) -> BoolArray:
        return np.asarray(self.block % 2 == 1)


def robust_sigma(values: FloatArray) -> float:
    """Standard deviation of the Gaussian that has the median of the magnitudes; NaN if there are no values."""
    known = values[np.isfinite(values)]
    return float(1.4826 * np.median(np.abs(known - np.median(known)))) if known.size else np.nan


def errors_of(log: FlightLog, block_s: float) -> Errors:
    """Compare a log with its truth, or with its own smoothed motion, block by block, so that no block knows another."""
    block = np.floor(log.time_s / block_s).astype(np.int64)
    compared = _from_truth if log.has_truth else _from_motion
    beams = [compared(log, beam, block[:, beam]) for beam in range(block.shape[1])]
    ranges, speeds = (
        Quantity(*(np.stack(column, axis=1) for column in zip(*each, strict=True)))
        for each in zip(*beams, strict=True)
    )
    return Errors(ranges, speeds, not log.has_truth, block)


def _from_truth(log: FlightLog, beam: int, block: IntArray) -> tuple[Quantity, Quantity]:
    true_mps = log.true_closing_speed_mps[:, beam]

    def compare(value: FloatArray, true: FloatArray, rate: FloatArray) -> Quantity:
        error = value - true
        residual = error - (np.nanmedian(error) if np.isfinite(error).any() else np.nan)
        is_false = np.abs(residual) > np.maximum(GATE * robust_sigma(error), 1e-9)
        known = np.isfinite(error + rate) & ~is_false
        # Bias, scale and latency are no noise; the held-out blocks have no part in them.
        if (fitted := known & (block % 2 == 0)).sum() > WINDOW:
            design = np.stack([np.ones_like(true), true, rate], axis=1)
            residual = error - design @ huber_solution(design[fitted], error[fitted])[0]
        return Quantity(true, np.where(known, residual, np.nan), is_false)

    return (
        compare(log.range_m[:, beam], log.true_range_m[:, beam], true_mps),
        compare(log.closing_speed_mps[:, beam], true_mps, -np.gradient(true_mps, log.time_s[:, beam])),
    )


def huber_solution(design: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of a robust regression, and the weight of each value (Huber's, by iteration)."""
    weight: FloatArray = np.ones_like(value)
    solved: FloatArray = np.zeros(design.shape[1])
    for _ in range(_ITERATIONS):
        root = np.sqrt(weight)
        solved = np.asarray(np.linalg.lstsq(design * root[:, None], value * root, rcond=None)[0])
        off = np.abs(value - design @ solved)
        weight = 1.0 / np.maximum(1.0, off / max(_HUBER * 1.4826 * float(np.median(off)), 1e-300))
    return solved, weight


def _from_motion(log: FlightLog, beam: int, block: IntArray) -> tuple[Quantity, Quantity]:
    time_s, range_m, speed_mps = log.time_s[:, beam], log.range_m[:, beam], log.closing_speed_mps[:, beam]
    tracked_m = np.where(track(time_s, range_m), range_m, np.nan)
    _, rate_mps = _followed(time_s, tracked_m)
    # Over level ground an oblique beam closes at a share of its range's rate: cos² of its angle on a vertical path.
    moves = np.abs(rate_mps) > _LEAST_RATE_MPS
    shares = -speed_mps[moves] / rate_mps[moves]
    likely = shares[(shares > _LEAST_SHARE) & (shares < _GREATEST_SHARE)]
    share = np.median(likely) if likely.size else 1.0
    sigma_m, sigma_mps = (
        np.nan_to_num(robust_sigma(smooth_residual(time_s, each))) for each in (tracked_m, speed_mps)
    )
    # The rate of nine ranges is uncertain by their noise, too.
    sigma_mps = np.hypot(sigma_m / (np.sqrt(60.0) * _period_s(time_s)), sigma_mps)
    gate_mps = _SPEED_GATE_MPS + _SPEED_GATE_SHARE * np.abs(rate_mps) + GATE * sigma_mps
    # A range that stands still while the speed does not is the instrument's own reflection; else the speed is wrong.
    stands = np.maximum(gate_mps, np.abs(rate_mps) / _STANDING_SHARE) < np.abs(speed_mps)
    for number in np.unique(block):
        here = (block == number) & np.isfinite(tracked_m + speed_mps)
        if 2 * np.count_nonzero(stands & here) > np.count_nonzero(here):
            tracked_m[block == number] = np.nan
    reference_m, rate_mps = _followed(time_s, tracked_m)
    gate_m = GATE * sigma_m + np.where(np.isnan(rate_mps), _GUESS_SHARE * reference_m, 0.0)
    far = np.abs(range_m - reference_m) > gate_m
    tracked_m[far] = np.nan
    expected_mps = -share * rate_mps
    # A speed without a range beside it has nothing that could confirm it.
    off_mps = np.abs(speed_mps - expected_mps)
    agreeing_mps = np.where(off_mps <= gate_mps, speed_mps, np.nan)
    return (
        Quantity(reference_m, smooth_residual(time_s, tracked_m, block), far),
        Quantity(expected_mps, smooth_residual(time_s, agreeing_mps, block), off_mps > gate_mps),
    )


def track(time_s: FloatArray, range_m: FloatArray) -> BoolArray:
    """Which ranges follow each other as fast as a vehicle moves: the largest such groups, each reachable from all."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    chosen = np.zeros(time_s.shape, dtype=bool)
    known = np.flatnonzero(np.isfinite(range_m))
    if known.size < _LEAST_TRACK:
        return chosen
    t, r = time_s[known], range_m[known]
    fastest_mps, gate_m = _fastest(t, r)
    later = np.minimum(np.arange(known.size)[:, None] + np.arange(1, _GAP_SHOTS + 1), known.size - 1)
    step_s, step_m = t[later] - t[:, None], np.abs(r[later] - r[:, None])
    near = (step_s <= _GAP_SHOTS * _period_s(time_s)) & (step_m <= fastest_mps * step_s + gate_m)
    links = coo_array((near[near], (np.nonzero(near)[0], later[near])), shape=(known.size, known.size))
    group = connected_components(links, directed=False)[1]
    sizes = np.bincount(group)
    for number in np.argsort(-sizes, kind="stable")[: np.count_nonzero(sizes >= _LEAST_TRACK)]:
        link, others = known[group == number], np.flatnonzero(chosen)
        ends = link[[0, -1]][:, None]
        reach_m = fastest_mps * np.abs(time_s[others] - time_s[ends]) + gate_m
        if (
            not chosen[link[0] : link[-1]].any()
            and (np.abs(range_m[others] - range_m[ends]) <= reach_m).all()
        ):
            chosen[link] = True
    return chosen


def _fastest(time_s: FloatArray, range_m: FloatArray) -> tuple[float, float]:
    """Greatest rate of range to expect, and the gate of its noise, from the windows that follow a line."""
    level_m, slope_mps = _running_line(time_s, range_m)
    aside_m = np.abs(range_m - level_m)
    scatter_m = np.median(aside_m[_neighbours(len(time_s))], axis=1)
    follows = scatter_m <= GATE * np.median(scatter_m)
    fastest_mps = 1.5 * float(np.quantile(np.abs(slope_mps[follows]), 0.95))
    return fastest_mps, GATE * 1.4826 * float(np.median(scatter_m[follows]))


@lru_cache(maxsize=512)
def _windows(offsets: tuple[float, ...]) -> FloatArray:
    """(n, WINDOW) Weights of the value at each of n >= WINDOW instants, by quadratics over their neighbours."""
    time = np.array(offsets)
    around = time[_neighbours(len(time))] - time[:, None]
    return np.linalg.pinv(around[:, :, None] ** np.arange(3))[:, 0]


def _neighbours(n: int) -> IntArray:
    """(n, WINDOW) Places of the window around each of n instants."""
    first = np.clip(np.arange(n) - WINDOW // 2, 0, n - WINDOW)
    return np.asarray(first[:, None] + np.arange(WINDOW))


def about_quadratic(time_s: FloatArray, value: FloatArray) -> FloatArray:
    """Residual of (..., n) values, n >= WINDOW, about a moving quadratic, as large as white noise would be."""
    weights, near = _windows(tuple(np.round(time_s - time_s[0], 6))), _neighbours(len(time_s))
    # Without the level, which would cost digits.
    above = np.einsum("nw,...nw->...n", weights, value[..., near] - value[..., None])
    own = weights[near == np.arange(len(time_s))[:, None]]
    return np.asarray(-above / np.sqrt(1.0 - own))


def smooth_residual(time_s: FloatArray, value: FloatArray, block: IntArray | None = None) -> FloatArray:
    """Noise about the moving quadratic of each block, as large as white noise would be; NaN where there is none."""
    residual = np.full(value.shape, np.nan)
    for piece in _pieces(time_s, value, block):
        residual[piece] = about_quadratic(time_s[piece], value[piece])
    return residual


def _followed(time_s: FloatArray, range_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range at all instants of each stretch of a track, and a guess a little beyond; and its rate, NaN for a guess."""
    reference_m, rate_mps = np.full((2, len(time_s)), np.nan)
    for piece in _pieces(time_s, range_m):
        t, (level_m, slope_mps) = time_s[piece], _running_line(time_s[piece], range_m[piece])
        first_m = level_m[0] - LONGEST_GUESS_S * np.median(slope_mps[:_LEAST_TRACK])
        last_m = level_m[-1] + LONGEST_GUESS_S * np.median(slope_mps[-_LEAST_TRACK:])
        knots_s = np.concatenate([[t[0] - LONGEST_GUESS_S], t, [t[-1] + LONGEST_GUESS_S]])
        knots_m = np.concatenate([[first_m], level_m, [last_m]])
        line_m = np.interp(time_s, knots_s, knots_m, left=np.nan, right=np.nan)
        inside = (time_s >= t[0]) & (time_s <= t[-1])
        reference_m = np.where(inside | np.isnan(reference_m), line_m, reference_m)
        rate_mps[inside] = np.interp(time_s[inside], t, slope_mps)
    return np.maximum(reference_m, 0.0), rate_mps


def _period_s(time_s: FloatArray) -> float:
    return float(np.median(np.diff(time_s)))


def _pieces(time_s: FloatArray, value: FloatArray, block: IntArray | None = None) -> list[IntArray]:
    """Places of values that follow each other without a gap, and within a block."""
    index = np.flatnonzero(np.isfinite(value))
    ends = np.diff(time_s[index]) > _GAP_SHOTS * _period_s(time_s)
    if block is not None:
        ends |= np.diff(block[index]) != 0
    return [piece for piece in np.split(index, np.flatnonzero(ends) + 1) if len(piece) >= WINDOW]


def _running_line(time_s: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value and slope at each instant of the line through its neighbours with the median of their slopes (Sen)."""
    near, (one, other) = _neighbours(len(time_s)), np.triu_indices(WINDOW, 1)
    t, v = time_s[near] - time_s[:, None], value[near]
    slope = np.median((v[:, other] - v[:, one]) / (t[:, other] - t[:, one]), axis=1)
    return np.asarray(np.median(v - slope[:, None] * t, axis=1)), slope
