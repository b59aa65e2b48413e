"""Recovery of the amplifier after overdriven records, sample by sample."""

from __future__ import annotations

from math import exp
from typing import Self

import numpy as np

from lidar_emu.fmcw.waveform.analog_receiver import Digitiser
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import Receiver, Waveform


class RecoveringAmplifier:
    """Gain of the amplifier over the samples of a shot's records, taken in turn.

    It loses the gain that the samples of a record lose by clipping, and recovers exponentially from the record's end.

    Args:
        waveform: length and rate of the records, and the guard between them.
        recovery_time_s: time constant.
        full_scale: range from the lowest to the highest value that is not clipped.
        records: measurements of the same geometry, each with a gain of its own.
    """

    def __init__(
        self, waveform: Waveform, recovery_time_s: float, full_scale: float, records: int = 1
    ) -> None:
        guard_s = waveform.segment_time_s - waveform.record_time_s
        time_s = np.arange(waveform.fft_length) / waveform.sample_rate_hz
        self._left: FloatArray = np.exp(-(guard_s + time_s) / recovery_time_s)
        self._left_after = exp(-waveform.segment_time_s / recovery_time_s)
        self._half = 0.5 * full_scale
        self._lost = np.zeros(records)

    @classmethod
    def of(
        cls, receiver: Receiver, waveform: Waveform, digitiser: Digitiser | None, records: int = 1
    ) -> Self | None:
        """The amplifier of an instrument's receiver ahead of its digitiser; None if it recovers at once."""
        if receiver.adc is None or digitiser is None or receiver.adc.recovery_time_s == 0.0:
            return None
        return cls(waveform, receiver.adc.recovery_time_s, digitiser.full_scale, records)

    def amplify(self, samples: FloatArray, rows: slice = slice(None)) -> FloatArray:
        """Samples (records, N) of the next record of the measurements `rows`, in the same shape, not yet clipped."""
        lost = self._lost[rows]
        amplified = (1.0 - lost[:, None] * self._left) * samples
        clipped = np.clip(amplified, -self._half, self._half)
        power = np.einsum("rn,rn->r", amplified, amplified)
        kept = np.einsum("rn,rn->r", amplified, clipped) / np.where(power > 0.0, power, 1.0)
        loss = np.where(power > 0.0, 1.0 - kept, 0.0)
        self._lost[rows] = np.maximum(loss, self._left_after * lost)
        return amplified
