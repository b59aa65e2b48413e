"""Recovery of the amplifier after overdriven records.

An overdriven record leaves the amplifier with the loss of gain that clipping causes in it (`analog_response.clipping`),
of which exp(-t/τ) remains a time t after the record's end. During the guard, from the end of a record to the beginning
of the next, nothing overdrives the amplifier. Data sheets state how long recovery lasts; that it is exponential is an
assumption. All beams have receivers of their own, and each shot begins with an amplifier that has recovered.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from lidar_emu.fmcw.analog_response import clipping
from lidar_emu.fmcw.beat_tones import record_time_s
from lidar_emu.fmcw.receiver_model import ReceiverModel
from lidar_emu.fmcw.segment_spectrum import others_power, set_record_tones
from lidar_emu.fmcw.volume_light import set_bands
from lidar_emu.fmcw.workspace import Workspace, look_tones
from lidar_emu.numerics.kernels import kernel

_BRIGHTEST = 40.0
"""Limit of an echo's power with speckle over its mean: exceeded with the probability exp(-40)."""

_MOST_LOSS = 1.0 - 1e-6
"""Limit of the loss of gain, 120 dB: a tone remains."""


@kernel
def set_amplifier_gain(model: ReceiverModel, work: Workspace, beam: Any) -> None:
    """Set the gain of the amplifier in each segment of the beam in `work`, mean over looks.

    In a record it is constant, the mean by the window of detection.
    """
    work.amplifier_gain[:] = 1.0
    if not may_overdrive(model, beam.power_w):
        return
    recovery, lost = model.gain_recovery, 0.0
    for look in range(model.looks):
        for segment in range(3):
            lost *= recovery.left_by_guard
            gain = 1.0 - recovery.mean_in_record * lost
            work.amplifier_gain[segment] -= (1.0 - gain) / model.looks
            set_bands(model, beam, segment, record_time_s(model, segment, look))
            tones = look_tones(work, beam, look)
            set_record_tones(model, work, beam, segment, look, tones)
            others = others_power(model, beam, segment)
            clipped, _ = clipping(model.response, tones, model.fft_length, others, gain)
            lost = min(max(1.0 - clipped / gain, recovery.left_by_record * lost), _MOST_LOSS)


@kernel
def may_overdrive(model: ReceiverModel, power_w: float) -> bool:
    """Whether an echo of this mean power can exceed full scale."""
    power = _BRIGHTEST * model.snr_per_w * power_w + model.back_reflection.snr
    variance = model.response.mean_noise * model.fft_length / 4.0 + 0.5 * power
    exceeds: bool = model.response.full_scale < 7.0 * sqrt(variance)
    return exceeds
