"""What a log says of its sensor: steps, limits, noise, dropouts, false locks, bias, scale and latency."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from scipy.special import betaincinv, stdtrit

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.sensor_fit.flight_log import FlightLog
from lidar_emu.sensor_fit.noise_law import (
    ENDS,
    LEAST_BLOCKS,
    UNKNOWN,
    FittedNoise,
    Interval,
    fit_noise,
)
from lidar_emu.sensor_fit.reference import Errors, Quantity, huber_solution, robust_sigma

MOST_BINS, BLOCKS_PER_BIN = 6, 7
_LIMIT_SIGMAS, _LEAST_BEYOND = 10.0, 5
_WORST_CONDITION = 1e10
_STEP_TOLERANCE = 1e-3
_LIMIT_ROOM = 9.0
"""Robson and Whitlock (1964): 90 % upper limit of an end of a distribution, in gaps of the last two values."""
_GAUSSIAN_DEGREES = 500.0


class Row(NamedTuple):
    """A line of the result."""

    what: str
    beam: int | None
    """None: all beams."""
    at: str
    """Bin of range or of signal-to-noise ratio; empty: the whole log."""
    unit: str
    estimate: Interval
    word: str = ""
    """What the data cannot say, or what limits the figure; empty: nothing."""


class NoiseBin(NamedTuple):
    """Noise of a beam in a bin of range."""

    beam: int
    low_m: float
    high_m: float
    noise: FittedNoise

    def holds(self, errors: Errors) -> BoolArray:
        """(shots, beams) Whether a value is in the bin."""
        inside = in_range(errors, self.low_m, self.high_m)
        return np.asarray(inside & (np.arange(inside.shape[1]) == self.beam))


class RangeShare(NamedTuple):
    """Shares of the shots in a bin of range."""

    low_m: float
    high_m: float
    shots: int
    effective: float
    """As many independent shots would say as much."""
    valid: Interval
    false: Interval


def quantities(log: FlightLog, errors: Errors) -> Iterator[tuple[str, str, FloatArray, Quantity]]:
    """Name, unit, values and errors of range and of speed."""
    yield "range", "m", log.range_m, errors.range
    yield "speed", "m/s", log.closing_speed_mps, errors.speed


def in_range(errors: Errors, low_m: float, high_m: float) -> BoolArray:
    """(shots, beams) Whether the range is in a bin."""
    return np.asarray((errors.range.reference >= low_m) & (errors.range.reference < high_m))


def range_text(low_m: float, high_m: float) -> str:
    """A bin of range in words."""
    return f"{low_m:.0f} to {high_m:.0f} m"


def range_edges(errors: Errors) -> FloatArray:
    """Edges of bins that hold as many ranges each, as many bins as the blocks of the fitted half allow."""
    known = errors.range.reference[np.isfinite(errors.range.residual)]
    if not known.size:
        return np.array([0.0, 1.0])
    blocks = len(np.unique(errors.block[np.isfinite(errors.range.residual)])) // 2
    edges = np.quantile(known, np.linspace(0, 1, int(np.clip(blocks // BLOCKS_PER_BIN, 1, MOST_BINS)) + 1))
    edges[-1] = float(np.nanmax(errors.range.reference)) * (1 + 1e-9) + 1e-9
    return np.unique(edges)


def step_of(values: FloatArray) -> float:
    """Quantisation step: what all differences are multiples of; NaN if there is none."""
    known = np.unique(values[np.isfinite(values)])
    if known.size < 10:
        return np.nan
    gaps = np.diff(known)
    for step in gaps.min() / np.arange(1, 7):
        multiple = gaps / step
        if np.mean(np.abs(multiple - np.rint(multiple)) < _STEP_TOLERANCE * np.maximum(multiple, 1)) > 0.999:
            # Few distinct gaps and many values: chance would not put them on a grid.
            return float(step) if step > 1e-9 * np.abs(known).max() else np.nan
    return np.nan


def limit_rows(log: FlightLog, errors: Errors) -> Iterator[Row]:
    """Limits of the speed; the log can say only where the motion went beyond them."""
    speed_mps, expected_mps = log.closing_speed_mps, errors.speed.reference
    margin_mps = _LIMIT_SIGMAS * robust_sigma(speed_mps - expected_mps)
    for what, sign in (("highest speed", 1.0), ("lowest speed", -1.0)):
        ends = np.unique(sign * speed_mps[np.isfinite(speed_mps)])
        before, end = np.append([np.nan, np.nan], ends)[-2:]
        beyond = int(np.count_nonzero(sign * expected_mps > end + margin_mps))
        found, word = Interval(sign * end, np.nan, np.nan), "no limit seen: the motion stayed within"
        if beyond >= _LEAST_BEYOND:
            low, high = sorted((sign * end, sign * (end + _LIMIT_ROOM * (end - before))))
            found, word = Interval(sign * end, low, high), f"the motion went beyond in {beyond} values"
        yield Row(what, None, "", "m/s", found, word)


def fit_noise_bins(
    quantity: Quantity, errors: Errors, used: BoolArray, edges_m: FloatArray
) -> list[NoiseBin]:
    """Noise of each beam in each bin of range, where there are enough values among those that are `used`."""
    found = []
    for beam, (low_m, high_m) in product(range(used.shape[1]), pairwise(edges_m.tolist())):
        inside = used & in_range(errors, low_m, high_m) & (np.arange(used.shape[1]) == beam)
        noise = fit_noise(quantity, errors, inside)
        if noise is not None:
            found.append(NoiseBin(beam, low_m, high_m, noise))
    return found


def noise_rows(what: str, unit: str, bins: list[NoiseBin], step: float) -> Iterator[Row]:
    """Robust sigma, 95 % half-width and tails of each bin."""
    for beam, low_m, high_m, noise in bins:
        at = range_text(low_m, high_m)
        word = "below one step: the step hides it" if noise.sigma.value < 0.5 * step else ""
        tails = "a Gaussian would do" if noise.degrees.high >= _GAUSSIAN_DEGREES else "heavier tails"
        yield Row(f"{what} noise, robust sigma", beam, at, unit, noise.sigma, word)
        yield Row(f"{what} noise, 95 % half-width", beam, at, unit, noise.half_95, word)
        yield Row(f"{what} noise, degrees of freedom", beam, at, "", noise.degrees, tails)


def noise_by_snr(log: FlightLog, errors: Errors, used: BoolArray) -> Iterator[Row]:
    """Robust sigma of all beams by signal-to-noise ratio, where the log has one."""
    known = log.snr_db[used & np.isfinite(log.snr_db)]
    if not known.size:
        yield Row("noise by SNR", None, "", "", UNKNOWN, "the log has no SNR")
        return
    edges_db = np.unique(np.quantile(known, np.linspace(0, 1, MOST_BINS + 1)))
    for (what, unit, _, quantity), (low_db, high_db) in product(quantities(log, errors), pairwise(edges_db)):
        noise = fit_noise(quantity, errors, used & (log.snr_db >= low_db) & (log.snr_db <= high_db))
        if noise is not None:
            at = f"{low_db:.1f} to {high_db:.1f} dB"
            yield Row(f"{what} noise, robust sigma", None, at, unit, noise.sigma)


def range_shares(
    value: FloatArray, quantity: Quantity, errors: Errors, used: BoolArray, edges_m: FloatArray
) -> list[RangeShare]:
    """Shares of shots with a value, and with a false one, by range."""
    found = []
    for low_m, high_m in pairwise(edges_m.tolist()):
        inside = used & in_range(errors, low_m, high_m)
        effective, valid = _share(np.isfinite(value), inside, errors.block)
        _, false = _share(quantity.is_false, inside, errors.block)
        found.append(RangeShare(low_m, high_m, int(inside.sum()), effective, valid, false))
    return found


def _share(hit: BoolArray, inside: BoolArray, block: IntArray) -> tuple[float, Interval]:
    """A share of shots by Jeffreys' interval, after how many independent shots would have its scatter by blocks."""
    beams = np.broadcast_to(np.arange(hit.shape[1]), hit.shape)[inside]
    place = np.unique(block[inside] * hit.shape[1] + beams, return_inverse=True)[1]
    trials, hits = np.bincount(place), np.bincount(place, weights=hit[inside])
    of, count = int(trials.sum()), int(hits.sum())
    if of == 0:
        return 0.0, UNKNOWN
    share, effective = count / of, float(of)
    if len(trials) > 1 and 0 < count < of:
        variance = np.sum((hits - share * trials) ** 2) / of**2 * len(trials) / (len(trials) - 1)
        effective = float(np.clip(share * (1 - share) / max(variance, 1e-300), 1.0, of))
    low, high = betaincinv(share * effective + 0.5, (1 - share) * effective + 0.5, ENDS).tolist()
    # All or nothing: the end itself is possible.
    return effective, Interval(share, low if count else 0.0, high if count < of else 1.0)


def share_rows(what: str, shares: list[RangeShare]) -> Iterator[Row]:
    """Dropouts and false locks by range."""
    for each in shares:
        at = range_text(each.low_m, each.high_m)
        word = f"{each.shots} shots, as much as {each.effective:.0f} independent ones"
        dropout = Interval(1 - each.valid.value, 1 - each.valid.high, 1 - each.valid.low)
        yield Row(f"{what} dropouts", None, at, "", dropout, word)
        yield Row(f"{what} false locks", None, at, "", each.false, "" if each.shots else "no shots")


def motion_rows(log: FlightLog, errors: Errors, used: BoolArray) -> Iterator[Row]:
    """Bias, scale and latency: of range and of speed where there is truth, else of speed against the rate of range."""
    for beam in range(used.shape[1]):
        if errors.smoothed:
            yield Row("range bias, scale and latency", beam, "", "", UNKNOWN, "there is no truth")
            yield from _against_range_rate(log, errors, beam, used[:, beam])
            continue
        true_mps = errors.speed.reference[:, beam]
        rates = true_mps, -np.gradient(true_mps, log.time_s[:, beam])
        for (what, unit, value, quantity), rate in zip(quantities(log, errors), rates, strict=True):
            good = used[:, beam] & np.isfinite(quantity.residual[:, beam])
            design = np.stack([np.ones_like(rate), quantity.reference[:, beam], rate], axis=1)[good]
            error = (value - quantity.reference)[good, beam]
            yield from _regression_rows(what, unit, beam, design, error, errors.block[good, beam])


def _regression_rows(
    what: str, unit: str, beam: int, design: FloatArray, error: FloatArray, block: IntArray
) -> Iterator[Row]:
    """Rows of error = bias + scale error * level + latency * rate, columns of `design`."""
    found, word = _regression(design, error, block)
    for name, of, each in zip(("bias", "scale error", "latency"), (unit, "", "s"), found, strict=True):
        same = "not different from 0" if each.low <= 0 <= each.high else ""
        yield Row(f"{what} {name}", beam, "", of, each, word or same)


def _regression(design: FloatArray, error: FloatArray, block: IntArray) -> tuple[list[Interval], str]:
    """Coefficients by Huber's weights, with intervals by the jackknife of blocks; or why the data cannot say."""
    # Values of a block follow each other.
    starts, columns = np.flatnonzero(np.diff(block, prepend=-1)), design.shape[1]
    if (blocks := len(starts)) < LEAST_BLOCKS:
        return [UNKNOWN] * columns, "too few blocks"
    largest = np.maximum(np.abs(design).max(axis=0), 1e-300)
    design = design / largest
    solved, weight = huber_solution(design, error)
    # One step of Newton leaves out a block; only values with full weight hold the solution in place.
    hold = np.add.reduceat((weight == 1.0)[:, None, None] * design[:, :, None] * design[:, None], starts)
    pull = np.add.reduceat((weight * (error - design @ solved))[:, None] * design, starts)
    others = hold.sum(axis=0) - hold
    if np.linalg.cond(others).max() > _WORST_CONDITION:
        return [UNKNOWN] * columns, "the motion does not vary enough to tell them apart"
    shift = np.linalg.solve(others, pull[:, :, None])[:, :, 0]
    half = np.sqrt(np.sum(shift**2, axis=0) * (blocks - 1) / blocks) * stdtrit(blocks - 1, ENDS[1])
    table = np.array([solved, solved - half, solved + half]) / largest
    return [Interval(*each) for each in table.T.tolist()], ""


def _against_range_rate(log: FlightLog, errors: Errors, beam: int, used: BoolArray) -> list[Row]:
    """Speed against the rate of the smoothed range, block by block: without truth the two only judge each other."""
    block, found = errors.block[:, beam], []
    good = used & np.isfinite(errors.range.residual[:, beam] + errors.speed.residual[:, beam])
    for number in np.unique(block[good]):
        at = good & (block == number)
        if at.sum() < 10:
            continue
        time_s = log.time_s[at, beam] - log.time_s[at, beam].mean()
        cubic, covariance = np.polyfit(time_s, log.range_m[at, beam], 3, cov=True)
        # Over a range that stands still, rounding leaves coefficients of 1e-16, on some processors only.
        _, half_mps2, rate_mps, _ = cubic.round(9).tolist()
        speed_mps = np.polyfit(time_s, log.closing_speed_mps[at, beam], 2)[-1]
        found.append((speed_mps + rate_mps, -rate_mps, 2.0 * half_mps2, number, 4.0 * covariance[1, 1]))
    error_mps, level_mps, rate_mps2, number, noise = np.array(found).reshape(-1, 5).T
    design = np.stack([np.ones_like(level_mps), level_mps, rate_mps2], axis=1)
    name = "speed against range rate"
    rows = list(_regression_rows(name, "m/s", beam, design, error_mps, number.astype(np.int64)))
    if len(found) and np.var(rate_mps2) <= 20.0 * np.mean(noise):
        rows[2] = rows[2]._replace(estimate=UNKNOWN, word="the log brakes too little to tell a latency")
    if rows[1].estimate.is_known:
        rows[1] = rows[1]._replace(word="an oblique beam over level ground: cos² of its angle, less 1")
    return rows
