"""Particles of haze: their power in closed form, and what the detector makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from moving_beams import gliding, turning

from lidar_emu.api import simulate
from lidar_emu.receiver.link_budget import haze_w_per_m
from lidar_emu.reference.laser_sweep import frequency_plan
from lidar_emu.reference.record_light import GaussianMode, PosesAt, RecordLight, record_light
from lidar_emu.reference.volume import ParticleBeam, sample
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument
from lidar_emu.scenario.load import load
from lidar_emu.scenario.site import Atmosphere

INSTRUMENT = Instrument()
WAVEFORM = INSTRUMENT.waveform
MODE = GaussianMode.of(INSTRUMENT)
UP, CONSTANT, DOWN = frequency_plan(WAVEFORM)
AIR = Atmosphere(extinction_per_m=5e-3, backscatter_per_m_sr=1e-4)
SPAN_S = -5e-4, 4.1e-4
MOTIONS = {
    "at rest": gliding([0.0, 0.0, 0.0]),
    "sideways": gliding([60.0, 0.0, -10.0]),
    "turning": turning(1.0, 2.0),
}


def light(poses_at: PosesAt, range_m: float, segment, seed: int = 1, air: Atmosphere = AIR) -> RecordLight:
    beam = ParticleBeam.of(INSTRUMENT, 1.0)
    particles, _ = sample(beam, beam.haze(air, range_m), poses_at, *SPAN_S, np.random.default_rng(seed))
    half_s = 0.5 * WAVEFORM.record_time_s
    return record_light(MODE, segment, poses_at, particles, -half_s, half_s)


def closed_form(near_m: float, far_m: float) -> float:
    """Power between two ranges: per metre, as the area of the beam and the extinction let it decrease."""
    range_m = np.linspace(near_m, far_m, 2001)
    spread = 1.0 + (range_m / MODE.rayleigh_m) ** 2
    density = haze_w_per_m(INSTRUMENT, AIR) * np.exp(-2.0 * AIR.extinction_per_m * range_m) / spread
    return float(np.trapezoid(density, range_m))


@pytest.mark.parametrize("place", [-1.0, 0.0, 1.0], ids=["begins", "middle", "ends"])
@pytest.mark.parametrize("segment", [UP, CONSTANT, DOWN], ids=["up", "constant", "down"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_power_is_that_of_the_volume(motion: str, segment, place: float) -> None:
    """Over five draws, at any time of a measurement: within 4 %."""
    range_m = 120.0
    found = []
    for seed in range(5):
        one = light(MOTIONS[motion], range_m, segment, seed)
        exponents = one.coefficients @ np.vander([place], one.coefficients.shape[1], increasing=True).T
        found.append(np.sum(np.exp(2.0 * exponents.real)))
    assert np.mean(found) == pytest.approx(closed_form(0.0, range_m), rel=0.04)


def test_chirps_spread_the_haze_from_short_range_on() -> None:
    """Each range has its own beat, less the Doppler shift of all of them."""
    speed_mps, range_m = 20.0, 150.0
    one = light(gliding([0.0, 0.0, -speed_mps]), range_m, DOWN)
    doppler_hz = 2.0 * speed_mps / WAVEFORM.wavelength_m
    beat_hz = -one.middle_frequency_hz - doppler_hz
    depth_m = beat_hz * SPEED_OF_LIGHT_MPS / (2.0 * WAVEFORM.chirp_slope_hz_per_s)
    powers = np.exp(2.0 * one.coefficients[:, 0].real)
    for near_m, far_m in ((1.0, 21.0), (50.0, 80.0), (100.0, 145.0)):
        within = (depth_m >= near_m) & (depth_m < far_m)
        assert powers[within].sum() == pytest.approx(closed_form(near_m, far_m), rel=0.1)
    assert np.all(depth_m < range_m + 1.0)


def test_constant_segment_has_the_haze_on_one_line() -> None:
    one = light(gliding([0.0, 0.0, -20.0]), 150.0, CONSTANT)
    np.testing.assert_allclose(one.middle_frequency_hz, -2.0 * 20.0 / WAVEFORM.wavelength_m, rtol=1e-4)


def test_wind_shifts_the_line_and_keeps_the_power() -> None:
    """The sensor sinks at 20 m/s in air that rises at 5 m/s and crosses the beam at 30 m/s: 25 m/s closing."""
    windy = AIR.model_copy(update={"wind_mps": (30.0, 0.0, 5.0)})
    lights = [light(gliding([0.0, 0.0, -20.0]), 150.0, CONSTANT, seed, windy) for seed in range(5)]
    np.testing.assert_allclose(lights[0].middle_frequency_hz, -2.0 * 25.0 / WAVEFORM.wavelength_m, rtol=1e-3)
    for place in (-1.0, 1.0):
        found = []
        for one in lights:
            exponents = one.coefficients @ np.vander([place], one.coefficients.shape[1], increasing=True).T
            found.append(np.sum(np.exp(2.0 * exponents.real)))
        assert np.mean(found) == pytest.approx(closed_form(0.0, 150.0), rel=0.04)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("range_m", "backscatter", "extinction", "good", "wrong"),
    [(100.0, 1e-3, 2e-2, 0.10, 0.90), (200.0, 1e-7, 1e-5, 1.0, 0.0)],
)
def test_strong_haze_is_chosen_in_place_of_the_surface(
    range_m: float, backscatter: float, extinction: float, good: float, wrong: float
) -> None:
    """An independent computation, whose surface may be brighter: these two scenes hardly depend on that."""
    shots = 60
    down_m = range_m * float(np.cos(np.radians(15.0)))
    settings = {
        "level": "reference",
        "duration_s": str(0.01 * shots),
        "timing.rate_hz": "100",
        "site": f"{{base: flat, atmosphere: {{extinction_per_m: {extinction}, backscatter_per_m_sr: {backscatter}}}}}",
        "scanner": "{pattern: {kind: directions, beams: [[15, 0]]}}",
        "trajectory": "{kind: profile, waypoints: ["
        f"{{altitude_m: {down_m + 1.5}, speed_mps: 5}}, {{altitude_m: {down_m - 1.6}, speed_mps: 5}}]}}",
    }
    run = simulate(load("descent", settings))
    near = np.abs(run.range_m - run.true_range_m) < 2.0
    three_sigma = 3.0 * np.sqrt(max(good * (1.0 - good), 0.01) / shots)
    assert np.mean(run.range_valid & near) == pytest.approx(good, abs=three_sigma)
    assert np.mean(run.range_valid & ~near) == pytest.approx(wrong, abs=three_sigma)
