"""Bins of a record from all of its samples: poles, laser phase noise, noise and digitiser."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lidar_emu.fmcw.waveform.analog_receiver import AnalogResponse, Poles, draw_noise
from lidar_emu.fmcw.waveform.detection import WindowName, transform
from lidar_emu.fmcw.waveform.laser_phase_noise import draw_drift, has_phase_noise, ripple_drift
from lidar_emu.fmcw.waveform.record_samples import ComplexArray, record_times
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scatterers.receiver import RecordReceiver
from lidar_emu.scatterers.record_light import RecordLight
from lidar_emu.scenario.instrument import Waveform


def record_span_s(waveform: Waveform, response: AnalogResponse) -> tuple[float, float]:
    """Time from a record's centre that its light covers, with the run-in of the poles."""
    half_s = 0.5 * waveform.record_time_s
    if response.flat:
        return -half_s, half_s
    # Poles choose their sampling by the light's highest frequency, which does not change the times covered.
    time_s = Poles(waveform, response, 0.0).time_s
    step_s = 1.0 / waveform.sample_rate_hz
    return float(time_s[0]) - step_s, float(time_s[-1]) + step_s


def sampled_bins(
    receiver: RecordReceiver,
    lights: Sequence[RecordLight],
    windows: Sequence[WindowName],
    rng: np.random.Generator,
    laser_rng: np.random.Generator,
) -> ComplexArray:
    """Compute the bins (windows, N/2 + 1) of a record from its samples."""
    waveform = receiver.waveform
    record = np.sum([_modulated_light(receiver, light, rng, laser_rng) for light in lights], axis=0)
    samples = record.real + np.sqrt(receiver.noise_share) * draw_noise(rng, 1, waveform, receiver.response)[0]
    if receiver.digitiser is not None:
        samples = receiver.digitiser.digitise(samples)
    return np.stack([transform(samples, window) for window in windows])


def _modulated_light(
    receiver: RecordReceiver, light: RecordLight, rng: np.random.Generator, laser_rng: np.random.Generator
) -> ComplexArray:
    """Light (N,) behind the poles, with the phase of a laser that is not perfect."""
    waveform, delay_s = receiver.waveform, light.mean_delay_s
    record = received_light(receiver, light)
    if has_phase_noise(waveform) and delay_s > 0.0 and not light.steady:
        record *= draw_drift(rng, 1, waveform, delay_s, laser_rng)[0]
    if light.ripple_turns is not None:
        record *= ripple_drift(waveform, delay_s, light.ripple_turns, record_times(waveform))
    return record


def received_light(receiver: RecordReceiver, light: RecordLight) -> ComplexArray:
    """Light behind the poles at the samples of a record, (N,), without noise."""
    if receiver.response.flat:
        return _light_at(light, record_times(receiver.waveform))
    lowest_hz, highest_hz = light.frequencies_hz()
    poles = Poles(receiver.waveform, receiver.response, max(abs(lowest_hz), abs(highest_hz)))
    return poles.passed(_light_at(light, poles.time_s))


def _light_at(light: RecordLight, time_s: FloatArray) -> ComplexArray:
    """Light at equally spaced times from the record's centre."""
    total = np.zeros(len(time_s), dtype=complex)
    step_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    light.add_to(total, time_s[0], step_s)
    return total
