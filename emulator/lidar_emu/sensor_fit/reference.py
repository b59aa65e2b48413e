"""What a log's values are compared with: its ground truth, or the motion smoothed from the values themselves."""

from __future__ import annotations

from collections.abc import Iterator
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
_NEW_STRETCH_S = 2.0
_LEAST_TRACK = 2 * WINDOW
_SPEED_GATE_MPS, _SPEED_GATE_SHARE = 2.0, 0.15
_HUBER, _ITERATIONS = 1.345, 20
_LEAST_RATE_MPS, _SHARES = 5.0, (0.1, 1.2)
_STANDING_SHARE = 0.25


class Quantity(NamedTuple):
    """Errors of range or speed, arrays of (shots, beams)."""

    reference: FloatArray
    """Truth, or what stands for it; NaN where it is unknown."""
    residual: FloatArray
    """Noise, as large as white noise would be before the smoothing; NaN for false locks and where it is unknown."""
    is_false: BoolArray
    """Whether there is a value far from the reference."""
    raw_error: FloatArray
    """Value less truth; all NaN without truth."""
    rate: FloatArray
    """Change of the error per second of latency; all NaN without truth."""


class Errors(NamedTuple):
    """Range and speed of a log beside their reference."""

    range: Quantity
    speed: Quantity
    smoothed: bool
    """Whether the reference is smoothed from the values."""
    block: IntArray
    """(shots, beams) Number of the block of time."""
    disagreeing: int
    """Values whose range rate and speed contradict each other, which are left out of the noise."""

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
    parts = [
        (_from_truth if log.has_truth else _from_motion)(log, beam, block[:, beam])
        for beam in range(block.shape[1])
    ]

    def joined(place: int) -> Quantity:
        return Quantity(
            *(np.stack(each, axis=1) for each in zip(*(part[place] for part in parts), strict=True))
        )

    return Errors(joined(0), joined(1), not log.has_truth, block, sum(part[2] for part in parts))


def _from_truth(log: FlightLog, beam: int, block: IntArray) -> tuple[Quantity, Quantity, int]:
    true_mps = log.true_closing_speed_mps[:, beam]
    acceleration_mps2 = np.gradient(true_mps, log.time_s[:, beam])

    def compare(value: FloatArray, true: FloatArray, rate: FloatArray) -> Quantity:
        error = value - true
        middle = np.nanmedian(error) if np.isfinite(error).any() else np.nan
        is_false = np.abs(error - middle) > np.maximum(GATE * robust_sigma(error), 1e-9)
        design = np.stack([np.ones_like(true), true, rate], axis=1)
        residual = error - middle
        known = np.isfinite(error) & ~is_false & np.isfinite(rate)
        # Bias, scale and latency are no noise; the held-out blocks have no part in them.
        if (fitted := known & (block % 2 == 0)).sum() > WINDOW:
            residual = error - design @ huber_solution(design[fitted], error[fitted])[0]
        return Quantity(true, np.where(known, residual, np.nan), is_false, error, rate)

    return (
        compare(log.range_m[:, beam], log.true_range_m[:, beam], true_mps),
        compare(log.closing_speed_mps[:, beam], true_mps, -acceleration_mps2),
        0,
    )


def huber_solution(design: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of a robust regression, and the weight of each value (Huber's, by iteration)."""
    weight: FloatArray = np.ones_like(value)
    solved: FloatArray = np.zeros(design.shape[1])
    for _ in range(_ITERATIONS):
        root = np.sqrt(weight)
        solved = np.asarray(
            np.linalg.lstsq(design * root[:, None], value * root, rcond=None)[0], dtype=np.float64
        )
        off = np.abs(value - design @ solved)
        weight = 1.0 / np.maximum(1.0, off / max(_HUBER * 1.4826 * float(np.median(off)), 1e-300))
    return solved, weight


def _from_motion(log: FlightLog, beam: int, block: IntArray) -> tuple[Quantity, Quantity, int]:
    time_s, range_m, speed_mps = log.time_s[:, beam], log.range_m[:, beam], log.closing_speed_mps[:, beam]
    on_track = track(time_s, range_m)
    rate_mps = _rate(time_s, range_m, on_track)
    share = speed_share(speed_mps, rate_mps)
    # The rate of nine ranges is uncertain by their noise, too.
    sigma_m = _local_sigma(time_s, range_m, on_track)
    rate_sigma_mps = sigma_m / (np.sqrt(60.0) * log.period_s)
    sigma_mps = np.hypot(rate_sigma_mps, _local_sigma(time_s, speed_mps, np.isfinite(speed_mps)))
    speed_gate_mps = _SPEED_GATE_MPS + _SPEED_GATE_SHARE * np.abs(rate_mps) + GATE * sigma_mps
    disagrees = np.abs(speed_mps + share * rate_mps) > speed_gate_mps
    # A range that stands still while the speed does not is the instrument's own reflection; else the speed is wrong.
    for number in np.unique(block):
        here = (block == number) & on_track & np.isfinite(speed_mps)
        if here.any() and np.mean(disagrees[here]) > 0.5:
            moves_mps = np.median(np.abs(rate_mps[here]))
            if moves_mps < _STANDING_SHARE * np.median(np.abs(speed_mps[here])):
                on_track[block == number] = False
    reference_m, guessed = _continued(time_s, range_m, on_track)
    gate_m = GATE * sigma_m + np.where(guessed, _GUESS_SHARE * reference_m, 0.0)
    nothing: FloatArray = np.full(time_s.shape, np.nan)
    far = np.abs(range_m - reference_m) > gate_m
    locked = on_track & ~far
    range_ = Quantity(reference_m, smooth_residual(time_s, range_m, locked, block), far, nothing, nothing)
    expected_mps = np.where(
        np.isfinite(reference_m) & ~guessed, -share * _rate(time_s, range_m, locked), np.nan
    )
    # A speed without a range beside it has nothing that could confirm it.
    agrees = np.abs(speed_mps - expected_mps) <= speed_gate_mps
    false_speed = np.isfinite(speed_mps) & np.isfinite(expected_mps) & ~agrees
    residual_mps = smooth_residual(time_s, speed_mps, agrees, block)
    return (
        range_,
        Quantity(expected_mps, residual_mps, false_speed, nothing, nothing),
        int(np.count_nonzero(disagrees & on_track)),
    )


def speed_share(speed_mps: FloatArray, rate_mps: FloatArray) -> float:
    """Closing speed as a share of the rate at which the range shrinks: cos² of a beam's angle on a vertical path.

    Over level ground the footprint of an oblique beam moves while the vehicle descends.
    """
    moves = np.abs(rate_mps) > _LEAST_RATE_MPS
    share = -speed_mps[moves] / rate_mps[moves]
    likely = share[(share > _SHARES[0]) & (share < _SHARES[1])]
    return float(np.median(likely)) if likely.size else 1.0


def track(time_s: FloatArray, range_m: FloatArray) -> BoolArray:
    """Which ranges follow each other as fast as a vehicle moves: the longest such chains, each reachable from all."""
    chosen = np.zeros(time_s.shape, dtype=bool)
    known = np.flatnonzero(np.isfinite(range_m))
    if known.size < _LEAST_TRACK:
        return chosen
    fastest_mps, gate_m = _fastest(time_s[known], range_m[known])
    for chain in _chains(time_s[known], range_m[known], fastest_mps, gate_m, _longest_gap_s(time_s)):
        link, others = known[chain], np.flatnonzero(chosen)
        ends = link[[0, -1]][:, None]
        reach_m = fastest_mps * np.abs(time_s[others] - time_s[ends]) + gate_m
        between = (time_s[others] > time_s[ends[0]]) & (time_s[others] < time_s[ends[1]])
        if not between.any() and (np.abs(range_m[others] - range_m[ends]) <= reach_m).all():
            chosen[link] = True
    return chosen


def _chains(
    time_s: FloatArray, range_m: FloatArray, fastest_mps: float, gate_m: float, gap_s: float
) -> Iterator[list[int]]:
    """Chains of samples without a gap, the longest first; no sample is in two of them."""
    length, before = np.ones(len(time_s), dtype=np.int64), np.full(len(time_s), -1)
    firsts = np.searchsorted(time_s, time_s - gap_s)
    for i, first in enumerate(firsts):
        reach_m = fastest_mps * (time_s[i] - time_s[first:i]) + gate_m
        reached = np.where(np.abs(range_m[first:i] - range_m[i]) <= reach_m, length[first:i], 0)
        # Of equal chains the one that ends last: the others left the track.
        best = len(reached) - 1 - int(np.argmax(reached[::-1])) if len(reached) else 0
        if len(reached) and reached[best]:
            length[i], before[i] = reached[best] + 1, first + best
    taken = np.zeros(len(time_s), dtype=bool)
    for end in np.argsort(-length, kind="stable"):
        chain, i = [], int(end)
        while i >= 0 and not taken[i]:
            taken[i] = True
            chain.append(i)
            i = int(before[i])
        if len(chain) >= _LEAST_TRACK:
            yield chain[::-1]


def _fastest(time_s: FloatArray, range_m: FloatArray) -> tuple[float, float]:
    """Greatest rate of range to expect, and the gate of its noise, from the windows that follow a line."""
    level_m, slope_mps = _running_line(time_s, range_m)
    aside_m = np.abs(range_m - level_m)
    scatter_m = np.median(np.lib.stride_tricks.sliding_window_view(aside_m, WINDOW), axis=1)
    follows = scatter_m <= GATE * np.median(scatter_m)
    rate_mps = np.abs(slope_mps[WINDOW // 2 : len(range_m) - WINDOW // 2][follows])
    return 1.5 * float(np.quantile(rate_mps, 0.95)), GATE * 1.4826 * float(np.median(scatter_m[follows]))


@lru_cache(maxsize=512)
def _windows(offsets: tuple[float, ...]) -> FloatArray:
    """(n, 2, WINDOW) Weights of value and rate at each of n >= WINDOW instants, by quadratics over their neighbours."""
    time = np.array(offsets)
    first = np.clip(np.arange(len(time)) - WINDOW // 2, 0, len(time) - WINDOW)
    around = time[first[:, None] + np.arange(WINDOW)] - time[:, None]
    scale = np.abs(around).max()
    design = (around[:, :, None] / scale) ** np.arange(3)
    weights: FloatArray = np.linalg.pinv(design)[:, :2] / np.array([1.0, scale])[:, None]
    return weights


def smooth(time_s: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Moving quadratic through (..., n) values, n >= WINDOW: its rate, and the residual as large as white noise."""
    weights = _windows(tuple(np.round(time_s - time_s[0], 6)))
    n = len(time_s)
    first = np.clip(np.arange(n) - WINDOW // 2, 0, n - WINDOW)
    # Without the level, which would cost digits.
    around = value[..., first[:, None] + np.arange(WINDOW)] - value[..., None]
    above, rate = (np.einsum("nw,...nw->...n", weights[:, k], around) for k in (0, 1))
    own = weights[np.arange(n), 0, np.arange(n) - first]
    return rate, -above / np.sqrt(1.0 - own)


def _longest_gap_s(time_s: FloatArray) -> float:
    """Time without a value that a quadratic bridges: four missing shots."""
    return 5.0 * float(np.median(np.diff(time_s)))


def _pieces(time_s: FloatArray, usable: BoolArray, block: IntArray | None = None) -> list[IntArray]:
    index = np.flatnonzero(usable)
    if index.size < WINDOW:
        return []
    step_s = np.diff(time_s[index])
    ends = step_s > _longest_gap_s(time_s)
    if block is not None:
        ends |= np.diff(block[index]) != 0
    return [piece for piece in np.split(index, np.flatnonzero(ends) + 1) if len(piece) >= WINDOW]


def smooth_residual(time_s: FloatArray, value: FloatArray, usable: BoolArray, block: IntArray) -> FloatArray:
    """Noise about the moving quadratic of each block, as large as white noise would be; NaN where there is none."""
    residual = np.full(value.shape, np.nan)
    for piece in _pieces(time_s, usable & np.isfinite(value), block):
        residual[piece] = smooth(time_s[piece], value[piece])[1]
    return residual


def _rate(time_s: FloatArray, value: FloatArray, usable: BoolArray) -> FloatArray:
    rate = np.full(value.shape, np.nan)
    for piece in _pieces(time_s, usable):
        rate[piece] = smooth(time_s[piece], value[piece])[0]
        inside = np.arange(piece[0], piece[-1] + 1)
        rate[inside] = np.interp(time_s[inside], time_s[piece], rate[piece])
    return rate


def _local_sigma(time_s: FloatArray, value: FloatArray, usable: BoolArray) -> float:
    sigma = robust_sigma(smooth_residual(time_s, value, usable, np.zeros(time_s.shape, dtype=np.int64)))
    return 0.0 if np.isnan(sigma) else sigma


def _continued(time_s: FloatArray, range_m: FloatArray, on_track: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Range at all instants of each track, and a little beyond; and whether it is a guess beyond the track."""
    reference_m = np.full(time_s.shape, np.nan)
    guessed = np.zeros(time_s.shape, dtype=bool)
    index = np.flatnonzero(on_track)
    for part in (
        np.split(index, np.flatnonzero(np.diff(time_s[index]) > _NEW_STRETCH_S) + 1) if index.size else []
    ):
        if len(part) < _LEAST_TRACK:
            continue
        t = time_s[part]
        r, slope_mps = _running_line(t, range_m[part])
        inside = (time_s >= t[0]) & (time_s <= t[-1])
        reference_m[inside] = np.interp(time_s[inside], t, r)
        for end, last, away_s in (
            (slice(0, _LEAST_TRACK), 0, t[0] - time_s),
            (slice(-_LEAST_TRACK, None), -1, time_s - t[-1]),
        ):
            beyond = (away_s > 0) & (away_s <= LONGEST_GUESS_S) & np.isnan(reference_m)
            line_m = r[last] + np.median(slope_mps[end]) * (time_s[beyond] - t[last])
            reference_m[beyond], guessed[beyond] = np.maximum(line_m, 0.0), True
    return reference_m, guessed


def _running_line(time_s: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value and slope at each instant of the line through its neighbours with the median of their slopes (Sen)."""
    n = len(time_s)
    near = np.clip(np.arange(n) - WINDOW // 2, 0, n - WINDOW)[:, None] + np.arange(WINDOW)
    one, other = np.triu_indices(WINDOW, 1)
    t, v = time_s[near] - time_s[:, None], value[near]
    slope = np.median((v[:, other] - v[:, one]) / (t[:, other] - t[:, one]), axis=1)
    return np.asarray(np.median(v - slope[:, None] * t, axis=1)), slope
