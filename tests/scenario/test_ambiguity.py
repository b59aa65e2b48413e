"""What an instrument cannot tell from other ranges and speeds is stated at load and in the plan."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from lidar_emu import errors
from lidar_emu.api import simulate
from lidar_emu.scenario.instrument import Waveform
from lidar_emu.scenario.load import ambiguities, load, shipped_scenarios
from lidar_emu.shots.model import build_model

SLOW_DIGITISER = {
    "duration_s": "1",
    "site": "flat",
    "instrument.waveform.sample_rate_hz": "20e6",
    "instrument.waveform.fft_length": "4096",
    "instrument.receiver.bandwidth_hz": "null",
    "instrument.receiver.ac_coupling_hz": "0",
    "instrument.detection.peak": "hann",
    "instrument.detection.combine": "least_squares",
    "trajectory": "{kind: profile, path_angle_deg: 90, waypoints: "
    "[{altitude_m: 1300, speed_mps: 2}, {altitude_m: 1290, speed_mps: 2}]}",
    "scanner": "{pattern: {kind: directions, beams: [[0, 0]]}}",
}
"""20 MS/s: half of it is the beat of 749.48 m, or the Doppler shift of 7.75 m/s."""


@pytest.fixture
def warnings(monkeypatch, caplog):
    monkeypatch.setattr(errors, "_noted", set())
    caplog.set_level(logging.WARNING)
    return caplog


def test_shipped_scenarios_are_unambiguous(warnings):
    for name in shipped_scenarios():
        assert ambiguities(load(name)) == []
    assert not warnings.records


def test_load_warns_in_one_line(warnings):
    load(
        "descent.yaml",
        {"instrument.waveform.sample_rate_hz": "20e6", "instrument.waveform.fft_length": "4096"},
    )
    ranges, speeds = (record.getMessage() for record in warnings.records)
    for word in ("descent.yaml", "maximum_range_m: 12000", "749.481 m", "12000 m reads as 8.30"):
        assert word in ranges
    for word in ("descent.yaml", "waypoints: 100 m/s", "7.75 m/s", "100 m/s reads as 7 m/s"):
        assert word in speeds


def test_limits_are_half_the_sample_rate():
    waveform = Waveform()
    beat_hz = 2.0 * waveform.nyquist_range_m / 299_792_458.0 * waveform.chirp_slope_hz_per_s
    assert beat_hz == pytest.approx(300e6)
    assert 2.0 * waveform.unambiguous_speed_mps / waveform.wavelength_m == pytest.approx(300e6)


@pytest.mark.parametrize("level", ["spectral", "reference"])
def test_what_reads_wrong_is_valid_and_never_resolved(level):
    """The beat of 1300 m reads as 199 m at every level: the instrument errs, and does not claim to know."""
    overrides = SLOW_DIGITISER | {"level": level, "instrument.optics.beamlets": "1"}
    if level == "reference":
        overrides["duration_s"] = "0.3"
    run = simulate(load("descent.yaml", overrides))
    assert run.range_valid.mean() > 0.7
    assert np.median(run.range_m[run.range_valid]) == pytest.approx(199, abs=2)
    assert not run.sign_resolved.any()


@pytest.mark.parametrize("instrument", ["ndl_four_beam", "ndl_fine"])
@pytest.mark.parametrize(("speed_mps", "reads_mps"), [(100.0, 100.0), (300.0, -165.0)])
def test_an_alias_equals_its_speed_in_all_segments(instrument, speed_mps, reads_mps):
    """A Doppler shift of N more moves all three tones by N: signs are resolved among speeds up to λ fs/4 alone."""
    waypoints = (
        f"[{{altitude_m: 3500, speed_mps: {speed_mps}}}, {{altitude_m: 2500, speed_mps: {speed_mps}}}]"
    )
    flight = {
        "duration_s": "1",
        "site": "flat",
        "instrument": instrument,
        "trajectory": f"{{kind: profile, path_angle_deg: 90, waypoints: {waypoints}}}",
        "scanner": "{pattern: {kind: directions, beams: [[0, 0]]}}",
    }
    run = simulate(load("descent", flight))
    assert run.sign_resolved.mean() > 0.5
    np.testing.assert_allclose(run.closing_speed_mps[run.sign_resolved], reads_mps, atol=0.1)


def _bound(scenario):
    (line,) = [d for d in build_model(scenario).plan.decisions if d.stage == "ambiguity"]
    return line.computed, line.bound


def test_plan_states_what_a_range_and_a_speed_read_as():
    computed, bound = _bound(load("descent.yaml", SLOW_DIGITISER))
    assert computed
    assert "1300 m reads as 198.963 m" in bound
    assert "no sign is resolved" in bound
    fast = SLOW_DIGITISER | {
        "trajectory": SLOW_DIGITISER["trajectory"].replace("speed_mps: 2", "speed_mps: 10")
    }
    assert "10 m/s reads as -5.5 m/s" in _bound(load("descent.yaml", fast))[1]


def test_plan_of_an_unambiguous_flight():
    assert _bound(load("descent.yaml")) == (False, "exact")


def test_plan_states_that_the_published_detector_ignores_folds():
    """220 m/s at 2 km: the sum of beats is 310 MHz, the parts are not beyond 300."""
    flight = {
        "duration_s": "1",
        "site": "flat",
        "trajectory": "{kind: profile, path_angle_deg: 90, waypoints: "
        "[{altitude_m: 2000, speed_mps: 220}, {altitude_m: 1500, speed_mps: 220}]}",
        "scanner": "{pattern: {kind: directions, beams: [[0, 0]]}}",
    }
    assert _bound(load("descent.yaml", flight)) == (
        True,
        "the published detector ignores folds and errs there",
    )
    fine = flight | {"instrument": "ndl_fine"}
    assert _bound(load("descent.yaml", fine)) == (True, "the signs of least residual")
