"""Flights measured by scatterers: their power, their speckle, and what they refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exchanged_speckle import robust, scatter

from lidar_emu.api import simulate
from lidar_emu.beams.flight import Flight
from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.receiver.link_budget import coherent_power_w
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import FalseTarget
from lidar_emu.reference.laser_sweep import frequency_plan
from lidar_emu.reference.level import ScattererLevel
from lidar_emu.reference.record_light import record_light
from lidar_emu.reference.records import record_span_s
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model

NARROWBAND = {"level": "reference"}
QUIET = "{base: ndl_fine, waveform: {linewidth_hz: 0}, receiver: {adc: null, bandwidth_hz: null, ac_coupling_hz: 0}}"


def level_flight(
    altitude_m: float, path_deg: float, speed_mps: float, tilt_deg: float, shots: int
) -> dict[str, str]:
    """One beam over the flat site, tilted forward, at one altitude but for what it sinks in the shots."""
    sunk_m = shots * 0.01 * speed_mps * float(np.sin(np.radians(path_deg)))
    waypoints = [{"altitude_m": altitude_m + side * sunk_m, "speed_mps": speed_mps} for side in (0.5, -0.6)]
    return {
        "timing.rate_hz": "100",
        "duration_s": str(0.01 * shots),
        "instrument": QUIET,
        "site": "{base: flat, surface: {lommel_seeliger_share: 1}}",
        "scanner": f"{{pattern: {{kind: directions, beams: [[{tilt_deg}, 0]]}}}}",
        "trajectory": f"{{kind: profile, path_angle_deg: {path_deg}, waypoints: {waypoints}}}".replace(
            "'", ""
        ),
    }


def flown(settings: dict[str, str], **more: Any) -> tuple[FlightScenario, Measurement]:
    scenario = load("descent", settings | NARROWBAND | more)
    assert isinstance(scenario, FlightScenario)
    return scenario, simulate(scenario)


@pytest.mark.parametrize(
    ("altitude_m", "tilt_deg", "site"),
    [
        (30.0, 0.0, {}),
        (300.0, 22.5, {"site.surface": "{reflectance: 0.3, lommel_seeliger_share: 0.4}"}),
        (2000.0, 7.5, {"site.atmosphere": "{extinction_per_m: 1.0e-4}"}),
        (8000.0, 22.5, {"instrument.optics.alignment_error_rad": "1.0e-5"}),
    ],
)
def test_mean_power_is_that_of_the_link_budget(
    altitude_m: float, tilt_deg: float, site: dict[str, str]
) -> None:
    """Over 64 draws of 50 effective cells each, within four standard deviations."""
    shots = 64
    scenario = load("descent", level_flight(altitude_m, 45.0, 20.0, tilt_deg, shots) | NARROWBAND | site)
    assert isinstance(scenario, FlightScenario)
    flight, waveform = Flight(scenario), scenario.instrument.waveform
    model = build_receiver(scenario.instrument, scenario.site, left_out_share=0.0)
    pointing, _ = flight.point(np.arange(shots), flight.scanner.initial)
    hits = flight.cast(pointing)
    level = ScattererLevel(scenario, flight)
    constant = frequency_plan(waveform)[1]
    powers = []
    for s in range(shots):
        rng = np.random.default_rng(s)
        poses_at = level._poses(pointing, s, 0)
        scatterers, _ = level._strew(pointing, poses_at, float(hits.range_m[s, 0]), rng, s, 0)
        span_s = record_span_s(waveform, level._response)
        light = record_light(level._sampling.mode, constant, poses_at, scatterers, *span_s)
        middle = np.abs(np.exp(light.coefficients[:, 0])) ** 2
        powers.append(middle.sum())
    cosine = -np.sum(hits.normal_site * pointing.true_site, axis=-1)
    surface, air = scenario.site.surface, scenario.site.atmosphere
    expected_w = coherent_power_w(scenario.instrument, surface, air, hits.range_m, cosine)
    ratio = np.array(powers) / (expected_w[:, 0] * model.snr_per_w)
    assert ratio.mean() == pytest.approx(1.0, abs=4.0 * ratio.std() / np.sqrt(shots))
    assert ratio.std() < 0.25


@pytest.mark.slow
def test_exchange_of_scatterers_within_a_record_scatters_sub_bin_peaks() -> None:
    """40 m/s over ground 300 m below: 26 mm, where a field that is constant within a record has 1.6 mm or 12 mm."""
    _, run = flown(level_flight(300.0, 2.9, 40.05, 0.0, shots=300))
    valid = run.range_valid
    assert valid.mean() > 0.97
    expected = scatter(40.0, float(np.nanmean(10.0 ** (0.1 * run.snr_db))))
    assert expected == pytest.approx((0.026, 2.5e-4), rel=0.05)
    for error, deviation in zip(
        (run.range_m - run.true_range_m, run.closing_speed_mps - run.true_closing_speed_mps),
        expected,
        strict=True,
    ):
        assert robust(error[valid]) == pytest.approx(deviation, rel=0.25)


@pytest.mark.slow
def test_all_samples_and_the_narrowband_measure_the_same_echoes() -> None:
    """The scatterers of a seed are the same, the noise is not: errors agree far within the scatter by speckle."""
    settings = level_flight(100.0, 5.7, 20.1, 7.5, shots=4)
    _, narrow = flown(settings)
    _, whole = flown(settings, reference_samples="full_rate")
    both = narrow.range_valid & whole.range_valid
    assert both.sum() >= 3
    np.testing.assert_allclose(narrow.range_m[both], whole.range_m[both], atol=0.02)
    np.testing.assert_allclose(narrow.closing_speed_mps[both], whole.closing_speed_mps[both], atol=2e-4)
    np.testing.assert_allclose(narrow.snr_db[both], whole.snr_db[both], atol=0.5)


def test_beams_that_meet_nothing_hold_noise_alone() -> None:
    settings = level_flight(300.0, 5.7, 20.1, 0.0, shots=2)
    settings["scanner"] = "{pattern: {kind: directions, beams: [[0, 0], [89, 0]]}}"
    settings["mounting"] = "{pitch_deg: 20}"
    _, run = flown(settings)
    assert run.range_valid[:, 0].all()
    assert not run.range_valid[:, 1].any()
    assert set(run.reason[:, 1]) <= {int(run.reason[0, 1])}


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"level": "spectral", "reference_samples": "full_rate"}, "reference_samples"),
        ({"instrument.optics.speckle": "false"}, "speckle"),
        ({"instrument.detection.looks": "2", "timing.rate_hz": "10"}, "looks"),
    ],
)
def test_what_scatterers_cannot_do_is_refused(changes: dict[str, str], key: str) -> None:
    with pytest.raises(InputError, match=key):
        load("descent", level_flight(300.0, 90.0, 5.0, 0.0, 2) | NARROWBAND | changes)


def test_faults_of_light_are_refused() -> None:
    fault = "[{kind: laser_fade, loss_db: 3}]"
    with pytest.raises(InputError, match="laser_fade at level reference; use level spectral"):
        flown(level_flight(300.0, 90.0, 5.0, 0.0, 2), faults=fault)


def test_recorded_geometry_is_refused(tmp_path: Path) -> None:
    from click.testing import CliRunner

    from lidar_emu.cli import cli

    file = tmp_path / "flight.npz"
    record = ["simulate", "descent", "--duration", "0.1", "--out", str(tmp_path / "a.csv")]
    assert CliRunner().invoke(cli, [*record, "--geometry-out", str(file)]).exit_code == 0
    scenario = load("descent", NARROWBAND | {"duration_s": "0.1", "instrument.detection.peak": "hann"})
    with pytest.raises(InputError, match="level: reference with a recorded geometry; leave out --geometry"):
        build_model(scenario, file)


def test_rolling_about_a_lever_arm_biases_the_range(tmp_path: Path) -> None:
    """±0.2° at 3 Hz, 3 m to the side: the closing speed changes by 3.7 m/s², which biases by c T a/(λ S), 10.8 cm."""
    amplitude_rad, rate_radps, arm_m, shots = np.radians(0.2), 2.0 * np.pi * 3.0, 3.0, 24
    time_s = np.arange(0.0, 2.0, 0.005)
    roll_deg = np.degrees(amplitude_rad * np.sin(rate_radps * time_s))
    rows = [f"{t:.3f},{r:.12f},{300.0 - 5.0 * t:.6f}\n" for t, r in zip(time_s, roll_deg, strict=True)]
    (tmp_path / "roll.csv").write_text("t,roll,up\n" + "".join(rows))
    table = (
        "{kind: table, file: roll.csv, time: {column: t, unit: s}, roll: {column: roll, unit: deg}, "
        "up: {column: up, unit: m}}"
    )
    (tmp_path / "rolling.yaml").write_text(
        f"name: rolling\ntiming: {{rate_hz: 17}}\nduration_s: {shots / 17 + 0.001}\ninstrument: {QUIET}\n"
        f"site: flat\nscanner: {{pattern: {{kind: directions, beams: [[0, 0]]}}}}\n"
        f"mounting: {{lever_arm_m: [0, {arm_m}, 0]}}\ntrajectory: {table}\n"
        "level: reference\n"
    )
    scenario = load(str(tmp_path / "rolling.yaml"), {})
    assert isinstance(scenario, FlightScenario)
    run, waveform = simulate(scenario), scenario.instrument.waveform
    angle = amplitude_rad * np.sin(rate_radps * 1e-9 * run.time_ns[:, 0])
    # Right side down: the sensor sinks by 3 m times the angle, at a closing acceleration of -ω² times that.
    acceleration_mps2 = -(rate_radps**2) * arm_m * angle
    bias_m = 299_792_458.0 * waveform.segment_time_s * acceleration_mps2
    bias_m /= waveform.wavelength_m * waveform.chirp_slope_hz_per_s
    assert np.abs(bias_m).max() > 0.1
    error_m = (run.range_m - run.true_range_m)[:, 0]
    seen = run.range_valid[:, 0]
    found = error_m[seen] @ bias_m[seen] / (bias_m[seen] @ bias_m[seen])
    assert found == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("samples", ["narrowband", "full_rate"])
def test_chirps_lock_onto_a_back_reflection(samples: str) -> None:
    settings = level_flight(1000.0, 45.0, 20.0, 0.0, shots=1)
    scenario, run = flown(
        settings, reference_samples=samples, **{"instrument.optics.back_reflection_db": "-60"}
    )
    assert (run.true_peak_source == FalseTarget.BACK_REFLECTION).all()
    (row,) = (each for each in build_model(scenario).plan.decisions if each.stage == "back-reflection")
    assert row.computed


def test_chirps_lock_onto_a_side_line_of_a_ripple() -> None:
    """At an index of 1.84 the first side lines are the strongest."""
    keys = {"ripple_hz": "5.8e4", "ripple_frequency_hz": "6e4"}
    settings = level_flight(1000.0, 45.0, 20.0, 0.0, shots=4)
    _, run = flown(settings, **{f"instrument.waveform.{key}": value for key, value in keys.items()})
    assert (run.true_peak_source == FalseTarget.SIDE_LINE).sum() >= 3
