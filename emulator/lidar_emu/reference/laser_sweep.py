"""The laser over a cycle: its three segments, and its phase noise in samples: the phase now less that at emission."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import ComplexArray, FloatArray
from lidar_emu.numerics.random_streams import SWEEP, WHOLE_SHOT, generator
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Waveform

_FLICKER_RECORDS = 8
"""Records over which 1/f noise is synthesised: slower parts change the frequency within a record by 1 % of its rms."""


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


def record_times(waveform: Waveform) -> FloatArray:
    """Times (N,) of the samples from the record's centre, in seconds: half a step to each side of it, and so on."""
    count = waveform.fft_length
    return np.asarray((np.arange(count) - (count - 1) / 2) / waveform.sample_rate_hz, dtype=float)


def ripple_drift(
    waveform: Waveform, delay_s: float, turns: FloatArray | float, time_s: FloatArray
) -> ComplexArray:
    """Compute exp(j[φ(t) - φ(t - τ)]) in a chirp with a periodic deviation of its frequency.

    Args:
        waveform: amplitude and frequency of the deviation.
        delay_s: delay τ, constant within the record.
        turns: phase of the deviation at the record's centre, in turns.
        time_s: times t from the record's centre; the result has their shape, broadcast with `turns`.
    """

    def phase(at_s: FloatArray) -> FloatArray:
        # The integral of 2πA sin(2πft).
        turn = 2.0 * np.pi * (waveform.ripple_frequency_hz * at_s + turns)
        return np.asarray(-waveform.ripple_hz / waveform.ripple_frequency_hz * np.cos(turn))

    return np.asarray(np.exp(1j * (phase(time_s) - phase(time_s - delay_s))))


def has_phase_noise(waveform: Waveform) -> bool:
    """Whether the laser's phase is noisy."""
    return waveform.linewidth_hz > 0.0 or waveform.flicker_hz2 > 0.0


def laser_generator(model: ReceiverModel, seed: int, shot: int, beam: int) -> np.random.Generator:
    """Random generator of the laser's sweep; beams that fire together share its numbers."""
    cycle = beam if model.sweep_scatter.per_beam else WHOLE_SHOT
    return generator(seed, shot, cycle, int(SWEEP))


def draw_drift(
    rng: np.random.Generator,
    records: int,
    waveform: Waveform,
    delay_s: float,
    laser_rng: np.random.Generator | None = None,
) -> ComplexArray:
    """Draw exp(j[φ(t) - φ(t - τ)]) over records of a laser with a Lorentzian line and 1/f noise, (records, N).

    Args:
        rng: random generator of the white frequency noise.
        delay_s: delay τ, constant within the record.
        laser_rng: random generator of the 1/f noise; None leaves it out.
    """
    drift = np.zeros((records, waveform.fft_length))
    if waveform.linewidth_hz > 0.0:
        drift += _white_drift(rng, records, waveform, delay_s)
    if waveform.flicker_hz2 > 0.0 and laser_rng is not None:
        drift += _flicker_drift(laser_rng, records, waveform, delay_s)
    result: ComplexArray = np.exp(1j * drift)
    return result


def _white_drift(rng: np.random.Generator, records: int, waveform: Waveform, delay_s: float) -> FloatArray:
    """Draw φ(t) - φ(t - τ) of white frequency noise, (records, N).

    It makes φ a random walk of variance 2π Δν t. Each step from sample to sample is drawn in two parts, so that the
    walk is known at the times of emission, which lie between the samples.
    """
    whole, part = divmod(delay_s * waveform.sample_rate_hz, 1.0)
    ahead, count = int(whole) + 1, waveform.fft_length
    deviation = np.sqrt(2.0 * np.pi * waveform.linewidth_hz / waveform.sample_rate_hz)
    steps = rng.standard_normal((records, ahead + count, 2))
    steps *= deviation * np.sqrt([1.0 - part, part])
    left, sampled = np.moveaxis(np.cumsum(steps.reshape(records, -1), axis=1).reshape(steps.shape), -1, 0)
    drift: FloatArray = sampled[:, ahead:] - left[:, ahead - int(whole) : ahead - int(whole) + count]
    return drift


def _flicker_drift(rng: np.random.Generator, records: int, waveform: Waveform, delay_s: float) -> FloatArray:
    """Draw φ(t) - φ(t - τ) of frequency noise of the one-sided density k/f, (records, N), as a Fourier series.

    The series covers several records; each of its terms is delayed exactly.
    """
    count = waveform.fft_length
    whole = _FLICKER_RECORDS * count
    frequency_hz = np.fft.rfftfreq(whole, 1.0 / waveform.sample_rate_hz)[1:]
    # A term's variance is the density times the step of the frequency, which is the lowest frequency.
    deviation_hz = np.sqrt(waveform.flicker_hz2 / frequency_hz * frequency_hz[0])
    deviation_hz = deviation_hz * rng.standard_normal((records, 2, frequency_hz.size))
    phase = (deviation_hz[:, 0] + 1j * deviation_hz[:, 1]) / frequency_hz
    spectrum = np.zeros((records, frequency_hz.size + 1), dtype=complex)
    spectrum[:, 1:] = 0.5 * whole * phase * -np.expm1(-2j * np.pi * frequency_hz * delay_s)
    drift: FloatArray = np.fft.irfft(spectrum, whole)[:, :count]
    return drift
