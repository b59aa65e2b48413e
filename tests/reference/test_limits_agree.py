"""What every level refuses: frequencies that belong to no one surface, and a sensor that meets the ground."""

from __future__ import annotations

import numpy as np
import pytest
from beamlet_samples import measure_echoes
from scipy.constants import speed_of_light

import lidar_emu
from lidar_emu.errors import InputError
from lidar_emu.receiver.receiver import receive
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.residual_limit import build_residual_limit, largest_residual_bin
from lidar_emu.receiver.returns import Echoes, Reason, Returns
from lidar_emu.scenario.instrument import Detection, Instrument, Receiver, Waveform
from lidar_emu.scenario.load import load

LEVELS = ("spectral", "waveform")
SHORT = Waveform(fft_length=1024, segment_time_s=10e-6, chirp_slope_hz_per_s=2e13, linewidth_hz=0.0)
"""1.7 us of 600 MS/s: bins of 4.4 m and 0.45 m/s, a record edge at 1243 m, and beats within Nyquist up to 2249 m."""
EDGE_M = SHORT.record_edge_range_m
PLAIN = Receiver(bandwidth_hz=None, ac_coupling_hz=0.0, adc=None)


def _instrument(combine: str = "least_squares") -> Instrument:
    detection = Detection(combine=combine, peak="hann", maximum_range_m=1200.0)
    return Instrument(waveform=SHORT, receiver=PLAIN, detection=detection)


def _echoes(
    instrument: Instrument,
    range_m: np.ndarray,
    speed_mps: float,
    snr_db: float = 40.0,
    range_rate_mps: float = 0.0,
    power_w: float | None = None,
) -> Echoes:
    """Shots of one beam, (shots, beamlets) of range, each with a speckle of its own."""
    every = np.ones((range_m.shape[0], 1, range_m.shape[1]))
    still = np.zeros(every.shape[:2])
    place = np.stack([10.3 * np.arange(len(every))[:, None], still + 0.6], axis=-1)
    if power_w is None:
        power_w = 10 ** (snr_db / 10) / build_receiver(instrument).snr_per_w / range_m.shape[1]
    return Echoes(
        every * range_m[:, None],
        every * speed_mps,
        every * power_w,
        every * range_rate_mps,
        still,
        still,
        still,
        still,
        place,
        0.0 * place,
        still == 0.0,
        still != 0.0,
    )


def _measure(level: str, instrument: Instrument, echoes: Echoes) -> Returns:
    model = build_receiver(instrument)
    shot = np.arange(len(echoes.fired))
    if level == "waveform":
        return measure_echoes(instrument, model, echoes, shot, 5)
    return receive(model, echoes, shot, 5)


@pytest.mark.parametrize("level", LEVELS)
def test_beyond_the_record_edge_nothing_is_valid_by_a_gross_residual(level: str) -> None:
    """Bright surfaces of which the record misses a part: no signs and folds explain them within the edge."""
    instrument = _instrument()
    beyond_m = np.linspace(EDGE_M + 20.0, EDGE_M + 150.0, 120)[:, None]
    found = _measure(level, instrument, _echoes(instrument, beyond_m, 92.0, 50.0))
    assert (found.segments == 7).mean() > 0.8
    residual_bin = 2.0 * abs(found.residual_mps) / SHORT.speed_bin_mps
    valid = found.range_valid
    # An explanation within the edge is found by a correction of hundreds of bins, in proportion to the variances.
    assert (residual_bin > 100.0).mean() > 0.7
    assert valid.mean() < 0.05
    assert set(found.reason[~valid].tolist()) <= {
        Reason.AMBIGUOUS,
        Reason.BEYOND_RANGE,
        Reason.BELOW_THRESHOLD,
    }


@pytest.mark.parametrize("level", ["spectral", pytest.param("waveform", marks=pytest.mark.slow)])
def test_a_false_lock_is_refused(level: str) -> None:
    """Echoes near the threshold: segments lock on noise, and the residual is uniform over hundreds of bins."""
    instrument = _instrument()
    truth_m, truth_mps = 700.0, 40.0
    # Without speckle the share of false locks does not depend on it, and is alike at all levels.
    optics = instrument.optics.model_copy(update={"speckle": False})
    detection = instrument.detection.model_copy(update={"false_alarm_probability": 0.5})
    instrument = instrument.model_copy(update={"optics": optics, "detection": detection})
    shots = 1000 if level == "waveform" else 8000
    found = _measure(level, instrument, _echoes(instrument, np.full((shots, 1), truth_m), truth_mps, 9.0))
    located = found.segments == 7
    peaks_bin = found.segment_peak_hz / SHORT.bin_width_hz
    beat, doppler = truth_m / SHORT.range_bin_m, truth_mps / SHORT.speed_bin_mps
    true_bin = np.abs([beat - doppler, doppler, beat + doppler])
    wrong = located & (np.abs(peaks_bin - true_bin) > 3.0).any(axis=-1)
    assert wrong.sum() > 50
    # Four residuals by their signs, each within ± five bins of N: one and a half by depth and motion, the rest noise.
    expected = 4 * 2 * 5.0 / SHORT.fft_length
    passed = (found.range_valid & wrong).sum() / wrong.sum()
    assert passed < expected + 3 * np.sqrt(expected / wrong.sum())
    # Locks on the right bins pass, up to the heavy tails of an estimate at 9 dB.
    assert found.range_valid[located & ~wrong].mean() > 0.95


@pytest.mark.parametrize("level", LEVELS)
def test_a_steep_slope_is_one_surface(level: str) -> None:
    """80 degrees of incidence with speckle: peaks wander over the line, and every lock is correct and valid."""
    instrument = _instrument()
    radius_m = (
        0.5 * build_residual_limit(instrument).waist_depth_bin / np.tan(np.radians(89.0)) * SHORT.range_bin_m
    )
    across = np.linspace(-1.0, 1.0, 19)
    slope_m = 700.0 + 2.0 * radius_m * np.tan(np.radians(80.0)) * across
    found = _measure(level, instrument, _echoes(instrument, np.tile(slope_m, (100, 1)), 40.0, 50.0))
    located = found.segments == 7
    assert located.mean() > 0.9
    assert found.range_valid[located].all()


@pytest.mark.parametrize("level", LEVELS)
def test_the_published_detector_has_no_check(level: str) -> None:
    instrument = _instrument("chirp_minus_doppler")
    beyond_m = np.linspace(EDGE_M + 20.0, EDGE_M + 150.0, 60)[:, None]
    found = _measure(level, instrument, _echoes(instrument, beyond_m, 92.0, 50.0))
    located = found.segments == 7
    assert not (found.reason[located] == Reason.AMBIGUOUS).any()


@pytest.mark.parametrize("level", LEVELS)
def test_a_sensor_that_meets_the_ground_within_the_measurement_has_a_reason(level: str) -> None:
    """Descent at 100 m/s: in 10 us between the records it moves by 1 mm; linewidth on, whose drift needs the delay."""
    waveform = SHORT.model_copy(update={"linewidth_hz": 3e3})
    instrument = _instrument().model_copy(update={"waveform": waveform})
    range_m = np.array([[0.9e-3], [1.1e-3]])
    found = _measure(level, instrument, _echoes(instrument, range_m, 100.0, range_rate_mps=-100.0))
    assert found.reason[0, 0] == Reason.INSIDE_GROUND
    assert found.reason[1, 0] != Reason.INSIDE_GROUND
    away = _measure(level, instrument, _echoes(instrument, range_m, -100.0, range_rate_mps=100.0))
    assert (away.reason == Reason.INSIDE_GROUND)[:, 0].tolist() == [True, False]


def test_limit_of_the_shipped_instrument() -> None:
    """By hand at 2 km and 50 m/s: 2 x 0.0605 m x 57.3 is 20.2 bins; 50 m/s x 0.9 ms 0.13; 4 x 3 kHz 2.6; and 1."""
    limit = build_residual_limit(Instrument())
    waveform = Waveform()
    range_bin, doppler_bin = 2000.0 / waveform.range_bin_m, 50.0 / waveform.speed_bin_mps
    assert waveform.range_bin_m == pytest.approx(speed_of_light * waveform.bin_width_hz / 4e12)
    found = largest_residual_bin(limit, range_bin, doppler_bin, 0.0, 0.0)
    assert found == pytest.approx(20.2 + 0.13 + 2.62 + 1.0, abs=0.1)
    assert largest_residual_bin(limit, range_bin, doppler_bin, 0.5, 0.0) == pytest.approx(
        found + 3 * 0.5**0.5
    )
    # A line with a second moment of 0.3 bin² is no slope's: 4 x 0.55 bins in place of the depth.
    narrow = largest_residual_bin(limit, range_bin, doppler_bin, 0.0, 0.3)
    assert narrow == pytest.approx(2.19 + 0.13 + 2.62 + 1.0, abs=0.1)
    looks = Instrument(detection=Detection(looks=4))
    # Three cycles of 0.9 ms at 30 m/s² change the speed by 22.8 bins, the way grows by 0.4 bins.
    assert largest_residual_bin(
        build_residual_limit(looks), range_bin, doppler_bin, 0.0, 0.0
    ) == pytest.approx(found + 2 * 22.83 + 0.39, abs=0.1)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("instrument.optics.alignment_error_rad", "1000"),
        ("trajectory.attitude.body_rate_radps", "[60, 0, 0]"),
    ],
)
def test_footprints_that_would_take_all_memory_are_refused(key: str, value: str) -> None:
    with pytest.raises(InputError, match="scatterers in a footprint; take spectral"):
        lidar_emu.simulate(load("descent", {"level": "reference", "duration_s": "1", key: value}))


def test_no_light_is_below_threshold_at_the_reference() -> None:
    """The SNR of a watt underflows to 0."""
    keys = {"level": "reference", "duration_s": "0.05", "instrument.optics.heterodyne_efficiency": "5e-324"}
    assert set(lidar_emu.simulate(load("descent", keys)).reason.flat) == {Reason.BELOW_THRESHOLD}
