"""Laser phase noise in samples: the laser's phase now minus its phase when the echo left."""

from __future__ import annotations

import numpy as np

from lidar_emu.fmcw.waveform.record_samples import ComplexArray
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import Waveform


def draw_drift(rng: np.random.Generator, records: int, waveform: Waveform, delay_s: float) -> ComplexArray:
    """Draw exp(j[φ(t) - φ(t - τ)]) over records of a laser with a Lorentzian line, (records, N).

    White frequency noise makes φ a random walk of variance 2π Δν t. Each step from sample to sample is drawn in two
    parts, so that the walk is known at the times of emission, which lie between the samples.

    Args:
        delay_s: delay τ, constant within the record.
    """
    whole, part = divmod(delay_s * waveform.sample_rate_hz, 1.0)
    ahead, count = int(whole) + 1, waveform.fft_length
    deviation = np.sqrt(2.0 * np.pi * waveform.linewidth_hz / waveform.sample_rate_hz)
    steps = rng.standard_normal((records, ahead + count, 2))
    steps *= deviation * np.sqrt([1.0 - part, part])
    left, sampled = np.moveaxis(np.cumsum(steps.reshape(records, -1), axis=1).reshape(steps.shape), -1, 0)
    drift: FloatArray = sampled[:, ahead:] - left[:, ahead - int(whole) : ahead - int(whole) + count]
    result: ComplexArray = np.exp(1j * drift)
    return result
