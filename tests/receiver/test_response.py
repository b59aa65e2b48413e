"""Amplifier and digitiser against their poles, noise in time, and clipped samples."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import PLAIN

from lidar_emu.receiver.analog_response import Response, clipping, may_clip, noise_level, tone_gain
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.scenario.instrument import Instrument, Receiver, Waveform


def _response(length: int, lowpass: float | None = None, highpass: float = 0.0) -> Response:
    """Response of an instrument whose poles are given in bins."""
    waveform = Waveform(fft_length=length)
    receiver = PLAIN.receiver.model_copy(
        update={
            "bandwidth_hz": None if lowpass is None else lowpass * waveform.bin_width_hz,
            "ac_coupling_hz": highpass * waveform.bin_width_hz,
        }
    )
    return build_receiver(Instrument(waveform=waveform, receiver=receiver)).response


def _level(response: Response, k: float, length: int, factor: float = 1.0, added: float = 0.0) -> float:
    return noise_level(response, 1.0, factor, added, float(k), float(np.sin(np.pi * k / length)))


@pytest.mark.parametrize("highpass", [0.0, 11.0, 400.0])
@pytest.mark.parametrize("lowpass", [None, 200.0, 5e4])
def test_gain_is_that_of_the_poles(lowpass: float | None, highpass: float) -> None:
    response = _response(2**17, lowpass, highpass)
    for f in (1e-3, 1.0, 11.0, 250.0, 4e4, 3e6):
        expected = 1.0 if lowpass is None else 1 / (1 + 1j * f / lowpass)
        if highpass > 0:
            expected *= (1j * f / highpass) / (1 + 1j * f / highpass)
        assert complex(*tone_gain(response, f)) == pytest.approx(expected, rel=1e-12)
        assert complex(*tone_gain(response, -f)) == pytest.approx(np.conj(expected), rel=1e-12)
    assert complex(*tone_gain(response, 0.0)) == (0 if highpass > 0 else 1)


@pytest.mark.parametrize("lowpass", [30.0, 500.0, 3000.0])
@pytest.mark.parametrize("k", [1, 37, 256, 511])
def test_noise_of_every_zone_folds_in(lowpass: float, k: int) -> None:
    length, zones = 1024, np.arange(-20_000, 20_001)
    expected = np.sum(1 / (1 + ((k + zones * length) / lowpass) ** 2))
    # Zones beyond: an integral.
    expected += 2 * (lowpass / length) ** 2 / 20_000.5
    assert _level(_response(length, lowpass), k, length) == pytest.approx(expected, rel=1e-9)


def test_ac_coupling_takes_noise_off_the_lowest_bins() -> None:
    length, zones = 1024, np.arange(-20_000, 20_001)
    response = _response(length, 500.0, 5.0)
    for k in (1, 2, 5, 20, 300):
        f = k + zones * length
        expected = np.sum(f**2 / (f**2 + 25.0) / (1 + (f / 500.0) ** 2)) + 2 * (500 / length) ** 2 / 20_000.5
        # It is left out of the zones above, where it takes (5/N)² of each.
        assert _level(response, k, length) == pytest.approx(expected, rel=1e-4)


def test_parts_of_the_noise_add_up() -> None:
    response = build_receiver(Instrument()).response
    length = Instrument().waveform.fft_length
    amplifier, digitiser = response.amplifier_noise, response.digitiser_noise
    assert amplifier + digitiser == pytest.approx(1)
    assert 0 < digitiser < 1
    once, flat = _level(response, 20_000, length), _response(2**17)
    shaped = (once - digitiser) / amplifier
    assert _level(response, 20_000, length, 1.5, 0.25) == pytest.approx(
        1.5 * amplifier * shaped + digitiser + 0.25
    )
    assert _level(flat, 20_000, length, 1.5, 0.25) == pytest.approx(1.75)


@pytest.mark.parametrize("limit", [0.3, 1.0, 2.0, 3.5])
def test_clipping_is_that_of_gaussian_samples(limit: float) -> None:
    # A tone of amplitude 30 and noise of variance N/4.
    length, variance = 1024.0, 0.5 * 30.0**2 + 256.0
    tone = np.array([[100.0], [0.2], [18.0], [24.0]])
    full_scale = limit * np.sqrt(variance)
    response = _response(1024)._replace(full_scale=full_scale)
    x = np.sqrt(variance) * np.random.default_rng(9).standard_normal(4_000_000)
    clipped = np.clip(x, -full_scale, full_scale)
    gain = np.mean(x * clipped) / np.mean(x * x)
    distortion = np.mean((clipped - gain * x) ** 2)
    ours, per_bin = clipping(response, tone.astype(np.float32), 1, length, 0.0)
    assert ours == pytest.approx(gain, abs=2e-3)
    # A rectangular bin of white noise holds 4/N of its variance where a tone of unit amplitude holds 1.
    assert per_bin * length / 4 == pytest.approx(distortion, rel=0.02)


def test_a_tone_alone_keeps_more_than_a_gaussian_record() -> None:
    """The line of a square wave is 4/π of its height: `snr_db` of a hard clipped record is 1.05 dB low."""
    response = _response(1024)._replace(full_scale=10.0)
    tone = np.array([[100.0], [0.0], [1e5], [0.0]], dtype=np.float32)
    gain, _ = clipping(response, tone, 1, 1024.0, 0.0)
    wave = 1e5 * np.exp(2j * np.pi * (np.arange(4096) + 0.5) / 4096)
    line = 2.0 * np.mean(np.clip(wave.real, -10.0, 10.0) * wave.conj()).real / 1e5
    assert 20.0 * np.log10(line / (1e5 * gain)) == pytest.approx(1.05, abs=0.01)


def test_nothing_is_clipped_far_below_full_scale() -> None:
    nothing = np.zeros((4, 1), dtype=np.float32)
    # Noise of unit power in each bin has the standard deviation sqrt(N)/2, 16.
    assert clipping(_response(1024)._replace(full_scale=7.0 * 16.0), nothing, 1, 1024.0, 0.0) == (1.0, 0.0)
    assert clipping(_response(1024)._replace(full_scale=6.0 * 16.0), nothing, 1, 1024.0, 0.0)[0] < 1.0


def test_what_cannot_clip_is_known_from_its_mean_power() -> None:
    """Speckle makes no tone stronger than twenty times the mean, but once in 5e8 records."""
    for snr in (0.0, 1e2, 1e4, 1e8):
        limit = 7.0 * np.sqrt(256.0 + 0.5 * 20.0 * snr)
        for factor, may in ((0.99, True), (1.01, False)):
            response = _response(1024)._replace(full_scale=factor * limit)
            assert may_clip(response, 1024.0, snr) is may
            tone = np.array([[100.0], [0.2], [np.sqrt(20.0 * snr)], [0.0]], dtype=np.float32)
            assert (clipping(response, tone, 1, 1024.0, 0.0)[0] < 1.0) == may
    assert not may_clip(_response(1024), 1024.0, 1e24)


def test_noise_ahead_of_the_digitiser_is_what_the_pole_lets_through() -> None:
    """Mean over all bins of the folded noise, summed."""
    for lowpass in (20.0, 300.0, 2000.0):
        response = _response(1024, lowpass)
        levels = [_level(response, k + 0.5, 1024) for k in range(512)]
        assert response.mean_noise == pytest.approx(np.mean(levels), rel=1e-3)


def test_full_scale_is_the_digitisers_in_units_of_the_noise() -> None:
    """Noise of variance N/4 in these units has the voltage that its currents make across the amplifier."""
    instrument = Instrument(receiver=Receiver(bandwidth_hz=None, ac_coupling_hz=0.0))
    receiver, waveform = instrument.receiver, instrument.waveform
    assert receiver.adc is not None
    q, k = 1.602176634e-19, 1.380649e-23
    current_a = receiver.responsivity_a_per_w * receiver.local_oscillator_power_w
    density = (
        2 * q * (current_a + receiver.dark_current_a)
        + 4 * k * receiver.temperature_k / receiver.transimpedance_ohm
    )
    density += 10 ** (-15.0 - 3.0) * current_a**2
    noise_v2 = density * waveform.sample_rate_hz / 2 * receiver.transimpedance_ohm**2
    noise_v2 += (receiver.adc.full_scale_v / 2**receiver.adc.effective_bits) ** 2 / 12
    expected = receiver.adc.full_scale_v / 2 / np.sqrt(noise_v2) * np.sqrt(waveform.fft_length / 4)
    assert build_receiver(instrument).response.full_scale == pytest.approx(expected, rel=1e-9)
