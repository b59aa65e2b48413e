"""Random errors of the laser's sweep: a rate that differs from the nominal one moves a beat in proportion to the delay.

Chirps have a slope error of their own, and 1/f noise changes the laser's frequency during every record. Both move all
beats of a beam alike: in a chirp as another range would, in the constant segment as another closing speed.

A deviation A sin(2πf_m t) of the laser's frequency modulates the phase of a beat of the delay τ by

    m sin(2πf_m (t - τ/2)),   m = (2A/f_m) sin(πf_m τ):

Bessel side lines J_n(m) at n f_m to either side. Where f_m is below a bin they move the peak instead.
"""

from __future__ import annotations

from math import cos, floor, pi, sin, sqrt

import numpy as np

from lidar_emu.numerics.arrays import SingleArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.numerics.random_streams import RIPPLE, SWEEP, WHOLE_SHOT, complex_normal, uniform_pair
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.records import Beam


@kernel
def sweep_error(
    model: ReceiverModel, beam: Beam, segment: int, look: int, range_m: float
) -> tuple[float, float]:
    """Draw the apparent changes of range in metres and of closing speed in metres per second in one record.

    Args:
        range_m: range of the echo.
    """
    variance = sweep_variance(model, segment, range_m, beam.left_out_bin2)
    if variance == 0.0:
        return 0.0, 0.0
    laser = beam.beam if model.sweep_scatter.per_beam else WHOLE_SHOT
    x, _ = complex_normal(beam.seed, beam.shot, laser, SWEEP, segment + 3 * look)
    error_bin = sqrt(2.0 * variance) * x
    if segment == 1:
        return 0.0, error_bin * model.speed_bin_mps
    return error_bin / model.beat_bin_per_m, 0.0


@kernel
def sweep_variance(model: ReceiverModel, segment: int, range_m: float, left_out_bin2: float) -> float:
    """Variance of a beat in bins squared; 0 where it is at most `left_out_bin2`."""
    scatter = model.sweep_scatter
    if segment == 1:
        deviation = scatter.speed_mps_per_m * range_m / model.speed_bin_mps
    else:
        deviation = scatter.range_per_m * range_m * model.beat_bin_per_m
    variance: float = deviation * deviation
    return variance if variance > left_out_bin2 else 0.0


@kernel
def ripple_index(model: ReceiverModel, range_m: float, left_out_bin2: float) -> float:
    """Modulation index m of a beat; 0 where it is left out, since it moves the beat by less than the variance
    `left_out_bin2`."""
    if model.ripple.largest_index == 0.0:
        return 0.0
    turns = model.ripple.frequency_bin * model.delay_per_m * range_m
    index: float = model.ripple.largest_index * abs(sin(pi * turns))
    moved_bin2 = 0.5 * (index * model.ripple.pull_bin) ** 2
    return index if index > model.ripple.least_index or moved_bin2 > left_out_bin2 else 0.0


@kernel
def ripple_reach(model: ReceiverModel) -> float:
    """Distance of the outermost side line in whole bins."""
    return float(floor(model.ripple.orders * model.ripple.frequency_bin) + 1.0)


@kernel
def ripple_taps(
    model: ReceiverModel, beam: Beam, segment: int, look: int, index: float, half: int, taps: SingleArray
) -> None:
    """Set the taps of exp(jm sin(2πf_m t + φ)), Σ J_n(m) exp(jnφ) sinc(n f_m T_rec - k), with a random phase φ.

    The phase is drawn for each record; beams that fire together share it.

    Args:
        index: modulation index.
        half: taps on each side.
        taps: (2, 2 half + 1) receives real and imaginary parts.
    """
    laser = beam.beam if model.sweep_scatter.per_beam else WHOLE_SHOT
    turn, _ = uniform_pair(beam.seed, beam.shot, laser, RIPPLE, segment + 3 * look)
    taps[:, : 2 * half + 1] = 0.0
    orders = min(int(model.ripple.orders), int(index + 2.0 * index ** (1.0 / 3.0)) + 2)
    for n in range(-orders, orders + 1):
        amplitude = _bessel(n, index)
        re, im = amplitude * cos(2.0 * pi * n * turn), amplitude * sin(2.0 * pi * n * turn)
        for m in range(2 * half + 1):
            away = n * model.ripple.frequency_bin - (m - half)
            share = 1.0 if abs(away) < 1e-9 else np.sin(pi * away) / (pi * away)
            taps[0, m] += np.float32(re * share)
            taps[1, m] += np.float32(im * share)


@kernel
def _bessel(order: int, x: float) -> float:
    """Bessel function of the first kind: the mean of cos(nθ - x sin θ), exact to rounding with these nodes."""
    nodes = 2 * (abs(order) + int(x)) + 32
    total = 0.0
    for i in range(nodes):
        angle = 2.0 * pi * i / nodes
        total += cos(order * angle - x * sin(angle))
    return total / nodes
