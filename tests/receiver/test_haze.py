"""Haze as a target: rates and places of its detections against closed forms and plain random numbers."""

from __future__ import annotations

import numpy as np
import pytest
from instruments import echoes, plain

from lidar_emu.receiver.false_targets import false_targets
from lidar_emu.receiver.link_budget import haze_w_per_m
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.receiver_model import ReceiverModel
from lidar_emu.receiver.returns import Echoes, FalseTarget, Returns
from lidar_emu.scenario.site import Atmosphere, Plane, Site

INSTRUMENT = plain({"fft_length": 16384, "sample_rate_hz": 75e6}, window="rect")
WAVEFORM = INSTRUMENT.waveform
RAYLEIGH_M = float(np.pi * INSTRUMENT.optics.waist_radius_m**2 / WAVEFORM.wavelength_m)
BINS = WAVEFORM.fft_length / 2 - 1
SHOTS = 4000
THIN, DENSE = (2e-6, 1e-4), (1e-4, 1e-2)


def model_of(backscatter: float, extinction: float) -> ReceiverModel:
    air = Atmosphere(extinction_per_m=extinction, backscatter_per_m_sr=backscatter)
    return build_receiver(INSTRUMENT, Site(ground=Plane(kind="plane"), atmosphere=air))


def over_bins(model: ReceiverModel, backscatter: float, extinction: float, range_m: float) -> np.ndarray:
    """Mean power of haze in each range bin, from the sensor on."""
    air = Atmosphere(extinction_per_m=extinction, backscatter_per_m_sr=backscatter)
    r = WAVEFORM.range_bin_m * np.arange(int(range_m / WAVEFORM.range_bin_m))
    per_m = haze_w_per_m(INSTRUMENT, air) * model.snr_per_w
    return WAVEFORM.range_bin_m * per_m * np.exp(-2.0 * extinction * r) / (1.0 + (r / RAYLEIGH_M) ** 2)


def measure(
    model: ReceiverModel, range_m: float, speed_mps: float, shots: int = SHOTS, power_w: float = 1e-18
) -> Returns:
    """Shots through haze onto a surface, by default a dark one."""
    one = np.ones((shots, 1, 1))
    beams: Echoes = echoes(range_m * one, speed_mps * one, power_w=power_w * one)
    beams = beams._replace(air_speed_mps=np.full((shots, 1), speed_mps))
    return receive(model, beams, np.arange(shots), 1)


def speed_of(bin_number: float) -> float:
    """Closing speed whose Doppler shift is in the middle of a bin."""
    return bin_number * WAVEFORM.speed_bin_mps


@pytest.mark.parametrize(("backscatter", "extinction"), [THIN, DENSE], ids=["thin", "dense"])
def test_chirps_detect_haze_at_the_rate_of_independent_bins(backscatter: float, extinction: float) -> None:
    """1 - Π (1 - exp(-T/(1 + p))), with the false alarms of the other bins."""
    model = model_of(backscatter, extinction)
    assert (model.haze.computed_range_m > 0.0) == ((backscatter, extinction) == DENSE)
    mean = 1.0 + over_bins(model, backscatter, extinction, 800.0)
    silent = np.sum(np.log1p(-np.exp(-model.threshold / mean)))
    silent += (BINS - len(mean)) * np.log1p(-np.exp(-model.threshold))
    expected = -np.expm1(silent)
    found = measure(model, 800.0, speed_of(800.0))
    for segment in (0, 2):
        rate = np.mean((found.segments & (1 << segment)) > 0)
        assert rate == pytest.approx(
            expected, abs=3.0 * np.sqrt(max(expected * (1.0 - expected), 1e-4) / SHOTS) + 1e-3
        )


def test_the_highest_bin_of_a_chirp_lies_where_it_does_among_exponential_numbers() -> None:
    model = model_of(*DENSE)
    mean = 1.0 + over_bins(model, *DENSE, 800.0)
    rng = np.random.default_rng(3)
    expected = np.concatenate(
        [(mean * rng.exponential(size=(1000, len(mean)))).argmax(axis=1) for _ in range(10)]
    )
    found = measure(model, 800.0, speed_of(800.0)).segment_peak_hz[:, 0, 2] / WAVEFORM.bin_width_hz - 800.0
    for edge in np.quantile(expected, (0.25, 0.5, 0.75)):
        share = np.mean(expected <= edge)
        assert np.mean(found <= edge + 0.5) == pytest.approx(share, abs=3.5 * np.sqrt(0.25 / SHOTS))


def test_constant_segment_has_one_fading_line() -> None:
    """All haze is in one bin, and its power is exponential."""
    model = model_of(1e-7, 2e-3)
    snr = over_bins(model, 1e-7, 2e-3, 800.0).sum()
    expected = np.exp(-model.threshold / (1.0 + snr))
    assert 0.2 < expected < 0.8
    found = measure(model, 800.0, speed_of(800.0))
    detected = (found.segments[:, 0] & 2) > 0
    assert np.mean(detected) == pytest.approx(expected, abs=3.0 * np.sqrt(0.25 / SHOTS))
    bins = found.segment_peak_hz[detected, 0, 1] / WAVEFORM.bin_width_hz
    assert np.mean(np.abs(bins - 800.0) < 0.6) > 0.99


def test_wind_parts_the_lines_of_haze_and_ground() -> None:
    """Both are strong: the stronger one is reported, the other one is a second target."""
    model = model_of(1e-6, 2e-3)
    one = np.ones((200, 1, 1))
    bright_w = 30.0 * over_bins(model, 1e-6, 2e-3, 800.0).sum() / model.snr_per_w
    for power_w, expected in ((bright_w, 800.0), (1e-18, 600.0)):
        beams = echoes(800.0 * one, speed_of(800.0) * one, power_w=power_w * one)
        beams = beams._replace(air_speed_mps=np.full((200, 1), speed_of(600.0)))
        found = receive(model, beams, np.arange(200), 1).segment_peak_hz[:, 0, 1] / WAVEFORM.bin_width_hz
        assert np.nanmedian(found) == pytest.approx(expected, abs=0.6)


def test_without_backscatter_the_air_only_dims() -> None:
    clear = build_receiver(INSTRUMENT)
    for air in (model_of(0.0, 1e-2), model_of(0.0, 0.0)):
        for got, without in zip(
            vars(measure(air, 500.0, 5.0, 100, 1e-13)).values(),
            vars(measure(clear, 500.0, 5.0, 100, 1e-13)).values(),
            strict=True,
        ):
            np.testing.assert_array_equal(got, without)


def test_a_beam_that_hits_nothing_sees_haze_up_to_the_record_edge() -> None:
    model = model_of(*DENSE)
    one = np.ones((200, 1, 1))
    sky = echoes(np.nan * one, np.nan * one, power_w=0.0 * one)
    sky = sky._replace(air_speed_mps=np.full((200, 1), speed_of(800.0)))
    found = receive(model, sky, np.arange(200), 1)
    assert np.mean(found.range_valid) > 0.9
    assert np.nanmedian(found.range_m) < 200.0


@pytest.mark.parametrize("wind_mps", [0.0, 3.0])
def test_the_truth_names_haze_where_a_peak_is_not_the_surfaces(wind_mps: float) -> None:
    """A peak beyond ten bins of the surface's beat is the haze's: noise alone hardly exceeds the threshold."""
    model, shots = model_of(*DENSE), 2000
    one = np.ones((shots, 1))
    ground, speed_mps = 400.0 * one, 12.0 * one
    air_mps = speed_mps + wind_mps
    beams = echoes(ground[..., None], speed_mps[..., None], power_w=4e-13 * one[..., None])
    found = receive(model, beams._replace(air_speed_mps=air_mps), np.arange(shots), 1)
    peaks_bin = found.segment_peak_hz / WAVEFORM.bin_width_hz
    beats_bin = np.array([400.0 / WAVEFORM.range_bin_m, 0.0, 400.0 / WAVEFORM.range_bin_m])
    beats_bin += 12.0 / WAVEFORM.speed_bin_mps * np.array([-1.0, 1.0, 1.0])
    wrong = (np.abs(peaks_bin - np.abs(beats_bin)) > 10.0).any(axis=-1)
    assert wrong.mean() > 0.1
    assert wind_mps > 0.0 or wrong.mean() < 0.9
    source = false_targets(model, found.segment_peak_hz, ground, speed_mps, air_speed_mps=air_mps)
    np.testing.assert_array_equal(source, np.where(wrong, FalseTarget.HAZE, FalseTarget.NONE))
    clear = false_targets(model, found.segment_peak_hz, ground, speed_mps)
    assert (clear == FalseTarget.NONE).all()


def test_a_noise_peak_far_out_in_thin_haze_has_no_source() -> None:
    model, shots = model_of(1e-9, 1e-4), 1000
    one = np.ones((shots, 1))
    at_bin = np.linspace(100.0, 3000.0, shots)[:, None]
    peaks_hz = np.stack([at_bin, at_bin, at_bin], axis=-1) * WAVEFORM.bin_width_hz
    source = false_targets(model, peaks_hz, 4000.0 * one, 0.0 * one, air_speed_mps=0.0 * one)
    assert (source == FalseTarget.NONE).all()
