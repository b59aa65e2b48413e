"""What a log says of its sensor: steps, limits, noise, dropouts, false locks, bias, scale and latency."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.sensor_fit.flight_log import FlightLog
from lidar_emu.sensor_fit.noise_law import (
    LEAST_BLOCKS,
    UNKNOWN,
    FittedNoise,
    Interval,
    fit_noise,
    interval_of,
    resampled,
    share_interval,
)
from lidar_emu.sensor_fit.reference import Errors, Quantity, huber_solution, robust_sigma

MOST_BINS, BLOCKS_PER_BIN = 6, 7
_LIMIT_SIGMAS, _LEAST_BEYOND = 10.0, 5
_ROUNDING = 1e-12
"""Error of a fit by rounding, as a share of the values."""
_WORST_CONDITION = 1e10
_STEP_TOLERANCE = 1e-3
_LIMIT_ROOM = 9.0
"""Robson and Whitlock (1964): 90 % upper limit of an end of a distribution, in gaps of the last two values."""


class Row(NamedTuple):
    """A line of the result."""

    what: str
    beam: int | None
    """None: all beams."""
    at: str
    """Bin of range or of signal-to-noise ratio; empty: the whole log."""
    unit: str
    estimate: Interval
    word: str
    """What the data cannot say, or what limits the figure; empty: nothing."""


class NoiseBin(NamedTuple):
    """Noise of a beam in a bin of range."""

    beam: int
    low_m: float
    high_m: float
    noise: FittedNoise


class RangeShare(NamedTuple):
    """Shares of the shots in a bin of range."""

    low_m: float
    high_m: float
    shots: int
    effective: float
    """As many independent shots would say as much."""
    valid: Interval
    false: Interval


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
    step = float(gaps.min())
    for parts in (1, 2, 3, 4, 5, 6):
        multiple = gaps * (parts / step)
        if np.mean(np.abs(multiple - np.rint(multiple)) < _STEP_TOLERANCE * np.maximum(multiple, 1)) > 0.999:
            # Few distinct gaps and many values: chance would not put them on a grid.
            return step / parts if step / parts > 1e-9 * np.abs(known).max() else np.nan
    return np.nan


def step_rows(log: FlightLog) -> list[Row]:
    """Quantisation steps of all beams together."""
    rows = []
    for what, unit, values in (
        ("range step", "m", log.range_m),
        ("speed step", "m/s", log.closing_speed_mps),
    ):
        step = step_of(values)
        word = "" if np.isfinite(step) else "no common step in the values"
        rows.append(Row(what, None, "", unit, Interval(step, step, step), word))
    return rows


def limit_rows(log: FlightLog, errors: Errors) -> list[Row]:
    """Limits of the speed; the log can say only where the motion went beyond them."""
    speed_mps = log.closing_speed_mps[np.isfinite(log.closing_speed_mps)]
    margin_mps = _LIMIT_SIGMAS * robust_sigma(log.closing_speed_mps - errors.speed.reference)
    rows = []
    for what, sign in (("highest speed", 1.0), ("lowest speed", -1.0)):
        ends = np.unique(sign * speed_mps)[-2:]
        if len(ends) < 2:
            rows.append(Row(what, None, "", "m/s", UNKNOWN, "no speeds"))
            continue
        end, room = ends[-1], _LIMIT_ROOM * (ends[-1] - ends[-2])
        beyond = int(np.count_nonzero(sign * errors.speed.reference > end + margin_mps))
        low, high = sorted((sign * end, sign * (end + room)))
        if beyond >= _LEAST_BEYOND:
            found, word = Interval(sign * end, low, high), f"the motion went beyond in {beyond} values"
        else:
            found, word = Interval(sign * end, np.nan, np.nan), "no limit seen: the motion stayed within"
        rows.append(Row(what, None, "", "m/s", found, word))
    return rows


def fit_noise_bins(
    quantity: Quantity, errors: Errors, used: BoolArray, edges_m: FloatArray
) -> list[NoiseBin]:
    """Noise of each beam in each bin of range, where there are enough values among those that are `used`."""
    found = []
    for beam in range(used.shape[1]):
        residual, reference_m = quantity.residual[:, beam], errors.range.reference[:, beam]
        for low_m, high_m in pairwise(edges_m):
            inside = used[:, beam] & np.isfinite(residual) & (reference_m >= low_m) & (reference_m < high_m)
            noise = fit_noise(residual[inside], errors.block[inside, beam], errors.smoothed)
            if noise is not None:
                found.append(NoiseBin(beam, float(low_m), float(high_m), noise))
    return found


def noise_rows(what: str, unit: str, bins: list[NoiseBin], step: float) -> list[Row]:
    """Robust sigma, 95 % half-width and tails of each bin."""
    rows = []
    for each in bins:
        at, noise = f"{each.low_m:.0f} to {each.high_m:.0f} m", each.noise
        word = "below one step: the step hides it" if noise.sigma.value < 0.5 * step else ""
        rows.append(Row(f"{what} noise, robust sigma", each.beam, at, unit, noise.sigma, word))
        rows.append(Row(f"{what} noise, 95 % half-width", each.beam, at, unit, noise.half_95, word))
        low, high = noise.inverse_degrees.low, noise.inverse_degrees.high
        degrees = Interval(
            noise.law.degrees, 1 / high if high > 0 else np.inf, 1 / low if low > 0 else np.inf
        )
        word = "a Gaussian would do" if low <= 0.002 else "heavier tails than a Gaussian's"
        rows.append(Row(f"{what} noise, degrees of freedom", each.beam, at, "", degrees, word))
    return rows


def noise_by_snr(log: FlightLog, errors: Errors, used: BoolArray) -> list[Row]:
    """Robust sigma of all beams by signal-to-noise ratio, where the log has one."""
    known = log.snr_db[used & np.isfinite(log.snr_db)]
    if not known.size:
        return [Row("noise by SNR", None, "", "", UNKNOWN, "the log has no SNR")]
    edges = np.unique(np.quantile(known, np.linspace(0, 1, MOST_BINS + 1)))
    rows = []
    for what, unit, quantity in (("range", "m", errors.range), ("speed", "m/s", errors.speed)):
        for low, high in pairwise(edges):
            inside = used & np.isfinite(quantity.residual) & (log.snr_db >= low) & (log.snr_db <= high)
            noise = fit_noise(quantity.residual[inside], errors.block[inside], errors.smoothed)
            if noise is not None:
                rows.append(
                    Row(
                        f"{what} noise, robust sigma",
                        None,
                        f"{low:.1f} to {high:.1f} dB",
                        unit,
                        noise.sigma,
                        "",
                    )
                )
    return rows


def range_shares(
    value: FloatArray, quantity: Quantity, errors: Errors, used: BoolArray, edges_m: FloatArray
) -> list[RangeShare]:
    """Shares of shots with a value, and with a false one, by range."""
    found = []
    for low_m, high_m in pairwise(edges_m):
        inside = used & (errors.range.reference >= low_m) & (errors.range.reference < high_m)
        valid, false, shots = inside & np.isfinite(value), inside & quantity.is_false, int(inside.sum())
        effective = effective_trials(valid, inside, errors.block)
        found.append(RangeShare(
            float(low_m), float(high_m), shots, effective,
            share_interval(int(valid.sum()), shots, effective),
            share_interval(int(false.sum()), shots, effective_trials(false, inside, errors.block)),
        ))  # fmt: skip
    return found


def effective_trials(hit: BoolArray, inside: BoolArray, block: IntArray) -> float:
    """As many independent trials would have the scatter of the shares from block to block, at most as there are."""
    beams = np.broadcast_to(np.arange(hit.shape[1]), hit.shape)[inside]
    _, place = np.unique(block[inside] * hit.shape[1] + beams, return_inverse=True)
    trials, hits = np.bincount(place), np.bincount(place, weights=hit[inside])
    total, share = trials.sum(), hits.sum() / max(trials.sum(), 1)
    if len(trials) < 2 or not 0 < share < 1:
        return float(total)
    variance = np.sum((hits - share * trials) ** 2) / total**2 * len(trials) / (len(trials) - 1)
    return float(np.clip(share * (1 - share) / max(variance, 1e-300), 1.0, total))


def share_rows(what: str, shares: list[RangeShare]) -> list[Row]:
    """Dropouts and false locks by range."""
    rows = []
    for each in shares:
        at = f"{each.low_m:.0f} to {each.high_m:.0f} m"
        word = (
            f"{each.shots} shots, as much as {each.effective:.0f} independent ones"
            if each.shots
            else "no shots"
        )
        dropout = Interval(*(1 - value for value in (each.valid.value, each.valid.high, each.valid.low)))
        rows.append(Row(f"{what} dropouts", None, at, "", dropout, word))
        rows.append(Row(f"{what} false locks", None, at, "", each.false, "" if each.shots else "no shots"))
    return rows


def motion_rows(log: FlightLog, errors: Errors, used: BoolArray) -> list[Row]:
    """Bias, scale and latency: of range and of speed where there is truth, else of speed against the rate of range."""
    rows = []
    for beam in range(used.shape[1]):
        if errors.smoothed:
            rows += _against_range_rate(log, errors, beam, used[:, beam])
            continue
        for what, unit, quantity in (("range", "m", errors.range), ("speed", "m/s", errors.speed)):
            good = used[:, beam] & np.isfinite(quantity.residual[:, beam])
            columns = (quantity.raw_error, quantity.reference, quantity.rate, errors.block)
            rows += _regression_rows(what, unit, beam, *(column[good, beam] for column in columns))
    return rows


def _regression_rows(
    what: str, unit: str, beam: int, error: FloatArray, level: FloatArray, rate: FloatArray, block: IntArray
) -> list[Row]:
    """Rows of error = bias + scale * level + latency * rate, by Huber's weights."""
    names = ((f"{what} bias", unit), (f"{what} scale error", ""), (f"{what} latency", "s"))
    blocks = len(np.unique(block))
    if blocks < LEAST_BLOCKS:
        return [Row(name, beam, "", of, UNKNOWN, "too few blocks") for name, of in names]
    design = np.stack([np.ones_like(level), level, rate], axis=1)
    largest = np.maximum(np.abs(design).max(axis=0), 1e-300)
    design /= largest
    solved, weight = huber_solution(design, error)
    place, counts = resampled(block)
    # One step of Newton from the solution: only values with full weight hold it in place.
    off = (weight * (error - design @ solved))[:, None]
    pull = np.concatenate(
        [(weight == 1.0)[:, None, None] * design[:, :, None] * design[:, None], (off * design)[..., None]], 2
    )
    by_block = np.zeros((blocks, 3, 4))
    np.add.at(by_block, place, pull)
    sums = np.einsum("rb,bij->rij", counts, by_block)
    if np.linalg.cond(sums[:, :, :3]).max() > _WORST_CONDITION:
        word = "the motion does not vary enough to tell them apart"
        return [Row(name, beam, "", of, UNKNOWN, word) for name, of in names]
    drawn = (solved + np.linalg.solve(sums[:, :, :3], sums[:, :, 3:])[:, :, 0]) / largest
    found = [interval_of(float(value), drawn[:, k], blocks) for k, value in enumerate(solved / largest)]
    return [
        Row(name, beam, "", of, each, "" if each.low > 0 or each.high < 0 else "not different from 0")
        for (name, of), each in zip(names, found, strict=True)
    ]


def _against_range_rate(log: FlightLog, errors: Errors, beam: int, used: BoolArray) -> list[Row]:
    """Speed against the rate of the smoothed range, block by block: without truth the two only judge each other."""
    time_s, block = log.time_s[:, beam], errors.block[:, beam]
    rows, noise_mps2 = [], []
    good = used & np.isfinite(errors.range.residual[:, beam]) & np.isfinite(errors.speed.residual[:, beam])
    for number in np.unique(block[good]):
        at = np.flatnonzero(good & (block == number))
        if len(at) < 10:
            continue
        middle_s = time_s[at].mean()
        design = (time_s[at, None] - middle_s) ** np.arange(4)
        inverse = np.linalg.pinv(design)
        fitted = inverse @ log.range_m[at, beam]
        middle_mps = (np.linalg.pinv(design[:, :3]) @ log.closing_speed_mps[at, beam])[0]
        rows.append((-fitted[1], -2.0 * fitted[2], middle_mps, number))
        rounding_m = _ROUNDING * np.abs(log.range_m[at, beam]).max()
        noise_m = max(robust_sigma(errors.range.residual[at, beam]), rounding_m)
        noise_mps2.append(2.0 * np.linalg.norm(inverse[2]) * noise_m)
    table = np.array(rows).reshape(-1, 4)
    expected_mps, acceleration_mps2, speed_mps, number = table.T
    found = _regression_rows(
        "speed against range rate", "m/s", beam, speed_mps - expected_mps, expected_mps, -acceleration_mps2,
        number.astype(np.int64),
    )  # fmt: skip
    if len(table) and np.var(acceleration_mps2) < 20.0 * np.mean(np.square(noise_mps2)):
        found[2] = found[2]._replace(estimate=UNKNOWN, word="the log brakes too little to tell a latency")
    if found[1].estimate.is_known:
        found[1] = found[1]._replace(word="an oblique beam over level ground: cos² of its angle, less 1")
    return [Row("range bias, scale and latency", beam, "", "", UNKNOWN, "there is no truth"), *found]


def smoothing_rows(log: FlightLog, errors: Errors) -> list[Row]:
    """Noise about the moving quadratic over noise by second differences, which are white noise's alone if equal."""
    rows = []
    for what, value, quantity in (
        ("range", log.range_m, errors.range), ("speed", log.closing_speed_mps, errors.speed),
    ):  # fmt: skip
        good = np.isfinite(quantity.residual)
        both = good[2:] & good[1:-1] & good[:-2] & (errors.block[2:] == errors.block[:-2])
        second = robust_sigma(np.diff(value, 2, axis=0)[both]) / np.sqrt(6.0)
        ratio = robust_sigma(quantity.residual) / second if second > 0 else np.nan
        word = "1 for white noise; above: motion or slow noise is in it, too"
        rows.append(
            Row(
                f"{what} noise, smoothing over second differences",
                None,
                "",
                "",
                Interval(ratio, np.nan, np.nan),
                word,
            )
        )
    return rows
