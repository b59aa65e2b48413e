"""Errors of range and closing speed by motion and by the light's travel time, in closed form.

They follow from segments at different times and optical frequencies, over level ground, relative to the time of
validity (docs/physics.md, "Systematic errors").
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np

from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.kernels import kernel
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument

_Numbers = TypeVar("_Numbers", float, FloatArray)


class MotionErrors(NamedTuple):
    """Constants of an instrument."""

    range_per_mps2: float
    """Error of the range by a rate of the closing speed, c T/(λ S)."""
    closing_s: float
    """Error of the range by a closing speed, with the records' ranges and optical frequencies, beside 3 v R/c."""
    receding_s: float
    """The same where the lidar recedes."""
    speed_share: float
    """Relative error of the closing speed by the chirps' optical frequencies."""


def build_motion_errors(instrument: Instrument) -> MotionErrors:
    """Compute the constants from an instrument's keys."""
    waveform = instrument.waveform
    segment_s, record_s = waveform.segment_time_s, waveform.record_time_s
    per_mps2 = waveform.range_per_speed_s * segment_s
    if instrument.detection.combine == "chirp_minus_doppler":
        return MotionErrors(per_mps2, -(2.0 * segment_s - 0.5 * record_s), segment_s + 0.5 * record_s, 0.0)
    by_speed_s = -0.5 * (segment_s - record_s)
    carrier_hz = SPEED_OF_LIGHT_MPS / waveform.wavelength_m
    return MotionErrors(
        per_mps2, by_speed_s, by_speed_s, -waveform.chirp_slope_hz_per_s * segment_s / carrier_hz
    )


@kernel
def motion_error(
    errors: MotionErrors, range_m: _Numbers, speed_mps: _Numbers, acceleration_mps2: _Numbers
) -> tuple[_Numbers, _Numbers]:
    """Errors of range and closing speed, from both and the rate of the speed; arrays where interpreted."""
    delay_s = range_m / SPEED_OF_LIGHT_MPS
    middle_s = 0.5 * (errors.closing_s + errors.receding_s)
    by_speed_s = middle_s + 0.5 * (errors.closing_s - errors.receding_s) * np.sign(speed_mps)
    range_error_m = errors.range_per_mps2 * acceleration_mps2 + speed_mps * (by_speed_s + 3.0 * delay_s)
    speed_error_mps = speed_mps * (speed_mps / SPEED_OF_LIGHT_MPS + errors.speed_share)
    return range_error_m, speed_error_mps - acceleration_mps2 * delay_s
