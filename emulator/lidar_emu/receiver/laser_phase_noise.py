"""Laser phase noise: effect of the laser's linewidth on a beat over the echo's delay, as a filter over bins.

The taps of the filter are the Fourier coefficients of exp(jΔφ) over a record, with the phase drift Δφ of a Lorentzian
laser within the delay. They are independent Gaussian numbers where Δφ is small, or changes many times within the
record; otherwise the laser's phase is a random walk: far echoes fade in the line's centre and have their peak beside it
more often than Gaussian taps do.
"""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray, SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import Normals, unit_phasor
from lidar_emu.numerics.vectors import FAST
from lidar_emu.receiver.peak_interpolation import EFFICIENCY
from lidar_emu.receiver.receiver_model import ReceiverModel

WIDE_DRIFT = 0.3
"""Variance of the phase drift up to which the line's centre is its peak: in 1e-4 of all records it is not."""

_LEAST_DELAY = 1.0 / 32.0
"""Delay in records below which the taps of any line are Gaussian: sums over 32 independent drifts."""

_STEPS_PER_DELAY, _STEPS_PER_TAP = 3, 4
"""Least number of steps of the random walk within the delay, and in a record for each tap on one side."""


class LineArrays(NamedTuple):
    """Arrays for the taps of a laser's line, overwritten."""

    phasors: FloatArray
    """(2, 2 steps + 2) Phase in turns at reception and at emission; then exp(jΔφ)."""
    held: NDArray[np.int64]
    """(2,) Steps in a record and taps on one side of the turns in `turns`."""
    turns: FloatArray
    """(steps * 2 (taps + 1),) Cosines and sines of all taps on one side, for each step of a record."""
    sums: FloatArray
    """(2, 2 (taps + 1)) Sums of products with them."""
    amplitudes: SingleArray
    """(2, taps + 1) See `set_line_amplitudes`."""


def line_arrays(taps: int) -> LineArrays:
    """Allocate arrays for up to `taps` taps on each side of the central one."""
    steps = int(walk_steps(_LEAST_DELAY, taps))
    return LineArrays(
        phasors=np.empty((2, 2 * steps + 2)),
        held=np.zeros(2, dtype=np.int64),
        turns=np.empty(steps * 2 * (taps + 1)),
        sums=np.empty((2, 2 * (taps + 1))),
        amplitudes=np.empty((2, taps + 1), dtype=np.float32),
    )


@kernel
def walk_steps(delay: float, half: int) -> int:
    """Steps of the random walk in a record, an even number, for a delay in records and taps on each side."""
    return max(2 * int(0.5 * _STEPS_PER_DELAY / delay + 1.0), _STEPS_PER_TAP * half)


@kernel
def line_variance(model: ReceiverModel, range_m: float) -> float:
    """Variance in bins² of a beat's frequency from the laser's white frequency noise over the delay, 6Δν τ²/π."""
    delay = model.delay_per_m * range_m
    return 6.0 * model.linewidth_bins / pi * delay * delay


@kernel
def line_share(model: ReceiverModel, range_m: float) -> float:
    """Fraction of the echo's power that the linewidth leaves in its central bin."""
    return exp(-phase_drift(model, range_m))


@kernel
def line_centre(model: ReceiverModel, range_m: float) -> np.float32:
    """Mean amplitude of the line's centre."""
    return np.float32(exp(-0.5 * phase_drift(model, range_m)))


@kernel
def phase_drift(model: ReceiverModel, range_m: float) -> float:
    """Variance of the laser's phase drift within the echo's delay."""
    return 2.0 * pi * model.linewidth_bins * model.delay_per_m * range_m


@kernel
def line_matters(model: ReceiverModel, range_m: float, left_out_bin2: float) -> bool:
    """Whether the line scatters a beat by more than `left_out_bin2`, or changes the echo's power."""
    if model.linewidth_bins == 0.0:
        return False
    scattered = EFFICIENCY[model.peak_method] * line_variance(model, range_m) > left_out_bin2
    return scattered or phase_drift(model, range_m) > model.least_line_drift


@kernel
def peak_wanders(model: ReceiverModel, range_m: float) -> bool:
    """Whether the peak of the laser's line may be beside its centre, so that `walked_taps` are needed."""
    if model.delay_per_m * range_m < _LEAST_DELAY:
        return False
    return phase_drift(model, range_m) > WIDE_DRIFT


@kernel
def line_numbers(model: ReceiverModel, range_m: float, half: int) -> int:
    """Random numbers that the line needs in each record where it matters, for taps on each side."""
    if not peak_wanders(model, range_m):
        return 2 * _even(half + 1)
    delay = model.delay_per_m * range_m
    count = walk_steps(delay, half)
    return _even(count + int(min(delay, 1.0) * count) + 1)


@kernel
def _even(number: int) -> int:
    return number + number % 2


@kernel
def walked_taps(
    linewidth: float, delay: float, half: int, at: int, drawn: Normals, line: LineArrays, taps: SingleArray
) -> None:
    """Set taps of exp(jΔφ) from a random walk of the laser's phase, of the variance 2π Δν t.

    Each step has two parts, so that the walk is known at the times of emission, too, which lie between those of
    reception. Δφ is taken in the middle of each step of the record: Gaussian drifts have the exact power in the centre.
    See `normal_taps` for the arguments.
    """
    count = walk_steps(delay, half)
    # Light emitted before the last record adds a constant phase.
    lag = min(delay, 1.0) * count
    whole = int(lag)
    ahead = whole + 1
    at_reception, at_emission = line.phasors[0], line.phasors[1]
    # In turns; the parts of a complex normal number have the variance 1/2.
    step = sqrt(linewidth / (pi * count))
    before, rest = step * sqrt(1.0 - (lag - whole)), step * sqrt(lag - whole)
    turn = 0.0
    for i in range(count + ahead):
        turn += before * drawn.re[at + i]
        after = turn + rest * drawn.im[at + i]
        at_reception[i], at_emission[i] = after, turn
        turn = after
    for i in range(count):
        at_reception[i] = at_reception[ahead + i] - at_emission[i + 1] + 0.5
    for i in range(count):
        drift = at_reception[i]
        at_reception[i], at_emission[i] = unit_phasor(drift - np.floor(drift))
    _transform(count, half, line, taps)


@kernel
def _transform(count: int, half: int, line: LineArrays, taps: SingleArray) -> None:
    """Fourier coefficients of the first `count` phasors, in the middle of as many equal parts of a record."""
    side = half + 1
    if line.held[0] != count or line.held[1] != half:
        line.held[0], line.held[1] = count, half
        for i in range(count):
            for m in range(side):
                turn = m * ((i + 0.5) / count - 0.5) + 0.5
                at = 2 * side * i + m
                line.turns[at], line.turns[at + side] = unit_phasor(turn - np.floor(turn))
    by_re, by_im = line.sums[0, : 2 * side], line.sums[1, : 2 * side]
    by_re[:] = 0.0
    by_im[:] = 0.0
    for i in range(count):
        _add_product(line.phasors[0, i] / count, line.turns[2 * side * i :], by_re)
        _add_product(line.phasors[1, i] / count, line.turns[2 * side * i :], by_im)
    for m in range(side):
        taps[0, half + m], taps[1, half + m] = by_re[m] + by_im[side + m], by_im[m] - by_re[side + m]
        taps[0, half - m], taps[1, half - m] = by_re[m] - by_im[side + m], by_im[m] + by_re[side + m]


@kernel(fastmath=FAST)
def _add_product(factor: float, values: FloatArray, total: FloatArray) -> None:
    for k in range(len(total)):
        total[k] += factor * values[k]


@kernel
def has_normal_taps(model: ReceiverModel, range_m: float, left_out_bin2: float) -> bool:
    """Whether the line is drawn by `normal_taps`."""
    return line_matters(model, range_m, left_out_bin2) and not peak_wanders(model, range_m)


@kernel
def set_line_amplitudes(linewidth: float, delay: float, half: int, amplitudes: SingleArray) -> None:
    """Set the amplitudes of the numbers that `normal_taps` draws.

    White frequency noise gives Δφ the variance x = 2π Δν τ and a triangular correlation of length τ. With a = 2πΔν
    the power of tap m and the pseudo-power E[c_m c_-m] are, at ω = 2πm (times and frequencies in records and bins),

        P = 2 (a - e^-x (a cos ωτ - ω sin ωτ))/(a² + ω²) - 2 e^-x sin(ωτ)/ω,
        Q = 2 e^-x (a cos ωτ + ω sin ωτ - a e^-x)/(a² + ω²) - 2 e^-x sin(ωτ)/ω,

    the transforms of e^-x (e^±R - 1). P is the pedestal of the self-homodyne line (Richter et al., IEEE J. Quantum
    Electron. 22, 1986). Where x is small, Q = -P: phase noise alone.

    Args:
        linewidth: Δν in bins.
        delay: τ in records.
        half: taps on each side.
        amplitudes: (2, half + 1 or more) receives those in phase with the light and in quadrature, of taps 0 to `half`.
    """
    rate = 2.0 * pi * linewidth
    drift = rate * delay
    loss = exp(-drift)
    # The record is finite: correlations over the delay lose a little at its ends.
    overlap = max(0.0, 1.0 - delay / 3.0)
    # Cosine and sine of ωτ turn on from tap to tap, with rounding errors of 1e-16 each.
    step_cosine, step_sine = cos(2.0 * pi * delay), sin(2.0 * pi * delay)
    cosine, sine = 1.0, 0.0
    for m in range(half + 1):
        both, pseudo = _line_powers(rate, drift, loss, (2.0 * pi * m, cosine, sine), delay)
        cosine, sine = cosine * step_cosine - sine * step_sine, sine * step_cosine + cosine * step_sine
        amplitudes[0, m] = np.float32(sqrt(max(0.0, 0.5 * overlap * (both + pseudo))))
        amplitudes[1, m] = np.float32(sqrt(max(0.0, 0.5 * overlap * (both - pseudo))))


@kernel
def normal_taps(
    linewidth: float, delay: float, half: int, at: int, drawn: Normals, line: LineArrays, taps: SingleArray
) -> None:
    """Set taps of exp(jΔφ) to Gaussian numbers, where Δφ is small or changes often within the record.

    Args:
        linewidth: Δν in bins.
        delay: τ in records.
        half: taps on each side.
        at: column of the first of `line_numbers` numbers: those in quadrature, then those in phase.
        drawn: the numbers.
        line: its amplitudes are from `set_line_amplitudes`.
        taps: (2, 2 half + 1) receives real and imaginary parts.
    """
    other = at + _even(half + 1)
    root = np.float32(sqrt(2.0))
    taps[0, half] = np.float32(exp(-0.5 * (2.0 * pi * linewidth * delay)))
    taps[0, half] += line.amplitudes[0, 0] * drawn.re[other] * root
    taps[1, half] = line.amplitudes[1, 0] * drawn.re[at] * root
    for m in range(1, half + 1):
        in_phase, quadrature = line.amplitudes[0, m], line.amplitudes[1, m]
        u_re, u_im = in_phase * drawn.re[other + m], in_phase * drawn.im[other + m]
        v_re, v_im = quadrature * drawn.re[at + m], quadrature * drawn.im[at + m]
        taps[0, half + m], taps[1, half + m] = u_re + v_re, u_im + v_im
        taps[0, half - m], taps[1, half - m] = u_re - v_re, v_im - u_im


@kernel
def _line_powers(
    rate: float, drift: float, loss: float, wave: tuple[float, float, float], delay: float
) -> tuple[float, float]:
    """P and Q at an angular frequency ω; `wave` is ω and cosine and sine of ωτ."""
    omega, cosine, sine = wave
    if drift < 1e-3:
        # The transform of the triangle itself; the two forms below cancel to it.
        angle2 = (omega * delay) ** 2
        sinc2 = 1.0 if angle2 < 1e-8 else 2.0 * (1.0 - cosine) / angle2
        power = drift * delay * sinc2
        return power * (1.0 - 0.5 * drift), -power * (1.0 - 1.5 * drift)
    bottom = rate * rate + omega * omega
    flat = delay if omega == 0.0 else sine / omega
    up = (rate - loss * (rate * cosine - omega * sine)) / bottom - loss * flat
    down = (-loss * loss * rate + loss * (rate * cosine + omega * sine)) / bottom - loss * flat
    return 2.0 * up, 2.0 * down
