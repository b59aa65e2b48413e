"""A measurement from the light of three records: targets, range and closing speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lidar_emu.fmcw.residual_limit import ResidualLimit
from lidar_emu.fmcw.returns import Returns
from lidar_emu.fmcw.waveform.beam_result import to_beam_result
from lidar_emu.fmcw.waveform.detection import WindowName, find_targets, window_noise_power
from lidar_emu.fmcw.waveform.record_samples import ComplexArray
from lidar_emu.scatterers.receiver import RecordReceiver
from lidar_emu.scatterers.record_light import RecordLight
from lidar_emu.scenario.instrument import Detection

RecordBins = Callable[
    [RecordReceiver, Sequence[RecordLight], Sequence[WindowName], np.random.Generator, np.random.Generator],
    ComplexArray,
]
"""Bins (windows, N/2 + 1) of a record with all its light and noise, from random generators of the beam and of the
laser."""


def measure_records(
    detection: Detection,
    receiver: RecordReceiver,
    records: Sequence[Sequence[RecordLight]],
    bins_of: RecordBins,
    rng: np.random.Generator,
    laser_rng: np.random.Generator,
    residual_limit: ResidualLimit | None = None,
) -> Returns:
    """Measure a beam, (1,), from all light of up-chirp, constant segment and down-chirp; see `to_beam_result`."""
    waveform = receiver.waveform
    window_noise = window_noise_power(detection.window, waveform.fft_length)
    level = receiver.noise_level * window_noise
    threshold = level * -detection.log_false_alarm_per_bin(waveform.fft_length)
    windows: list[WindowName] = [detection.window, "hann"]
    found = []
    for lights in records:
        bins = bins_of(receiver, lights, windows, rng, laser_rng)
        found.append(
            find_targets(
                bins[:1],
                bins[1:],
                detection.peak == "bin",
                threshold,
                detection.group_fraction,
                receiver.noise_level,
                window_noise,
                detection.lowest_beat_hz / waveform.bin_width_hz,
            )
        )
    return to_beam_result(waveform, detection, (found[0], found[1], found[2]), level, residual_limit)
