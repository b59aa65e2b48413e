"""Bins from an envelope around the scatterers' frequencies against all samples of the record."""

from __future__ import annotations

from math import pi, sin

import numpy as np
import pytest
from moving_beams import even_plane, gliding, speckled, turning
from scipy.special import jv

from lidar_emu.receiver.whole_spectrum import WindowName, transform
from lidar_emu.reference.analog_receiver import FLAT, AnalogResponse
from lidar_emu.reference.laser_sweep import frequency_plan
from lidar_emu.reference.record_light import (
    NO_SCATTERERS,
    GaussianMode,
    PosesAt,
    Scatterers,
    record_light,
    reflected_light,
)
from lidar_emu.reference.records import (
    RecordReceiver,
    add_narrowband,
    narrowband_bins,
    received_light,
    record_span_s,
    sampled_bins,
)
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument

INSTRUMENT = Instrument.model_validate({"waveform": {"linewidth_hz": 0.0}})
WAVEFORM = INSTRUMENT.waveform
MODE = GaussianMode.of(INSTRUMENT)
WINDOWS: tuple[WindowName, ...] = ("hann", "hamming", "rect")
POLES = AnalogResponse(300e6, 50e3)
TOLERANCE = {"hann": 1e-4, "hamming": 1e-3, "rect": 6e-3}
"""Relative to the peak: what the lobes of the images and of distant scatterers leave."""

SCENES: dict[str, tuple[PosesAt, float, float]] = {
    "sideways at 300 m": (gliding([40.0, 0.0, -2.0]), 300.0, 0.0),
    "near, on a slope": (gliding([10.0, 0.0, -2.0]), 50.0, 0.41),
    "fast at 2 km": (gliding([0.0, 0.0, -100.0]), 2000.0, 0.41),
    "folded and braking": (gliding([5.0, 3.0, -90.0], -10.0), 1500.0, 0.1),
    "turning": (turning(0.05, 5.0, 5.0), 800.0, 0.2),
}
"""Poses, range and slope."""


@pytest.mark.slow
@pytest.mark.parametrize("response", [FLAT, POLES], ids=["flat", "poles"])
@pytest.mark.parametrize("scene", SCENES)
def test_bins_near_the_peak_are_those_of_all_samples(scene: str, response: AnalogResponse) -> None:
    """Within ten bins of the peak, relative to it; poles act at each scatterer's own frequency."""
    poses_at, range_m, slope = SCENES[scene]
    scatterers = speckled(even_plane(INSTRUMENT, range_m, slope, 21), 7)
    receiver = RecordReceiver(WAVEFORM, response, None, 1.0, np.ones(WAVEFORM.fft_length // 2 + 1))
    for segment in frequency_plan(WAVEFORM):
        whole = record_light(MODE, segment, poses_at, scatterers, *record_span_s(WAVEFORM, response))
        alone = record_light(MODE, segment, poses_at, scatterers, *record_span_s(WAVEFORM, FLAT))
        bins = np.zeros((len(WINDOWS), WAVEFORM.fft_length // 2 + 1), dtype=complex)
        add_narrowband(receiver, alone, WINDOWS, bins, *(np.random.default_rng(0),) * 2)
        samples = received_light(receiver, whole).real
        for window, found in zip(WINDOWS, bins, strict=True):
            expected = transform(samples, window)
            peak = int(np.abs(expected).argmax())
            near = slice(max(peak - 10, 1), peak + 11)
            tolerance = TOLERANCE[window] + (0.0 if response.flat else 2e-3)
            np.testing.assert_allclose(
                found[near], expected[near], rtol=0, atol=tolerance * abs(expected[peak]), err_msg=window
            )


def test_noise_has_its_level_in_every_bin_and_window() -> None:
    """Means over a thousand bins, against the samples' noise behind poles."""
    from lidar_emu.reference.analog_receiver import noise_level

    level = noise_level(WAVEFORM, POLES)
    receiver = RecordReceiver(WAVEFORM, POLES, None, 1.0, level)
    dark = record_light(MODE, frequency_plan(WAVEFORM)[1], gliding([0, 0, 0]), NO_SCATTERERS, -1e-4, 1e-4)
    rng = np.random.default_rng(3)
    means = []
    for bins_of in (narrowband_bins, sampled_bins):
        power = np.abs(bins_of(receiver, [dark], WINDOWS, rng, rng).bins[:, 1:-1]) ** 2
        means.append(power[:, : 65 * 1008].reshape(len(WINDOWS), 65, -1).mean(axis=2))
    np.testing.assert_allclose(means[0], means[1], rtol=0.3)
    assert np.mean(means[0] / means[1]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("response", [FLAT, POLES], ids=["flat", "poles"])
def test_ripple_and_reflection_are_those_of_all_samples(response: AnalogResponse) -> None:
    """Around the echo with its side lines, relative to it; the reflection also against its own amplitude."""
    index, spacing_bin, range_m, near_m = 1.0, 13, 300.0, 30.0
    delay_s = 2.0 * range_m / SPEED_OF_LIGHT_MPS
    ripple_hz = spacing_bin * WAVEFORM.bin_width_hz
    amplitude_hz = 0.5 * index * ripple_hz / sin(pi * ripple_hz * delay_s)
    waveform = WAVEFORM.model_copy(update={"ripple_hz": amplitude_hz, "ripple_frequency_hz": ripple_hz})
    level = np.zeros(WAVEFORM.fft_length // 2 + 1)
    receiver = RecordReceiver(waveform, response, None, 0.0, level)
    scatterers = speckled(even_plane(INSTRUMENT, range_m, 0.0, 21), 7)
    found = {}
    for segment in (frequency_plan(waveform)[0], frequency_plan(waveform)[2]):
        for bins_of, covered in ((narrowband_bins, FLAT), (sampled_bins, response)):
            span_s = record_span_s(waveform, covered)
            echo = record_light(MODE, segment, gliding([0.0, 0.0, 0.0]), scatterers, *span_s)
            mirror = reflected_light(segment, near_m, 1.0 + 2.0j, *span_s)
            rng = np.random.default_rng(0)
            lights = [echo._replace(ripple_turns=0.2), mirror]
            found[bins_of] = bins_of(receiver, lights, ["hann"], rng, rng).bins[0]
        whole, narrow = found[sampled_bins], found[narrowband_bins]
        beats = [2.0 * waveform.chirp_slope_hz_per_s * r / SPEED_OF_LIGHT_MPS for r in (range_m, near_m)]
        for beat_hz in beats:
            middle = round(beat_hz / waveform.bin_width_hz)
            near = slice(middle - 40, middle + 41)
            np.testing.assert_allclose(
                narrow[near], whole[near], rtol=0, atol=3e-3 * np.abs(whole[near]).max()
            )
        middle_hz = round(beats[1] / waveform.bin_width_hz) * waveform.bin_width_hz
        passed = np.abs(response.gain(np.array(beats[1])))
        rest = (beats[1] - middle_hz) / waveform.bin_width_hz
        hann = 0.5 * np.sinc(rest) + 0.25 * (np.sinc(rest - 1.0) + np.sinc(rest + 1.0))
        line = round(beats[1] / waveform.bin_width_hz)
        assert np.abs(whole[line]) == pytest.approx(np.sqrt(5.0) * passed * hann, rel=0.02)


def test_ripple_has_the_side_lines_of_bessel_functions() -> None:
    """A scatterer on the axis of a beam at rest has lines J_n(m) at n f_m from its beat, m = (2A/f_m) sin(πf_mτ)."""
    spacing_bin, amplitude_hz = 13, 4e4
    ripple_hz = spacing_bin * WAVEFORM.bin_width_hz
    waveform = WAVEFORM.model_copy(update={"ripple_hz": amplitude_hz, "ripple_frequency_hz": ripple_hz})
    scatterer = Scatterers(np.array([[0.0, 0.0, -200.0]]), np.zeros((1, 3)), np.ones(1, dtype=complex))
    segment = frequency_plan(waveform)[2]
    light = record_light(MODE, segment, gliding([0, 0, 0]), scatterer, *record_span_s(waveform, FLAT))
    receiver = RecordReceiver(waveform, FLAT, None, 0.0, np.zeros(waveform.fft_length // 2 + 1))
    rng = np.random.default_rng(0)
    bins = narrowband_bins(receiver, [light._replace(ripple_turns=0.7)], ["hann"], rng, rng).bins[0]
    index = 2.0 * amplitude_hz / ripple_hz * sin(pi * ripple_hz * light.mean_delay_s)
    line = round(abs(light.middle_frequency_hz[0]) / waveform.bin_width_hz)
    orders = np.arange(-3, 4)
    lines = np.abs(bins[line + spacing_bin * orders])
    np.testing.assert_allclose(lines / lines[3], np.abs(jv(orders, index) / jv(0, index)), rtol=0.01)
