"""Errors expected from closed forms, against the errors of simulated flights."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import exp1

from lidar_emu.plan.expected_error import expected_error, exponential_integral
from lidar_emu.runtime.summary import planned_summary
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_whole

FLIGHTS = {
    "published": {},
    "fine": {"instrument": "ndl_fine"},
    "steady echoes": {"instrument.optics.speckle": "off", "instrument.detection.peak": "hann"},
    "little light": {"instrument": "ndl_fine", "instrument.optics.laser_power_w": "0.03"},
    "wrong slope": {"instrument.waveform.slope_error": "2e-4"},
    "uneven slopes": {"instrument": "ndl_fine", "instrument.waveform.slope_scatter": "2e-4"},
    "1/f noise": {"instrument": "ndl_fine", "instrument.waveform.flicker_hz2": "1e8"},
    "several looks": {
        "scenario": "paper_fig5",
        "timing.rate_hz": "20",
        "instrument": "{base: ndl_fine, detection: {looks: 4}}",
        "trajectory": "{kind: profile, path_angle_deg: 20, waypoints: [{altitude_m: 400, speed_mps: 20},"
        " {altitude_m: 300, speed_mps: 19.9}]}",
    },
    "oblique": {"scenario": "paper_fig5", "timing.rate_hz": "20", "instrument": "ndl_fine"},
    "one beamlet": {"instrument": "ndl_fine", "instrument.optics.beamlets": "1"},
}


def test_the_exponential_integral_is_scipys():
    x = np.geomspace(1e-12, 100.0, 2001)
    np.testing.assert_allclose(exponential_integral(x), exp1(x), rtol=2e-7)


@pytest.mark.parametrize("name", FLIGHTS)
def test_expectation_beside_a_flight(name):
    settings = {"scenario": "descent"} | FLIGHTS[name]
    scenario = load(settings.pop("scenario"), settings)
    model = build_model(scenario)
    expected = expected_error(scenario, model.flight, model.plan.beamlets)
    run = measure_whole(model)
    range_m, speed_mps = run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps
    # A false lock is kilometres off.
    good = np.abs(range_m) < 5.0
    assert expected.range_rms_m == pytest.approx(np.sqrt(np.mean(range_m[good] ** 2)), rel=0.2)
    assert expected.speed_rms_mps == pytest.approx(np.sqrt(np.mean(speed_mps[good] ** 2)), rel=0.2)
    assert expected.range_bias_m == pytest.approx(np.mean(range_m[good]), rel=0.1, abs=0.005)
    assert expected.speed_bias_mps == pytest.approx(np.mean(speed_mps[good]), rel=0.2, abs=5e-5)
    assert expected.dropout == pytest.approx(1.0 - run.range_valid[run.fired].mean(), rel=0.2, abs=0.035)


def test_level_geometric_has_no_errors():
    scenario = load("descent.yaml", {"level": "geometric"})
    model = build_model(scenario)
    assert set(expected_error(scenario, model.flight, 1).to_json().values()) == {0.0}


def test_the_dark_expects_nothing_but_dropouts():
    scenario = load("descent.yaml", {"instrument.optics.laser_power_w": "1e-12"})
    model = build_model(scenario)
    assert expected_error(scenario, model.flight, model.plan.beamlets).dropout == pytest.approx(1.0, abs=1e-6)


def test_a_bench_pattern_has_no_expectation():
    scenario = load("bench.yaml", {})
    reported = planned_summary(scenario, build_model(scenario))
    assert {value for name, value in reported.items() if name.startswith("expected_")} == {None}
