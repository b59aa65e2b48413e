"""The receiver as a record sees it."""

from __future__ import annotations

from typing import NamedTuple

from lidar_emu.fmcw.waveform.analog_receiver import AnalogResponse, Digitiser
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import Waveform


class RecordReceiver(NamedTuple):
    """Poles, noise and digitiser; powers are relative to the noise as in `fmcw.waveform.analog_receiver`."""

    waveform: Waveform
    response: AnalogResponse
    digitiser: Digitiser | None
    noise_share: float
    """Power of the white noise ahead of the poles."""
    noise_level: FloatArray
    """(N/2 + 1,) Mean noise power in a rectangular bin, of all of it."""
