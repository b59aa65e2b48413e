"""The peak of the laser's intensity noise: its spectrum, and noise drawn with it."""

from __future__ import annotations

from math import ceil, pi, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.fmcw.analog_response import Response
from lidar_emu.fmcw.waveform.analog_receiver import AnalogResponse
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.scenario.instrument import Receiver, Waveform

_CORRELATION_TIMES = 20.0
"""Length of the drawn noise beyond a record, which decorrelates its ends."""


class NoisePeak(NamedTuple):
    """A Lorentzian ahead of the receiver's poles, in the units of `analog_receiver`."""

    power: float
    """Mean power of a rectangular bin at the peak."""
    frequency_hz: float
    width_hz: float
    """Full width at half its height."""

    @classmethod
    def of(cls, receiver: Receiver, response: Response) -> NoisePeak | None:
        """Peak of an instrument's laser, relative to the noise of its receiver; None without one."""
        if receiver.intensity_noise_peak_db_per_hz is None:
            return None
        return cls(
            response.noise_peak, receiver.intensity_noise_peak_hz, receiver.intensity_noise_peak_width_hz
        )

    def bins(self, waveform: Waveform, poles: AnalogResponse) -> FloatArray:
        """Mean power behind the poles in bins 0 to N/2, (N/2 + 1,)."""
        return self.level(np.arange(waveform.fft_length // 2 + 1.0) * waveform.bin_width_hz, poles)

    def level(self, frequency_hz: FloatArray, poles: AnalogResponse) -> FloatArray:
        """Mean power behind the poles at these frequencies, in their shape."""
        away = (frequency_hz - self.frequency_hz) / (0.5 * self.width_hz)
        return np.asarray(self.power / (1.0 + away**2) * np.square(np.abs(poles.gain(frequency_hz))))

    def draw(
        self, rng: np.random.Generator, records: int, waveform: Waveform, poles: AnalogResponse
    ) -> FloatArray:
        """Gaussian noise behind the poles, (records, N), with this spectrum up to half the sample rate."""
        from scipy import fft

        rate_hz, count = waveform.sample_rate_hz, waveform.fft_length
        whole = fft.next_fast_len(
            count + ceil(_CORRELATION_TIMES * rate_hz / (pi * self.width_hz)), real=True
        )
        shape = np.sqrt(self.level(fft.rfftfreq(whole, 1.0 / rate_hz), poles))
        noise: FloatArray = fft.irfft(shape * fft.rfft(rng.standard_normal((records, whole))), whole)
        return 0.5 * sqrt(count) * noise[:, :count]
