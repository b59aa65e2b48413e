"""What an instrument without noise would report, from the frequency plan in 40 digits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from mpmath import floor, mp, mpf

from lidar_emu.scenario.instrument import Waveform

DIGITS = 40


class BeatTruth(NamedTuple):
    """(cases,) and a last axis; in bins, m and m/s."""

    observed_bin: np.ndarray
    """(cases, 3) Frequencies of up-chirp, constant segment and down-chirp, folded to 0 ... N/2."""
    range_m: np.ndarray
    """(cases, 2) Least and greatest of what any two of the segments say together."""
    speed_mps: np.ndarray
    """(cases, 2) The same of the closing speed, moved by whole λ fs/2 so that it lies within ± λ fs/4."""


def signed_beats_bin(
    waveform: Waveform, range_m: float, speed_mps: float, range_rate_mps: float, acceleration_mps2: float
) -> tuple[mpf, mpf, mpf]:
    """g₊, g₀ and g₋ at the centres of their records.

    The up-chirp ends at c/λ, the down-chirp starts there; range and speed are taken at the record's own time.
    """
    light, wavelength = mpf(299_792_458), mpf(waveform.wavelength_m)
    slope = mpf(waveform.chirp_slope_hz_per_s) * (1 + mpf(waveform.slope_error))
    segment_s, bin_hz = mpf(waveform.segment_time_s), mpf(waveform.sample_rate_hz) / waveform.fft_length
    record_s = 1 / bin_hz
    optical = (light / wavelength - slope * record_s / 2, light / wavelength)
    optical += (light / wavelength - slope * (segment_s - record_s / 2),)
    beats = []
    for s, (frequency, chirp) in enumerate(zip(optical, (-1, 0, 1), strict=True)):
        time_s = (s - 1) * segment_s
        beat = slope * 2 * (mpf(range_m) + mpf(range_rate_mps) * time_s) / light
        doppler = 2 * (mpf(speed_mps) + mpf(acceleration_mps2) * time_s) / light
        sign = -1 if chirp < 0 else 1
        beats.append((abs(chirp) * beat + sign * (frequency + chirp * beat) * doppler) / bin_hz)
    return beats[0], beats[1], beats[2]


def beat_truth(
    waveform: Waveform,
    range_m: np.ndarray,
    speed_mps: np.ndarray,
    range_rate_mps: np.ndarray,
    acceleration_mps2: np.ndarray,
) -> BeatTruth:
    """Truth of (cases,) beams of one beamlet each."""
    tones, ranges, speeds = [], [], []
    length = waveform.fft_length
    with mp.workdps(DIGITS):
        bin_hz = mpf(waveform.sample_rate_hz) / length
        range_bin_m = 299_792_458 * bin_hz / (2 * mpf(waveform.chirp_slope_hz_per_s))
        speed_bin_mps = mpf(waveform.wavelength_m) * bin_hz / 2
        for case in zip(range_m, speed_mps, range_rate_mps, acceleration_mps2, strict=True):
            up, constant, down = signed_beats_bin(waveform, *case)
            tones.append([float(abs(g - length * floor(g / length + 0.5))) for g in (up, constant, down)])
            beats = [(up + down) / 2, up + constant, down - constant]
            dopplers = [constant, (down - up) / 2]
            alias = length * floor(constant / length + mpf(1) / 2)
            ranges.append([float(pick(beats) * range_bin_m) for pick in (min, max)])
            speeds.append([float((pick(dopplers) - alias) * speed_bin_mps) for pick in (min, max)])
    return BeatTruth(np.array(tones), np.array(ranges), np.array(speeds))


def beyond(value: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """How far values (cases,) lie outside their bounds (cases, 2); 0 within, NaN for NaN."""
    return np.maximum(np.maximum(bounds[:, 0] - value, value - bounds[:, 1]), 0.0)
