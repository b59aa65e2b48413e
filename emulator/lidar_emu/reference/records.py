"""Bins of a record of scatterers: from an envelope around their frequencies, or from all samples.

The envelope, with the middle of the scatterers' frequencies removed, is sampled in the middle of each of M equal parts
of the record and transformed. Compared with all samples, a tone has a relative error of (π δ / M)² / 6 in a bin δ away
from it. Each scatterer has the gain of the poles at its own frequency, and the noise is drawn in all bins.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import ComplexArray, FloatArray, IntArray
from lidar_emu.receiver.whole_spectrum import WindowName, transform, window_at, windowed
from lidar_emu.reference.analog_receiver import AnalogResponse, Digitiser, Poles, draw_noise
from lidar_emu.reference.laser_sweep import draw_drift, has_phase_noise, record_times, ripple_drift
from lidar_emu.reference.record_light import RecordLight
from lidar_emu.scenario.instrument import Waveform


class RecordReceiver(NamedTuple):
    """Poles, noise and digitiser; powers are relative to the noise as in `reference.analog_receiver`."""

    waveform: Waveform
    response: AnalogResponse
    digitiser: Digitiser | None
    noise_share: float
    """Power of the white noise ahead of the poles."""
    noise_level: FloatArray
    """(N/2 + 1,) Mean noise power in a rectangular bin, of all of it."""


class RecordSpectrum(NamedTuple):
    """A record with all its light and noise."""

    bins: ComplexArray
    """(windows, N/2 + 1)"""
    samples: FloatArray | None
    """(N,) Samples as the digitiser gives them; None where the bins do not come from samples."""


_MARGIN_BINS = 64
"""Bins on both sides of the scatterers' frequencies for the lobes of the window."""

_GROUP_BINS = 128.0
"""Scatterers within this many bins share an envelope."""

_LINE_STEPS = 2**13
"""Steps of the laser's phase noise in a record, at least: their mean over a part of the record is taken."""


def narrowband_bins(
    receiver: RecordReceiver,
    lights: Sequence[RecordLight],
    windows: Sequence[WindowName],
    rng: np.random.Generator,
    laser_rng: np.random.Generator,
) -> RecordSpectrum:
    """Compute the bins (windows, N/2 + 1) of a record: light around its frequencies, and noise in all bins."""
    deviation = np.sqrt(0.5 * receiver.noise_level)
    noise = deviation * rng.standard_normal(2 * len(deviation)).view(complex)
    bins = np.stack([windowed(noise, window) for window in windows])
    for light in lights:
        add_narrowband(receiver, light, windows, bins, rng, laser_rng)
    return RecordSpectrum(bins, None)


def add_narrowband(
    receiver: RecordReceiver,
    light: RecordLight,
    windows: Sequence[WindowName],
    bins: ComplexArray,
    rng: np.random.Generator,
    laser_rng: np.random.Generator,
) -> None:
    """Add the light of scatterers to the bins (windows, N/2 + 1) of a record of real samples."""
    if not len(light.coefficients):
        return
    bin_number = np.floor(light.middle_frequency_hz * receiver.waveform.record_time_s / _GROUP_BINS)
    if np.ptp(bin_number) <= 1.0:
        bin_number[:] = 0.0
    for number in np.unique(bin_number):
        _add_group(receiver, light.chosen(bin_number == number), windows, bins, rng, laser_rng)


def _add_group(
    receiver: RecordReceiver,
    light: RecordLight,
    windows: Sequence[WindowName],
    bins: ComplexArray,
    rng: np.random.Generator,
    laser_rng: np.random.Generator,
) -> None:
    waveform = receiver.waveform
    length, record_s = waveform.fft_length, waveform.record_time_s
    lowest_hz, highest_hz = light.frequencies_hz()
    centre = round(0.5 * (lowest_hz + highest_hz) * record_s)
    width = (highest_hz - lowest_hz) * record_s + 2 * _MARGIN_BINS
    if light.ripple_turns is not None:
        width += 2 * waveform.ripple_orders * waveform.ripple_frequency_hz * record_s
    count = min(length, 2 ** int(np.ceil(np.log2(width))))
    passed = light
    if not receiver.response.flat:
        gain = receiver.response.gain(light.middle_frequency_hz)
        if not gain.all():
            return
        passed = light.times(gain)
    # In records, from the record's centre: each sample is in the middle of its part.
    place = (np.arange(count) - 0.5 * (count - 1)) / count
    envelope = np.zeros(count, dtype=complex)
    passed.shifted(-centre / record_s).add_to(envelope, place[0] * record_s, record_s / count)
    if has_phase_noise(waveform) and not light.steady:
        envelope *= _drift(waveform, light.mean_delay_s, count, rng, laser_rng)
    if light.ripple_turns is not None:
        envelope *= ripple_drift(waveform, light.mean_delay_s, light.ripple_turns, place * record_s)
    # A transform's origin is the first sample, half a step after the record's beginning.
    before = 0.5 - 0.5 / length
    offset = np.arange(count) - count // 2
    turn = offset * (0.5 - 0.5 / count) - (centre + offset) * before
    phasor = np.exp(2j * np.pi * turn) / count
    for row, window in enumerate(windows):
        spectrum = np.fft.fft(envelope * window_at(window, place + before))
        _add_folded(phasor * np.fft.fftshift(spectrum), centre + offset, length, bins[row])


def _drift(
    waveform: Waveform, delay_s: float, count: int, rng: np.random.Generator, laser_rng: np.random.Generator
) -> ComplexArray:
    """Mean of the laser's phase noise over each part of a record, (count,)."""
    steps = max(count, _LINE_STEPS)
    coarse = {"fft_length": steps, "sample_rate_hz": steps / waveform.record_time_s}
    drift = draw_drift(rng, 1, waveform.model_copy(update=coarse), delay_s, laser_rng)[0]
    return np.asarray(drift.reshape(count, -1).mean(axis=1))


def _add_folded(values: ComplexArray, place: IntArray, length: int, bins: ComplexArray) -> None:
    """Add bins of any number, and the conjugate of their images, to the bins 0 to N/2."""
    for number, value in ((place % length, values), (-place % length, values.conj())):
        kept = number <= length // 2
        np.add.at(bins, number[kept], value[kept])


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
) -> RecordSpectrum:
    """Compute the bins (windows, N/2 + 1) of a record from its samples."""
    waveform = receiver.waveform
    parts = []
    for light in lights:
        part, delay_s = received_light(receiver, light), light.mean_delay_s
        if has_phase_noise(waveform) and delay_s > 0.0 and not light.steady:
            part *= draw_drift(rng, 1, waveform, delay_s, laser_rng)[0]
        if light.ripple_turns is not None:
            part *= ripple_drift(waveform, delay_s, light.ripple_turns, record_times(waveform))
        parts.append(part)
    record = np.sum(parts, axis=0)
    samples = record.real + np.sqrt(receiver.noise_share) * draw_noise(rng, 1, waveform, receiver.response)[0]
    if receiver.digitiser is not None:
        samples = receiver.digitiser.digitise(samples)
    return RecordSpectrum(np.stack([transform(samples, window) for window in windows]), samples)


def received_light(receiver: RecordReceiver, light: RecordLight) -> ComplexArray:
    """Light behind the poles at the samples of a record, (N,), without noise."""
    if receiver.response.flat:
        return _light_at(light, record_times(receiver.waveform))
    lowest_hz, highest_hz = light.frequencies_hz()
    poles = Poles(receiver.waveform, receiver.response, max(abs(lowest_hz), abs(highest_hz)))
    return poles.passed(_light_at(light, poles.time_s))


def _light_at(light: RecordLight, time_s: FloatArray) -> ComplexArray:
    total = np.zeros(len(time_s), dtype=complex)
    light.add_to(total, time_s[0], (time_s[-1] - time_s[0]) / (len(time_s) - 1))
    return total
