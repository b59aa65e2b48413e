"""Bins from an envelope around the scatterers' frequencies against all samples of the record."""

from __future__ import annotations

import numpy as np
import pytest
from moving_beams import even_plane, gliding, speckled, turning

from lidar_emu.fmcw.waveform.analog_receiver import FLAT, AnalogResponse
from lidar_emu.fmcw.waveform.detection import WindowName, transform
from lidar_emu.fmcw.waveform.record_samples import frequency_plan
from lidar_emu.scatterers.narrowband import add_narrowband, narrowband_bins
from lidar_emu.scatterers.receiver import RecordReceiver
from lidar_emu.scatterers.record_light import NO_SCATTERERS, GaussianMode, PosesAt, record_light
from lidar_emu.scatterers.samples import received_light, record_span_s, sampled_bins
from lidar_emu.scenario.instrument import Instrument

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
    from lidar_emu.fmcw.waveform.analog_receiver import noise_level

    level = noise_level(WAVEFORM, POLES)
    receiver = RecordReceiver(WAVEFORM, POLES, None, 1.0, level)
    dark = record_light(MODE, frequency_plan(WAVEFORM)[1], gliding([0, 0, 0]), NO_SCATTERERS, -1e-4, 1e-4)
    rng = np.random.default_rng(3)
    means = []
    for bins_of in (narrowband_bins, sampled_bins):
        power = np.abs(bins_of(receiver, dark, WINDOWS, rng, rng)[:, 1:-1]) ** 2
        means.append(power[:, : 65 * 1008].reshape(len(WINDOWS), 65, -1).mean(axis=2))
    np.testing.assert_allclose(means[0], means[1], rtol=0.3)
    assert np.mean(means[0] / means[1]) == pytest.approx(1.0, abs=0.02)
