"""Samples of one segment's record: the laser's phase less its echo's, without any beat frequency.

Phases are in cycles, not radians. At the time u since the start of the segment the laser's phase is φ(u) = f_a u + s
u²/2, and in the preceding segment φ(u) = f_a u + s' u²/2: its frequency is continuous. The echo of a scatterer at range
R(t) was emitted at t - τ(t), τ = 2R/c, so that the detector receives φ(u) - φ(u - τ).

This is about 1e10 cycles, and its change over the record is needed to 1e-9. Therefore only the difference from the
record's centre is computed, in expanded form: with the time x from the centre, u = u_s + x and τ = τ_s + D,

    f_a D + s [τ_s x + D (u - τ_s) - D²/2],     D = -(2/c) (v x + a x²/2),

which is exact and consists of terms in the displacement: none exceeds about 1e4 cycles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Waveform

ComplexArray = NDArray[np.complex128]


class Segment(NamedTuple):
    """One segment of the laser's frequency plan, with the preceding one."""

    start_frequency_hz: float
    slope_hz_per_s: float
    previous_slope_hz_per_s: float
    start_to_centre_s: float
    """Time from the segment's start to the centre of its record, u_s."""
    centre_s: float
    """Time of the record's centre, from the time of validity."""
    beat_sign: int
    """+1 for the up-chirp, -1 otherwise: range and closing speed then give positive beats."""


def frequency_plan(
    waveform: Waveform, slope_error: tuple[float, float] = (0.0, 0.0)
) -> tuple[Segment, Segment, Segment]:
    """Up-chirp, constant frequency c/λ and down-chirp, one after another without a jump.

    The up-chirp ends at c/λ; the down-chirp starts there. The slopes are the laser's actual slopes, with further
    relative errors of the two chirps.
    """
    nominal_hz = SPEED_OF_LIGHT_MPS / waveform.wavelength_m
    slope = waveform.chirp_slope_hz_per_s * (1.0 + waveform.slope_error)
    up, down = (slope * (1.0 + error) for error in slope_error)
    period_s = waveform.segment_time_s
    to_centre_s = period_s - waveform.record_time_s / 2
    return (
        Segment(nominal_hz - up * period_s, up, -slope, to_centre_s, -period_s, 1),
        Segment(nominal_hz, 0.0, up, to_centre_s, 0.0, -1),
        Segment(nominal_hz, -down, 0.0, to_centre_s, period_s, -1),
    )


def draw_frequency_plan(
    laser_rng: np.random.Generator, waveform: Waveform
) -> tuple[Segment, Segment, Segment]:
    """Draw the slopes of the two chirps of one cycle."""
    up, down = waveform.slope_scatter * laser_rng.standard_normal(2)
    return frequency_plan(waveform, (float(up), float(down)))


@dataclass(frozen=True)
class Beamlets:
    """The scatterer patches of one beam at the centre of one record; each stays fixed to the ground within it."""

    range_m: FloatArray
    """(n,) Ranges."""
    closing_speed_mps: FloatArray
    """(n,) Closing speeds."""
    closing_acceleration_mps2: float
    weight: ComplexArray
    """(..., n) Amplitude and phase at the record's centre; leading axes are over records of the same geometry."""
    offset_hz: FloatArray | None = None
    """(n,) Frequency that adds to the beat, for a patch whose speckle changes within the record; None: 0."""


def record_times(waveform: Waveform) -> FloatArray:
    """Times (N,) of the samples from the record's centre, in seconds: half a step to each side of it, and so on."""
    count = waveform.fft_length
    return np.asarray((np.arange(count) - (count - 1) / 2) / waveform.sample_rate_hz, dtype=float)


def phase_cycles(
    segment: Segment,
    range_m: float,
    closing_speed_mps: float,
    closing_acceleration_mps2: float,
    time_s: FloatArray,
    edges: bool,
) -> FloatArray:
    """Phase of the laser less the phase of one scatterer's echo, in cycles, relative to the record's centre.

    Args:
        segment: segment of the frequency plan.
        range_m, closing_speed_mps, closing_acceleration_mps2: values at the record's centre.
        time_s: times from the record's centre.
        edges: whether light emitted before the start of the segment has the phase of the preceding segment; otherwise
            the segment is extended backwards. Delays of more than a whole segment, 45 km with the defaults, are not
            modelled.

    Returns:
        In the shape of `time_s`, with the sign of physics: `Segment.beat_sign` is not applied.
    """
    slope = segment.slope_hz_per_s
    delay_s = 2.0 * range_m / SPEED_OF_LIGHT_MPS
    approach_m = time_s * (closing_speed_mps + 0.5 * closing_acceleration_mps2 * time_s)
    growth_s = -2.0 * approach_m / SPEED_OF_LIGHT_MPS
    since_start_s = segment.start_to_centre_s + time_s
    chirped = delay_s * time_s + growth_s * (since_start_s - delay_s) - 0.5 * growth_s * growth_s
    cycles = segment.start_frequency_hz * growth_s + slope * chirped
    if edges:
        excess = 0.5 * (segment.previous_slope_hz_per_s - slope)
        left_s = since_start_s - (delay_s + growth_s)
        at_centre_s = segment.start_to_centre_s - delay_s
        cycles += excess * (_before(since_start_s) - _before(left_s) + _before(np.asarray(at_centre_s)))
    return cycles


def _before(since_start_s: FloatArray) -> FloatArray:
    """Square of the time until the segment begins, 0 once it has begun."""
    return np.square(np.minimum(since_start_s, 0.0))


def phasor(
    segment: Segment, beamlets: Beamlets, index: int, time_s: FloatArray, edges: bool = False
) -> ComplexArray:
    """exp(±j 2π [Δφ(t) - Δφ(t_s)]) of one beamlet, in the shape of `time_s`, without its weight."""
    cycles = phase_cycles(
        segment,
        float(beamlets.range_m[index]),
        float(beamlets.closing_speed_mps[index]),
        beamlets.closing_acceleration_mps2,
        time_s,
        edges,
    )
    if beamlets.offset_hz is not None:
        cycles += segment.beat_sign * beamlets.offset_hz[index] * time_s
    # Whole cycles are removed before the factor 2π rounds them.
    turn = segment.beat_sign * 2.0 * np.pi * (cycles - np.rint(cycles))
    result: ComplexArray = np.cos(turn) + 1j * np.sin(turn)
    return result


def add_beamlets(beamlets: Beamlets, phasor_of: Callable[[int], ComplexArray], count: int) -> ComplexArray:
    """Σ w_i z_i, (..., count), with the phasor z_i (count,) of beamlet i from `phasor_of`."""
    total = np.zeros((*beamlets.weight.shape[:-1], count), dtype=complex)
    for i in range(beamlets.range_m.size):
        total += beamlets.weight[..., i, None] * phasor_of(i)
    return total


def analytic_record(
    waveform: Waveform, segment: Segment, beamlets: Beamlets, edges: bool = False
) -> ComplexArray:
    """Record of one segment behind a receiver without poles, (..., N), in units of the weights.

    The samples are its real part.
    """
    time_s = record_times(waveform)
    return add_beamlets(beamlets, lambda i: phasor(segment, beamlets, i, time_s, edges), time_s.size)
