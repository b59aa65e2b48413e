"""Measurement of one beam from samples: three records, their targets, range and closing speed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lidar_emu.fmcw.residual_limit import ResidualLimit
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
from lidar_emu.fmcw.waveform.laser_phase_noise import draw_drift, has_phase_noise, ripple_drift
from lidar_emu.fmcw.waveform.record_samples import (
    Beamlets,
    ComplexArray,
    Segment,
    draw_frequency_plan,
    frequency_plan,
    record_times,
)
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Waveform

OwnTargets = Callable[[int, FloatArray, ComplexArray, FloatArray, FloatArray], Targets]

_BLOCK_SAMPLES = 2**23
"""Samples of noise and spectra that are held in memory at once."""


@dataclass(frozen=True)
class ScattererPatches:
    """The scatterer patches of one beam, at the time of validity."""

    range_m: FloatArray
    """(n,) Ranges."""
    closing_speed_mps: FloatArray
    """(n,) Closing speeds."""
    weight: ComplexArray
    """(records, 3, n) Amplitude and phase of each patch at the centre of each segment's record, broadcast. The leading
    axis is over measurements of the same geometry, each with its own weights and noise."""
    range_rate_mps: float | FloatArray | None = None
    """Range rate of the beam's axis along the ground, between segments; None: minus the closing speed."""
    closing_acceleration_mps2: float = 0.0
    """Acceleration along the moving beam."""
    closing_jerk_mps3: float = 0.0
    """Rate of the acceleration along the moving beam, from segment to segment."""
    range_curvature_mps2: float = 0.0
    """Rate of the range rate, from segment to segment."""
    offset_hz: FloatArray | None = None
    """(n,) Frequency that adds to each patch's beat, and is subtracted in the up-chirp (`fmcw.speckle`); None:
    0."""

    def beamlets(self, segment: Segment, weight: ComplexArray) -> Beamlets:
        """Patches at the centre of one segment's record, with weights (..., n) there."""
        range_rate_mps = -self.closing_speed_mps if self.range_rate_mps is None else self.range_rate_mps
        time_s = segment.centre_s
        return Beamlets(
            self.range_m + (range_rate_mps + 0.5 * self.range_curvature_mps2 * time_s) * time_s,
            self.closing_speed_mps
            + (self.closing_acceleration_mps2 + 0.5 * self.closing_jerk_mps3 * time_s) * time_s,
            self.closing_acceleration_mps2,
            weight,
            None if self.offset_hz is None else -segment.beat_sign * self.offset_hz,
        )


@dataclass(frozen=True)
class WaveformMeasurement(Returns):
    """Report of one beam, (records,), with the targets and spectra that it derives from."""

    targets: tuple[Targets, Targets, Targets]
    """Targets of up-chirp, constant segment and down-chirp."""
    noise_power: FloatArray
    """() or (N/2 + 1,): mean noise power in a bin with the window of detection, as the detector assumes it."""
    threshold: FloatArray
    """Power that a detected bin exceeds, in the same shape."""
    bins: ComplexArray | None
    """(records, 3, N/2 + 1) Bins with the window of detection, if requested."""


def measure_waveform(
    waveform: Waveform,
    detection: Detection,
    footprint: ScattererPatches,
    *,
    response: AnalogResponse = FLAT,
    rng: np.random.Generator | None = None,
    laser_rng: np.random.Generator | None = None,
    reflection: ScattererPatches | None = None,
    noise_share: float = 1.0,
    digitiser: Digitiser | None = None,
    noise_level: float | FloatArray = 1.0,
    residual_limit: ResidualLimit | None = None,
    edges: bool = False,
    keep_bins: bool = False,
    own_targets: OwnTargets | None = None,
) -> WaveformMeasurement:
    """Measure one beam, once for each record of the footprint's weights.

    Args:
        waveform: frequency plan, linewidth and records of the laser.
        detection: window, false alarms, groups, `bin` or `hann` peaks and the combination.
        footprint: scatterer patches; the squares of their weights are bin SNRs ahead of the poles.
        response: the receiver's poles.
        rng: random generator of noise and of the phase by the linewidth; None leaves both out.
        laser_rng: random generator of slopes, which all measurements share, of ripple and of 1/f noise; None leaves
            them out.
        reflection: light that the optics reflect, without phase noise of the laser; None: none.
        noise_share: power of the white noise ahead of the poles, relative to the squares of the weights.
        digitiser: None: ideal.
        noise_level: mean noise power in a rectangular bin as the detector assumes it, one for all bins or (N/2 + 1,).
        residual_limit: limit of the residual, which the published detector does not check; None: none.
        edges: whether echoes of the preceding segment keep their own frequency; see `phase_cycles`.
        keep_bins: whether to return the bins.
        own_targets: finds the targets of a single record instead of `find_targets`, from the number of its segment,
            its samples (1, N), bins (1, N/2 + 1), mean noise power of a windowed bin and threshold.

    Raises:
        ValueError: the detection averages spectra, accepts fewer than three segments, or uses an unsupported peak
            estimator.
    """
    estimator = _estimator(detection)
    count = waveform.fft_length
    weight = np.asarray(footprint.weight, dtype=complex)
    records = weight.shape[0] if weight.ndim == 3 else 1
    weight = np.broadcast_to(weight, (records, 3, footprint.range_m.size))
    level = np.asarray(noise_level, dtype=float)
    window_noise = window_noise_power(detection.window, count)
    windowed_level = level * window_noise
    threshold = windowed_level * -detection.log_false_alarm_per_bin(count)

    # A generator of its own, so that random numbers do not depend on the blocks.
    line_rng = rng.spawn(1)[0] if rng is not None and has_phase_noise(waveform) else None
    plan = frequency_plan(waveform) if laser_rng is None else draw_frequency_plan(laser_rng, waveform)
    kept = np.empty((records, 3, count // 2 + 1), dtype=complex) if keep_bins else None
    found: list[Targets] = []
    block = max(1, _BLOCK_SAMPLES // count)
    for s, segment in enumerate(plan):
        parts: list[Targets] = []
        for first in range(0, records, block):
            rows = slice(first, first + block)
            beamlets = footprint.beamlets(segment, weight[rows, s])
            light = receive_record(waveform, segment, beamlets, response, edges)
            if line_rng is not None:
                delay_s = 2.0 * float(beamlets.range_m[0]) / SPEED_OF_LIGHT_MPS
                drift = draw_drift(line_rng, len(light), waveform, delay_s, laser_rng)
                light *= drift if segment.beat_sign > 0 else drift.conj()
            if laser_rng is not None and waveform.ripple_hz > 0.0 and segment.slope_hz_per_s != 0.0:
                delay_s = 2.0 * float(beamlets.range_m[0]) / SPEED_OF_LIGHT_MPS
                turns = laser_rng.random((len(light), 1))
                ripple = ripple_drift(waveform, delay_s, turns, record_times(waveform))
                light = light * (ripple if segment.beat_sign > 0 else ripple.conj())
            if reflection is not None:
                steady = reflection.beamlets(segment, np.asarray(reflection.weight)[..., s, :])
                light = light + receive_record(waveform, segment, steady, response)
            samples = np.ascontiguousarray(light.real)
            if rng is not None:
                samples += np.sqrt(noise_share) * draw_noise(rng, len(samples), waveform, response)
            if digitiser is not None:
                samples = digitiser.digitise(samples)
            bins = transform(samples, detection.window)
            if kept is not None:
                kept[rows, s] = bins
            if own_targets is not None:
                parts.append(own_targets(s, samples, bins, windowed_level, threshold))
                continue
            hann_bins = transform(samples, "hann")
            parts.append(
                find_targets(
                    bins,
                    hann_bins,
                    estimator == "bin",
                    threshold,
                    detection.group_fraction,
                    level,
                    window_noise,
                    detection.lowest_beat_hz / waveform.bin_width_hz,
                )
            )
        found.append(Targets(*(np.concatenate(column) for column in zip(*parts, strict=True))))
    targets = found[0], found[1], found[2]
    concluded = to_beam_result(waveform, detection, targets, windowed_level, residual_limit)
    return WaveformMeasurement(
        **vars(concluded), targets=targets, noise_power=windowed_level, threshold=threshold, bins=kept
    )


def _estimator(detection: Detection) -> Literal["bin", "hann"]:
    """Peak estimator, for an instrument that this level supports."""
    if detection.looks != 1 or detection.rule != "all_three":
        raise ValueError("level waveform: allowed are one look and rule all_three")
    if detection.peak not in ("bin", "hann"):
        raise ValueError(f"level waveform: peak {detection.peak}; must be bin, hann")
    return detection.peak
