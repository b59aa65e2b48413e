"""What all beamlets of a beam have in common during a record: smear by motion, and the laser's line.

A factor m(t) common to all tones is a filter over rectangular bins, whose taps are the Fourier coefficients of m
over the record.
"""

from __future__ import annotations

from math import cos, erf, exp, factorial, log, pi, sin, sqrt

import numpy as np

from lidar_emu.fmcw.spectrum import BIN
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal
from lidar_emu.numerics.sine import FAST

LEAST_TAPS = 8
"""Taps on each side of the central one, before a wide smear or line asks for more."""

_LANES = 4
"""Numbers in a vector."""

_SERIES_LIMIT = 2.0
_TERMS = 14


def _moments() -> FloatArray:
    """(terms, taps) π^p/p! times the integral of x^2p cos(2πmx) over the record, x from -1/2 to 1/2."""
    node, weight = np.polynomial.legendre.leggauss(64)
    x, weight = 0.5 * node, 0.5 * weight
    taps = np.cos(2 * np.pi * np.arange(LEAST_TAPS + 1)[:, None] * x)
    return np.array(
        [(taps * x ** (2 * p) * weight).sum(axis=1) * np.pi**p / factorial(p) for p in range(_TERMS)]
    )


_MOMENTS = _moments()
_NODES, _WEIGHTS = (np.ascontiguousarray(a) for a in np.polynomial.legendre.leggauss(16))


@kernel
def smear_taps(smear: float, half: int, taps: FloatArray) -> None:
    """Taps of exp(jπβx²), x from -1/2 to 1/2 over the record: a beat that changes by β bins during it.

    A series in β for small changes, Gauss-Legendre panels for large ones.

    Args:
        smear: β.
        half: taps on each side.
        taps: (2, 2 half + 1) receives real and imaginary parts; the centre is column `half`.
    """
    if abs(smear) <= _SERIES_LIMIT and half <= LEAST_TAPS:
        for m in range(half + 1):
            re = im = 0.0
            power = 1.0
            for p in range(0, _TERMS, 2):
                sign = 1.0 if p % 4 == 0 else -1.0
                re += sign * power * _MOMENTS[p, m]
                im += sign * power * smear * _MOMENTS[p + 1, m]
                power *= smear * smear
            taps[0, half + m] = taps[0, half - m] = re
            taps[1, half + m] = taps[1, half - m] = im
        return
    panels = 2 + int((abs(smear) + half) / 3.0)
    for m in range(half + 1):
        re = im = 0.0
        for panel in range(panels):
            for q in range(len(_NODES)):
                # The integrand is even: half the record, twice.
                x = 0.25 * (2 * panel + 1 + _NODES[q]) / panels
                share = 0.5 * _WEIGHTS[q] / panels * cos(2 * pi * m * x)
                angle = pi * smear * x * x
                re += share * cos(angle)
                im += share * sin(angle)
        taps[0, half + m] = taps[0, half - m] = re
        taps[1, half + m] = taps[1, half - m] = im


@kernel
def line_taps(
    linewidth: float,
    delay: float,
    seed: np.uint64,
    shot: int,
    beam: int,
    purpose: int,
    first_index: int,
    half: int,
    taps: FloatArray,
) -> None:
    """Draw taps of exp(jΔφ), Δφ the phase that a Lorentzian laser drifts within the echo's delay.

    White frequency noise gives Δφ the variance x = 2π Δν τ and a triangular correlation of length τ. With a = 2πΔν
    the power of tap m and the pseudo-power E[c_m c_-m] are, at ω = 2πm (times and frequencies in records and bins),

        P = 2 (a - e^-x (a cos ωτ - ω sin ωτ))/(a² + ω²) - 2 e^-x sin(ωτ)/ω,
        Q = 2 e^-x (a cos ωτ + ω sin ωτ - a e^-x)/(a² + ω²) - 2 e^-x sin(ωτ)/ω,

    the transforms of e^-x (e^±R - 1): P is the pedestal of the self-homodyne line (Richter et al., IEEE J. Quantum
    Electron. 22, 1986). The taps are drawn as Gaussian. Where x is small, Q = -P: phase noise alone.

    Args:
        linewidth: Δν in bins.
        delay: τ in records.
        half: taps on each side.
        taps: (2, 2 half + 1) receives real and imaginary parts.
    """
    rate = 2.0 * pi * linewidth
    drift = rate * delay
    loss = exp(-drift)
    # The record ends: correlations over the delay lose a little of it.
    overlap = max(0.0, 1.0 - delay / 3.0)
    for m in range(half + 1):
        omega = 2.0 * pi * m
        both, pseudo = _line_powers(rate, drift, loss, omega, delay)
        in_phase = sqrt(max(0.0, 0.5 * overlap * (both + pseudo)))
        quadrature = sqrt(max(0.0, 0.5 * overlap * (both - pseudo)))
        u_re, u_im = 0.0, 0.0
        if in_phase > 0.02 * quadrature:
            u_re, u_im = complex_normal(seed, shot, beam, purpose, first_index + 2 * m)
        v_re, v_im = complex_normal(seed, shot, beam, purpose, first_index + 2 * m + 1)
        if m == 0:
            taps[0, half] = exp(-0.5 * drift) + in_phase * u_re * sqrt(2.0)
            taps[1, half] = quadrature * v_re * sqrt(2.0)
        else:
            taps[0, half + m] = in_phase * u_re + quadrature * v_re
            taps[1, half + m] = in_phase * u_im + quadrature * v_im
            taps[0, half - m] = in_phase * u_re - quadrature * v_re
            taps[1, half - m] = -in_phase * u_im + quadrature * v_im


@kernel
def _line_powers(rate: float, drift: float, loss: float, omega: float, delay: float) -> tuple[float, float]:
    """P and Q of `line_taps` at one angular frequency."""
    if drift < 1e-3:
        # The triangle's own transform; the two forms below cancel to it.
        sinc = 1.0 if omega == 0.0 else sin(0.5 * omega * delay) / (0.5 * omega * delay)
        power = drift * delay * sinc * sinc
        return power * (1.0 - 0.5 * drift), -power * (1.0 - 1.5 * drift)
    cosine, sine = cos(omega * delay), sin(omega * delay)
    bottom = rate * rate + omega * omega
    flat = delay if omega == 0.0 else sine / omega
    up = (rate - loss * (rate * cosine - omega * sine)) / bottom - loss * flat
    down = (-loss * loss * rate + loss * (rate * cosine + omega * sine)) / bottom - loss * flat
    return 2.0 * up, 2.0 * down


@kernel
def gaussian_line_taps(
    linewidth: float,
    seed: np.uint64,
    shot: int,
    beam: int,
    purpose: int,
    first_index: int,
    half: int,
    taps: FloatArray,
) -> None:
    """Draw taps of the published simulation's line: its power is spread over bins as a Gaussian, whatever the delay.

    The central bin's share stays coherent; the others' are circular Gaussian numbers.

    Args:
        linewidth: full width at half maximum in bins.
        half: taps on each side.
        taps: (2, 2 half + 1) receives real and imaginary parts.
    """
    scale = max(linewidth / sqrt(8.0 * log(2.0)), 1e-9) * sqrt(2.0)
    for m in range(-half, half + 1):
        share = sqrt(0.5 * (erf((m + 0.5) / scale) - erf((m - 0.5) / scale)))
        x, y = complex_normal(seed, shot, beam, purpose, first_index + half + m) if m != 0 else (1.0, 0.0)
        taps[0, half + m], taps[1, half + m] = share * x, share * y


@kernel(fastmath=FAST)
def convolve_taps(first: FloatArray, second: FloatArray, half: int, result: FloatArray) -> None:
    """The taps of a product of two factors, cut off at `half` on each side; arrays (2, 2 half + 1 or more)."""
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

    Bins outside the intervals laid count as empty, and the images of tones within `half` bins of 0 and N/2 are
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
        # Zeros on both sides, and whole vectors: so all taps are one loop each, without ends.
        width = -(-(stop - start) // _LANES) * _LANES
        scratch[:, : width + 2 * half] = 0.0
        for j in range(stop - start):
            from_re[half + j], from_im[half + j] = bins[0, start + j], bins[1, start + j]
        for m in range(-half, half + 1):
            # A folded tone has the complex conjugate factor, whose taps are conjugate and in reverse order. Bins as
            # `spectrum` refers them to the centre change sign from one to the next, and so do the taps.
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
