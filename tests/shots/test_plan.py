"""The plan leaves out what a scene does not need, within the bound that it states."""

from __future__ import annotations

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.beams.flight import Flight
from lidar_emu.plan.flight import ONE_BEAMLET_BELOW_BINS
from lidar_emu.plan.spectral_spread import spread_bins
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model

LOW = {
    "kind": "profile",
    "waypoints": [{"altitude_m": 300, "speed_mps": 4}, {"altitude_m": 280, "speed_mps": 4}],
}
FAST = {
    "kind": "profile",
    "waypoints": [{"altitude_m": 2000, "speed_mps": 99}, {"altitude_m": 1900, "speed_mps": 99}],
}


def stages(model, computed):
    return {d.stage for d in model.plan.decisions if d.computed is computed}


def widest(scenario: FlightScenario) -> float:
    flight = Flight(scenario)
    pointing, _ = flight.point(np.arange(flight.shot_count), flight.scanner.initial)
    hits = flight.cast(pointing)
    spread = spread_bins(scenario.instrument, pointing, hits)
    return float(np.sqrt(np.maximum(spread.variance(1.0, 1.0), spread.variance(1.0, -1.0)).max()))


def test_a_slow_low_flight_over_a_plane_needs_one_beamlet(make_flight):
    slow, fast = build_model(make_flight(trajectory=LOW)), build_model(make_flight(trajectory=FAST))
    assert slow.plan.beamlets == 1
    assert "footprint" in stages(slow, False)
    assert fast.plan.beamlets == 19
    assert "footprint" in stages(fast, True)


def test_one_beamlet_measures_what_the_whole_footprint_does(make_flight, monkeypatch):
    few = simulate(make_flight(trajectory=LOW))
    monkeypatch.setattr("lidar_emu.plan.flight.ONE_BEAMLET_BELOW_BINS", 0.0)
    many = simulate(make_flight(trajectory=LOW))
    spread = widest(make_flight(trajectory=LOW))
    loss_db = -10 * np.log10(1 - np.pi**2 / 3 * spread**2)
    # Same noise, same phase: what differs is the width of the footprint's spectrum.
    assert np.max(np.abs(few.snr_db - many.snr_db)) < 2 * loss_db + 0.02
    assert np.max(np.abs(few.range_m - many.range_m) / few.sigma_range_m) < 1
    assert np.max(np.abs(few.closing_speed_mps - many.closing_speed_mps) / few.sigma_speed_mps) < 1


def test_spread_of_a_hovering_beam_is_that_of_the_slant(make_flight):
    waypoints = [{"altitude_m": 2000, "speed_mps": 1e-6}, {"altitude_m": 1999.9999, "speed_mps": 1e-6}]
    hover = {"kind": "profile", "waypoints": waypoints}
    scenario = make_flight(trajectory=hover, timing={"rate_hz": 1})
    slant_m = 2000 / np.cos(np.radians(22.5))
    radius_m = 0.017 * np.sqrt(1 + (1550e-9 * slant_m / (np.pi * 0.017**2)) ** 2)
    rms_m = radius_m / np.sqrt(8) * np.tan(np.radians(22.5))
    bins = rms_m / 0.343085
    assert widest(scenario) == pytest.approx(bins, rel=1e-3)
    assert bins < ONE_BEAMLET_BELOW_BINS


def test_vacuum_and_air(make_flight):
    assert "extinction" in stages(build_model(make_flight()), False)
    air = {"ground": {"kind": "plane"}, "atmosphere": {"extinction_per_m": 1e-4}}
    thick, clear = simulate(make_flight(site=air)), simulate(make_flight())
    assert "extinction" in stages(build_model(make_flight(site=air)), True)
    lost_db = 20 * np.log10(np.e) * 1e-4 * clear.true_range_m
    # The noise is the same in both and adds a few tenths of a decibel of its own.
    np.testing.assert_allclose(np.mean(clear.snr_db - thick.snr_db - lost_db), 0, atol=0.05)


def test_a_bench_pattern_computes_nothing_else():
    from lidar_emu.scenario.load import load

    assert stages(build_model(load("bench.yaml")), True) == {"pattern"}


def test_bounds_of_what_is_left_out_follow_the_flight():
    from lidar_emu.scenario.load import load

    decisions = build_model(load("descent.yaml")).plan.decisions
    bounds = {d.stage: d.bound for d in decisions}
    reasons = {d.stage: d.reason for d in decisions}
    # c T a / (lambda S) with a = (100² - 32²) / 3000 m/s² along beams at 22.5 degrees; the outer beams at 2000 m
    # reach 828 m.
    along_mps2 = 2.992 * np.cos(np.radians(22.5))
    bias_m = 299792458 * 300e-6 * along_mps2 / (1550e-9 * 2e12)
    assert f"makes {bias_m:.2g} m of range" in reasons["motion in a shot"]
    away_m = 2000 * np.tan(np.radians(22.5))
    assert bounds["curvature of the grid"].startswith(f"{away_m**2 / 2 / 1737.4e3:.2g} m")


@pytest.mark.parametrize(("spin_radps", "narrow"), [(15.0, False), (30.0, True)])
def test_a_beam_that_turns_too_fast_has_lines_of_a_bounded_width(
    make_flight, spin_radps: float, narrow: bool
) -> None:
    """At 22.5 degrees the beam turns at 0.38 of the spin; the limit is 61.6 waists a record, of λ/(π w0) each."""
    spinning = FAST | {"attitude": {"body_rate_radps": (0.0, 0.0, spin_radps)}}
    decisions = build_model(make_flight(trajectory=spinning, instrument={})).plan.decisions
    (decision,) = (each for each in decisions if each.stage == "speckle within a record")
    assert decision.computed
    assert ("as wide as of 61.6 waists" in decision.bound) is narrow


@pytest.mark.parametrize(("steps", "is_white"), [(1.9, True), (2.1, False)])
def test_a_digitiser_whose_steps_hide_the_noise_is_stated(make_flight, steps, is_white):
    # Shot, dark, thermal and intensity noise of the default receiver, behind a pole of 300 MHz: pi/2 of it is passed.
    density_a2_per_hz = 2 * 1.602177e-19 * (1e-3 + 1e-8) + 4 * 1.380649e-23 * 300 / 2000 + 1e-15 * 1e-3 * 1e-6
    noise_v = 2000 * np.sqrt(density_a2_per_hz * np.pi / 2 * 300e6)
    adc = {"effective_bits": 8, "full_scale_v": float(256 * steps * noise_v)}
    plan = build_model(make_flight(instrument={"receiver": {"adc": adc}})).plan
    (bound,) = [d.bound for d in plan.decisions if d.stage == "digitiser"]
    assert ("not white" in bound) is not is_white
