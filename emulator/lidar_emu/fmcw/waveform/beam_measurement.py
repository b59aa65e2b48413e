"""Measurement of one beam from samples: three records, their targets, range and closing speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lidar_emu.fmcw.returns import Returns
from lidar_emu.fmcw.waveform.analog_receiver import (
    FLAT,
    AnalogResponse,
    Digitiser,
    draw_noise,
    receive_record,
)
from lidar_emu.fmcw.waveform.beam_result import to_beam_result
from lidar_emu.fmcw.waveform.detection import Targets, find_targets, transform, window_noise_power
from lidar_emu.fmcw.waveform.laser_phase_noise import draw_drift
from lidar_emu.fmcw.waveform.record_samples import Beamlets, ComplexArray, Segment, frequency_plan
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Waveform

_BLOCK_SAMPLES = 2**23
"""Samples of noise and spectra held at once."""


@dataclass(frozen=True)
class ScattererPatches:
    """The scatterer patches of one beam, at the measurement's validity."""

    range_m: FloatArray
    """(n,)"""
    closing_speed_mps: FloatArray
    """(n,)"""
    weight: ComplexArray
    """Broadcast to (records, 3, n): amplitude and phase of each at the centre of each segment's record. The leading
    axis is of measurements of the same geometry, each with its own weights and its own noise."""
    range_rate_mps: float | FloatArray | None = None
    """Range rate of the beam's axis along the ground, between segments; None: minus the closing speed."""
    closing_acceleration_mps2: float = 0.0
    """Along the moving beam, from segment to segment."""
    smear_acceleration_mps2: float | None = None
    """Acceleration of a point of the ground, within a record; None: as between segments."""

    def beamlets(self, segment: Segment, weight: ComplexArray) -> Beamlets:
        """The patches at the centre of one segment's record, with weights (..., n) there."""
        range_rate_mps = -self.closing_speed_mps if self.range_rate_mps is None else self.range_rate_mps
        smear_mps2 = self.smear_acceleration_mps2
        return Beamlets(
            self.range_m + range_rate_mps * segment.centre_s,
            self.closing_speed_mps + self.closing_acceleration_mps2 * segment.centre_s,
            self.closing_acceleration_mps2 if smear_mps2 is None else smear_mps2,
            weight,
        )


@dataclass(frozen=True)
class WaveformMeasurement(Returns):
    """The report of one beam, (records,), with the targets and spectra that it comes from."""

    targets: tuple[Targets, Targets, Targets]
    """Targets of up-chirp, constant segment and down-chirp."""
    noise_power: FloatArray
    """() or (N/2 + 1,): mean power of noise in a bin under the window of detection, as the detector knows it."""
    threshold: FloatArray
    """In the same shape: the power that a detected bin exceeds."""
    bins: ComplexArray | None
    """(records, 3, N/2 + 1) under the window of detection, if asked for."""


def measure_waveform(
    waveform: Waveform,
    detection: Detection,
    footprint: ScattererPatches,
    *,
    response: AnalogResponse = FLAT,
    rng: np.random.Generator | None = None,
    noise_share: float = 1.0,
    digitiser: Digitiser | None = None,
    noise_level: float | FloatArray = 1.0,
    edges: bool = False,
    keep_bins: bool = False,
) -> WaveformMeasurement:
    """Measure one beam, as many times as the footprint's weights have records.

    Args:
        waveform: the laser's frequency plan, its line and its records.
        detection: window, false alarms, groups, `bin` or `hann` peaks and the combination.
        footprint: what returns light. Weights are amplitudes whose square is the bin SNR ahead of the poles.
        response: the receiver's poles.
        rng: draws the noise and the laser's line; None leaves both out.
        noise_share: power of the noise ahead of the poles, in the unit of the weights' squares.
        digitiser: None is ideal.
        noise_level: mean power of the noise in a rectangular bin as the detector knows it, one for all bins or
            (N/2 + 1,).
        edges: echoes of the segment before are seen as such; see `phase_cycles`.
        keep_bins: return the bins.

    Raises:
        ValueError: the detection averages spectra, accepts fewer than three segments or has another estimator of
            peaks, or the line is not that of a homodyne receiver.
    """
    estimator = _estimator(waveform, detection)
    count = waveform.fft_length
    weight = np.asarray(footprint.weight, dtype=complex)
    records = weight.shape[0] if weight.ndim == 3 else 1
    weight = np.broadcast_to(weight, (records, 3, footprint.range_m.size))
    level = np.asarray(noise_level, dtype=float)
    windowed_level = level * window_noise_power(detection.window, count)
    threshold = windowed_level * -detection.log_false_alarm_per_bin(count)

    # Of its own, so that what is drawn does not depend on the blocks.
    line_rng = rng.spawn(1)[0] if rng is not None and waveform.linewidth_hz > 0.0 else None
    kept = np.empty((records, 3, count // 2 + 1), dtype=complex) if keep_bins else None
    found: list[Targets] = []
    block = max(1, _BLOCK_SAMPLES // count)
    for s, segment in enumerate(frequency_plan(waveform)):
        parts: list[Targets] = []
        for first in range(0, records, block):
            rows = slice(first, first + block)
            beamlets = footprint.beamlets(segment, weight[rows, s])
            light = receive_record(waveform, segment, beamlets, response, edges)
            if line_rng is not None:
                delay_s = 2.0 * float(beamlets.range_m[0]) / SPEED_OF_LIGHT_MPS
                drift = draw_drift(line_rng, len(light), waveform, delay_s)
                light *= drift if segment.beat_sign > 0 else drift.conj()
            samples = np.ascontiguousarray(light.real)
            if rng is not None:
                samples += np.sqrt(noise_share) * draw_noise(rng, len(samples), waveform, response)
            if digitiser is not None:
                samples = digitiser.digitise(samples)
            bins = transform(samples, detection.window)
            parts.append(find_targets(samples, bins, threshold, detection.group_fraction, estimator, level))
            if kept is not None:
                kept[rows, s] = bins
        found.append(Targets(*(np.concatenate(column) for column in zip(*parts, strict=True))))
    targets = found[0], found[1], found[2]
    concluded = to_beam_result(waveform, detection, targets, windowed_level)
    return WaveformMeasurement(
        **vars(concluded), targets=targets, noise_power=windowed_level, threshold=threshold, bins=kept
    )


def _estimator(waveform: Waveform, detection: Detection) -> Literal["bin", "hann"]:
    """Estimator of peaks, for an instrument that this level supports."""
    if detection.looks != 1 or detection.rule != "all_three":
        raise ValueError("level waveform: allowed are one look and rule all_three")
    if waveform.linewidth_model != "homodyne" and waveform.linewidth_hz > 0.0:
        raise ValueError(f"level waveform: linewidth_model {waveform.linewidth_model}; allowed: homodyne")
    if detection.peak not in ("bin", "hann"):
        raise ValueError(f"level waveform: peak {detection.peak}; allowed: bin, hann")
    return detection.peak
