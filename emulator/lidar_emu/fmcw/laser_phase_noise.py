"""Laser phase noise: effect of the laser's linewidth on a beat over the echo's delay, as a filter over bins."""

from __future__ import annotations

from math import cos, erf, exp, log, pi, sin, sqrt
from typing import Any

from lidar_emu.fmcw.peak_interpolation import EFFICIENCY
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.philox import complex_normal
from lidar_emu.numerics.random_streams import LINE


@kernel
def line_variance(model: ReceiverModel, range_m: float) -> float:
    """Variance in bins² of a beat's frequency from the laser's white frequency noise over the delay, 6Δν τ²/π."""
    delay = model.delay_per_m * range_m
    return 6.0 * model.linewidth_bins / pi * delay * delay if model.homodyne_line else 0.0


@kernel
def line_share(model: ReceiverModel, range_m: float) -> float:
    """Fraction of the echo's power that the linewidth leaves in its central bin."""
    if model.homodyne_line or model.linewidth_bins == 0.0:
        return exp(-phase_drift(model, range_m))
    return erf(0.5 * sqrt(4.0 * log(2.0)) / model.linewidth_bins)


@kernel
def phase_drift(model: ReceiverModel, range_m: float) -> float:
    """Variance of the laser's phase drift within the echo's delay."""
    return 2.0 * pi * model.linewidth_bins * model.delay_per_m * range_m


@kernel
def line_matters(model: ReceiverModel, range_m: float, left_out_bin2: float) -> bool:
    """Whether the line scatters a beat by more than `left_out_bin2`, or changes the echo's power."""
    if model.linewidth_bins == 0.0 or not model.homodyne_line:
        return model.linewidth_bins > 0.0
    scattered = EFFICIENCY[model.peak_method] * line_variance(model, range_m) > left_out_bin2
    return scattered or phase_drift(model, range_m) > model.least_line_drift


@kernel
def line_taps(
    linewidth: float,
    delay: float,
    beam: Any,
    first_index: int,
    half: int,
    taps: FloatArray,
) -> None:
    """Draw taps of exp(jΔφ), where Δφ is the phase drift of a Lorentzian laser within the echo's delay.

    White frequency noise gives Δφ the variance x = 2π Δν τ and a triangular correlation of length τ. With a = 2πΔν
    the power of tap m and the pseudo-power E[c_m c_-m] are, at ω = 2πm (times and frequencies in records and bins),

        P = 2 (a - e^-x (a cos ωτ - ω sin ωτ))/(a² + ω²) - 2 e^-x sin(ωτ)/ω,
        Q = 2 e^-x (a cos ωτ + ω sin ωτ - a e^-x)/(a² + ω²) - 2 e^-x sin(ωτ)/ω,

    the transforms of e^-x (e^±R - 1). P is the pedestal of the self-homodyne line (Richter et al., IEEE J. Quantum
    Electron. 22, 1986). The taps are drawn as Gaussian. Where x is small, Q = -P: phase noise alone.

    Args:
        linewidth: Δν in bins.
        delay: τ in records.
        beam: record of the beam, `workspace.BEAM`.
        first_index: index of the first random number.
        half: taps on each side.
        taps: (2, 2 half + 1) receives real and imaginary parts.
    """
    rate = 2.0 * pi * linewidth
    drift = rate * delay
    loss = exp(-drift)
    # The record is finite: correlations over the delay lose a little at its ends.
    overlap = max(0.0, 1.0 - delay / 3.0)
    for m in range(half + 1):
        omega = 2.0 * pi * m
        both, pseudo = _line_powers(rate, drift, loss, omega, delay)
        in_phase = sqrt(max(0.0, 0.5 * overlap * (both + pseudo)))
        quadrature = sqrt(max(0.0, 0.5 * overlap * (both - pseudo)))
        u_re, u_im = 0.0, 0.0
        if in_phase > 0.02 * quadrature:
            u_re, u_im = complex_normal(beam.seed, beam.shot, beam.beam, LINE, first_index + 2 * m)
        v_re, v_im = complex_normal(beam.seed, beam.shot, beam.beam, LINE, first_index + 2 * m + 1)
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
        # The transform of the triangle itself; the two forms below cancel to it.
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
    beam: Any,
    first_index: int,
    half: int,
    taps: FloatArray,
) -> None:
    """Draw taps of the line in the published simulation: its power is spread over bins as a Gaussian, for any delay.

    The fraction in the central bin stays coherent; the other taps are circular Gaussian numbers.

    Args:
        linewidth: full width at half maximum in bins.
        beam: record of the beam, `workspace.BEAM`.
        first_index: index of the first random number.
        half: taps on each side.
        taps: (2, 2 half + 1) receives real and imaginary parts.
    """
    scale = max(linewidth / sqrt(8.0 * log(2.0)), 1e-9) * sqrt(2.0)
    for m in range(-half, half + 1):
        share = sqrt(0.5 * (erf((m + 0.5) / scale) - erf((m - 0.5) / scale)))
        x, y = (
            complex_normal(beam.seed, beam.shot, beam.beam, LINE, first_index + half + m)
            if m != 0
            else (1.0, 0.0)
        )
        taps[0, half + m], taps[1, half + m] = share * x, share * y
