"""Dust of a plume in the bins of a record, against plain random particles and random numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from instruments import echoes, plain

from lidar_emu.numerics.kernels import interpreted
from lidar_emu.receiver.false_targets import false_targets
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import FalseTarget
from lidar_emu.receiver.volume_light import band_snr, set_bands, volume_in_bin
from lidar_emu.receiver.workspace import BEAM
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS

INSTRUMENT = plain({"fft_length": 2048, "sample_rate_hz": 10e6}, window="rect")
WAVEFORM = INSTRUMENT.waveform
HALF = WAVEFORM.fft_length // 2
BANDS = {
    "wide in speed": (20.0, 22.0, 1.0, 1.0, 3.0),
    "deep, one speed": (20.0, 60.0, 1.5, 2.0, 2.0),
    "both": (20.0, 60.0, 1.5, 1.0, 1.2),
    "folded": (20.0, 22.0, 1.0, -4.0, 9.0),
}
"""Ranges in m, optical depth, and closing speeds in m/s."""


def beats_bin(segment: int, range_m: np.ndarray, speed_mps: np.ndarray) -> np.ndarray:
    """Beats of particles, where a real-valued record shows them."""
    delay_s = 2.0 * range_m / SPEED_OF_LIGHT_MPS
    doppler_hz = 2.0 * speed_mps / WAVEFORM.wavelength_m
    swept_hz = WAVEFORM.chirp_slope_hz_per_s * delay_s
    beat_hz = (swept_hz - doppler_hz, doppler_hz, swept_hz + doppler_hz)[segment]
    signed = beat_hz / WAVEFORM.bin_width_hz
    return np.abs(signed - 2 * HALF * np.rint(signed / (2 * HALF)))


@pytest.mark.slow
@pytest.mark.parametrize("segment", [0, 1, 2], ids=["up", "constant", "down"])
@pytest.mark.parametrize("band", BANDS)
def test_bins_hold_the_light_of_the_particles_whose_beats_they_are(band: str, segment: int) -> None:
    near_m, far_m, depth, slowest_mps, fastest_mps = BANDS[band]
    beam = np.zeros(1, dtype=BEAM).view(np.recarray)[0]
    beam.dust_snr, beam.dust = 100.0, [0.0, near_m, far_m, depth, slowest_mps, fastest_mps]
    model: Any = build_receiver(INSTRUMENT)
    interpreted(set_bands)(model, beam, segment, 0.0)
    found = np.array([interpreted(volume_in_bin)(model, beam, float(k)) for k in range(1, HALF)])

    rng = np.random.default_rng(1)
    place, speed = rng.random(400_000), rng.uniform(slowest_mps, fastest_mps, 400_000)
    weight = np.exp(-2.0 * depth * place)
    beats = beats_bin(segment, near_m + place * (far_m - near_m), speed)
    expected, _ = np.histogram(beats, np.arange(0.5, HALF), weights=weight * 100.0 / weight.sum())

    assert interpreted(band_snr)(beam) == 100.0
    assert found.sum() == pytest.approx(expected.sum(), rel=0.02)
    # A band of one speed is a bin wide at each range; edges of a wide one may be half a bin off.
    cumulative = np.abs(np.cumsum(found) - np.cumsum(expected))
    assert cumulative.max() < 1.05 * max(found.max(), 1.0)


def test_the_highest_bin_of_dust_is_that_of_exponential_numbers() -> None:
    """A band of speeds beside a dark surface: its highest bin lies anywhere in it, with the power of the highest of so
    many exponential numbers."""
    shots, per_bin = 3000, 3.0
    speeds = np.array([1.0, 2.5])
    width = np.ptp(speeds) / WAVEFORM.speed_bin_mps
    model = build_receiver(INSTRUMENT)
    one = np.ones((shots, 1))
    row = [per_bin * width / model.snr_per_w, 20.0, 21.0, 0.5, *speeds]
    beams = echoes(21.0 * one[..., None], 0.5 * one[..., None], power_w=1e-19 * one[..., None])
    beams = beams._replace(dust=np.broadcast_to(row, (shots, 1, 6)).copy())
    found = receive(model, beams, np.arange(shots), 1)
    rng = np.random.default_rng(2)
    highest = (1.0 + per_bin) * rng.exponential(size=(20_000, int(width))).max(axis=1)
    for segment in range(3):
        rate = np.mean((found.segments & (1 << segment)) > 0)
        expected = np.mean(highest > model.threshold)
        assert rate == pytest.approx(expected, abs=3.5 * np.sqrt(0.25 / shots))
    peaks = found.segment_peak_hz[:, 0, 1] / WAVEFORM.bin_width_hz * WAVEFORM.speed_bin_mps
    inside = peaks[np.isfinite(peaks)]
    assert np.mean((inside > 0.99) & (inside < 2.51)) > 0.999
    assert np.mean(inside) == pytest.approx(speeds.mean(), abs=3.5 * 1.5 / np.sqrt(12.0 * len(inside)))
    source = false_targets(model, found.segment_peak_hz, 21.0 * one, 0.5 * one, dust=beams.dust)
    np.testing.assert_array_equal(source[:, 0] == FalseTarget.DUST, found.segments[:, 0] > 0)
