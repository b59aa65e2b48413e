"""The analog receiver: response of its poles, noise, digitiser.

Amplitudes are in units in which white noise ahead of the receiver's poles, in the band up to half the sample rate,
has unit mean power in a rectangular bin: the square of a tone's amplitude is its bin SNR.
"""

from __future__ import annotations

from math import ceil, exp, log2, pi, sqrt
from typing import NamedTuple

import numpy as np

from lidar_emu.numerics.arrays import ComplexArray, FloatArray
from lidar_emu.receiver.analog_response import Response
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.scenario.instrument import Receiver, Waveform

_TIME_CONSTANTS = 25.0
"""Run-in of the slowest pole, in time constants: a transient of exp(-25) remains."""

_MARGIN = 1024
"""Samples on both sides of a record in which the ringing of the band limits decays."""

_USED_BAND = 0.8
"""Fraction of the band, up to half the rate of synthesis, that tones may occupy."""


class AnalogResponse(NamedTuple):
    """A single-pole low-pass and a single-pole high-pass."""

    bandwidth_hz: float | None = None
    """Half-power frequency of the low-pass; None: flat."""
    ac_coupling_hz: float = 0.0
    """Half-power frequency of the high-pass; 0: DC coupling."""

    @classmethod
    def of(cls, receiver: Receiver) -> AnalogResponse:
        """Poles of an instrument's receiver."""
        return cls(receiver.bandwidth_hz, receiver.ac_coupling_hz)

    @property
    def flat(self) -> bool:
        """Whether the response has no poles."""
        return self.bandwidth_hz is None and self.ac_coupling_hz == 0.0

    def gain(self, frequency_hz: FloatArray) -> ComplexArray:
        """Complex gain at signed frequencies, in their shape."""
        gain = np.ones(np.shape(frequency_hz), dtype=complex)
        if self.bandwidth_hz is not None:
            gain /= 1.0 + 1j * frequency_hz / self.bandwidth_hz
        if self.ac_coupling_hz > 0.0:
            gain *= 1j * frequency_hz / (self.ac_coupling_hz + 1j * frequency_hz)
        return gain

    def run_in(self, sample_rate_hz: float) -> int:
        """Number of samples after which the transient of a signal that was switched on has decayed."""
        corners = [corner for corner in (self.bandwidth_hz, self.ac_coupling_hz) if corner]
        if not corners:
            return 0
        return _MARGIN + ceil(_TIME_CONSTANTS * sample_rate_hz / (2 * pi * min(corners)))


FLAT = AnalogResponse()


class Digitiser(NamedTuple):
    """Clipping and rounding, in units of the samples."""

    full_scale: float
    """Range from the lowest to the highest value."""
    bits: float

    @classmethod
    def of(cls, receiver: Receiver, response: Response) -> Digitiser | None:
        """Digitiser of an instrument's receiver, scaled by its constants; None if it is ideal."""
        return None if receiver.adc is None else cls(2.0 * response.full_scale, receiver.adc.effective_bits)

    def digitise(self, samples: FloatArray) -> FloatArray:
        """Samples clipped to ± half the full scale and rounded to whole steps, including 0."""
        step = self.full_scale / 2.0**self.bits
        half = 0.5 * self.full_scale
        digitised: FloatArray = np.rint(np.clip(samples, -half, half) / step) * step
        return digitised


class Poles:
    """The receiver's poles as a product in the frequency domain.

    Args:
        waveform: rate and length of the record.
        response: the poles.
        highest_hz: highest frequency of the light.
    """

    def __init__(self, waveform: Waveform, response: AnalogResponse, highest_hz: float) -> None:
        from scipy import fft

        rate_hz, count = waveform.sample_rate_hz, waveform.fft_length
        factor = oversampling(waveform, highest_hz)
        whole = fft.next_fast_len(response.run_in(rate_hz) + count + _MARGIN)
        ahead = whole - count - _MARGIN
        step_s = 1.0 / (factor * rate_hz)
        self.time_s: FloatArray = (np.arange(whole * factor) - factor * (ahead + (count - 1) / 2)) * step_s
        """(n,) Times from the record's centre at which the light is sampled, with the run-in ahead of the record."""
        frequency_hz = fft.fftfreq(whole * factor, step_s)
        self._gain = response.gain(frequency_hz) * _taper(np.abs(frequency_hz) * 2.0 * step_s)
        self._kept = slice(factor * ahead, factor * (ahead + count), factor)

    def passed(self, light: ComplexArray) -> ComplexArray:
        """Light (..., n) behind the poles, at the samples of the record: (..., N)."""
        from scipy import fft

        return np.asarray(fft.ifft(self._gain * fft.fft(light))[..., self._kept])


def oversampling(waveform: Waveform, highest_hz: float) -> int:
    """Factor of the sample rate at which beats up to this frequency lie within the used band."""
    share = highest_hz / (_USED_BAND * 0.5 * waveform.sample_rate_hz)
    return int(2 ** max(0, ceil(log2(share)))) if share > 0.0 else 1


def _taper(band_share: FloatArray) -> FloatArray:
    """1 in the used band, decreasing smoothly to 0 beyond: a step at its end would ring across the record."""
    beyond = np.clip((band_share - _USED_BAND) / (1.0 - _USED_BAND), 0.0, 1.0)
    return np.asarray(np.square(np.cos(0.5 * np.pi * beyond)), dtype=float)


def draw_noise(
    rng: np.random.Generator, records: int, waveform: Waveform, response: AnalogResponse = FLAT
) -> FloatArray:
    """Gaussian noise behind the receiver's poles, (records, N), drawn record by record.

    The noise is white ahead of the poles, with unit mean power in a rectangular bin. With a low-pass, noise of all
    frequencies is included, and noise beyond half the sample rate is aliased into the record: the samples are exact
    samples of the continuous process, so that bin k has the mean power Σ |H(f_k + m fs)|² over all m, apart from
    leakage at the record's ends. Without a low-pass the power of white noise would be infinite; it is limited to half
    the sample rate ahead of the high-pass.

    Raises:
        ValueError: the two poles coincide.
    """
    sigma = 0.5 * sqrt(waveform.fft_length)
    if response.flat:
        return sigma * rng.standard_normal((records, waveform.fft_length))
    if response.bandwidth_hz is None:
        from scipy import fft

        ahead = response.run_in(waveform.sample_rate_hz)
        whole = fft.next_fast_len(ahead + waveform.fft_length + _MARGIN, real=True)
        gain = response.gain(fft.rfftfreq(whole, 1.0 / waveform.sample_rate_hz))
        noise: FloatArray = fft.irfft(gain * fft.rfft(rng.standard_normal((records, whole))), whole)
        return sigma * noise[:, ahead : ahead + waveform.fft_length]
    return sigma * _sampled_process(rng, records, waveform, response.bandwidth_hz, response.ac_coupling_hz)


def noise_level(waveform: Waveform, response: AnalogResponse) -> FloatArray:
    """Mean power (N/2 + 1,) of `draw_noise` in rectangular bins 0 to N/2, without leakage at the record's ends.

    With a low-pass, the spectrum of the sampled process follows from its autocovariance Σ A_i exp(-p_i |k| / fs), in
    the terms of `_sampled_process`, each of which is a geometric series.
    """
    bins = np.arange(waveform.fft_length // 2 + 1, dtype=float)
    frequency_hz = bins * waveform.bin_width_hz
    if response.bandwidth_hz is None:
        return np.square(np.abs(response.gain(frequency_hz)))
    poles, residues = _partial_fractions(response.bandwidth_hz, response.ac_coupling_hz)
    rate_hz = waveform.sample_rate_hz
    amplitude = (residues * residues[:, None] / (rate_hz * (poles + poles[:, None]))).sum(axis=0)
    turning = np.exp(-2j * np.pi * frequency_hz / rate_hz)[:, None] * np.exp(-poles / rate_hz)
    series = 1.0 + 2.0 * (turning / (1.0 - turning)).real
    return np.asarray((amplitude * series).sum(axis=1), dtype=float)


def noise_with_echo(
    model: ReceiverModel, echo_w: float, amplifier_level: FloatArray
) -> tuple[float, FloatArray]:
    """Noise ahead of the poles with the shot noise of an echo, and its mean power (N/2 + 1,) in rectangular bins.

    The digitiser's noise arises behind the poles, by rounding.

    Args:
        model: constants of the receiver.
        echo_w: power of the echo.
        amplifier_level: `noise_level` of the poles.
    """
    share = model.response.amplifier_noise * (1.0 + model.signal_shot_per_w * echo_w)
    return share, share * amplifier_level + model.response.digitiser_noise


def _sampled_process(
    rng: np.random.Generator, records: int, waveform: Waveform, bandwidth_hz: float, ac_coupling_hz: float
) -> FloatArray:
    """Samples of white noise behind the poles.

    In partial fractions the response is Σ c_i / (s + p_i), and each of its terms, driven by the same white noise,
    is a process x' = -p x + n: from one sample to the next it decays by exp(-p/fs) and receives a Gaussian
    increment, correlated among the terms. Its covariance (1 - exp(-(p_i + p_j)/fs)) / (fs (p_i + p_j))
    belongs to white noise with unit variance in the band up to fs/2.
    """
    from scipy.signal import lfilter

    rate_hz = waveform.sample_rate_hz
    poles, residues = _partial_fractions(bandwidth_hz, ac_coupling_hz)
    drawn = rng.standard_normal((records, waveform.fft_length, poles.size))
    noise = np.zeros((records, waveform.fft_length))
    stationary, increment = _factor(poles, rate_hz, from_rest=False), _factor(poles, rate_hz, from_rest=True)
    for i, pole in enumerate(poles):
        driven = sum(increment[i, j] * drawn[:, :, j] for j in range(poles.size))
        driven[:, 0] = sum(stationary[i, j] * drawn[:, 0, j] for j in range(poles.size))
        noise += residues[i] * lfilter([1.0], [1.0, -exp(-pole / rate_hz)], driven)
    return noise


def _partial_fractions(bandwidth_hz: float, ac_coupling_hz: float) -> tuple[FloatArray, FloatArray]:
    """p_i in rad/s and c_i of the response Σ c_i / (s + p_i)."""
    poles = 2.0 * pi * np.array([bandwidth_hz, ac_coupling_hz] if ac_coupling_hz > 0.0 else [bandwidth_hz])
    if poles.size == 1:
        return poles, poles
    apart = poles[0] - poles[1]
    if abs(apart) < 1e-6 * poles[0]:
        raise ValueError(f"bandwidth and AC coupling coincide: {bandwidth_hz} Hz")
    return poles, poles[0] * np.array([poles[0], -poles[1]]) / apart


def _factor(poles: FloatArray, rate_hz: float, from_rest: bool) -> FloatArray:
    """Lower triangular square root of the terms' covariance: after one step from rest, or stationary."""
    total = poles[:, None] + poles
    # The intensity 1/fs is unit variance over the band of width fs.
    covariance = 1.0 / (total * rate_hz)
    if from_rest:
        covariance *= -np.expm1(-total / rate_hz)
    return np.asarray(np.linalg.cholesky(covariance), dtype=float)
