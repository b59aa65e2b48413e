"""Particles of a plume's dust: their power and their beats in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from moving_beams import gliding

from lidar_emu.beams.plume_paths import DustPaths
from lidar_emu.receiver.link_budget import backscatter_w
from lidar_emu.reference.laser_sweep import frequency_plan
from lidar_emu.reference.record_light import GaussianMode, record_light
from lidar_emu.reference.volume import DustyBeam, ParticleBeam
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.site import Plume

INSTRUMENT = Instrument()
WAVEFORM = INSTRUMENT.waveform
PLUME = Plume(streak_optical_depth=0.8, speed_mps=20.0, speed_spread=0.5)
DOWN_MPS, TILT = 2.0, np.radians(30.0)


def paths(depth: float, in_streak: bool, place: float) -> DustPaths:
    """The path of one beam that meets the ground at 12 m. The beam points down; its dust moves downward and aside."""
    one = np.ones((1, 1))
    outward = np.array([np.cos(TILT), 0.0, -np.sin(TILT)])
    return DustPaths(
        near_m=10.0 * one,
        ground_m=12.0 * one,
        depth=depth * one,
        in_streak=one > (0.0 if in_streak else 2.0),
        streak_place=place * one,
        streak_mps=25.0 * one,
        outward=outward[None, None],
        slant=np.sin(TILT) * one,
    )


@pytest.mark.parametrize("segment", frequency_plan(WAVEFORM), ids=["up", "constant", "down"])
@pytest.mark.parametrize("place", [None, 0.25])
def test_power_is_that_of_single_scattering(segment, place: float | None) -> None:
    """(1 - exp(-2τ))/(2S) of sheet and streak together; what a streak hides is missing."""
    beam = DustyBeam(ParticleBeam.of(INSTRUMENT, 1.0), PLUME, WAVEFORM, 1e-3)
    poses_at, half_s = gliding([0.0, 0.0, -DOWN_MPS]), 0.5 * WAVEFORM.record_time_s
    depth = 0.6
    total = depth + (0.0 if place is None else 0.8)
    expected = backscatter_w(INSTRUMENT, None, np.array(11.0)) * -np.expm1(-2.0 * total) / (2.0 * 50.0)
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        sampled, passed = beam.sample(
            paths(depth, place is not None, place or 0.0), 0, 0, poses_at, -5e-4, 4.1e-4, rng
        )
        assert passed == pytest.approx(np.exp(-total))
        assert len(sampled) == (1 if place is None else 2)
        light = [
            record_light(GaussianMode.of(INSTRUMENT), segment, poses_at, each, -half_s, half_s)
            for each in sampled
        ]
        found.append(sum(np.exp(2.0 * each.coefficients[:, 0].real).sum() for each in light))
    assert np.mean(found) == pytest.approx(float(expected) * np.exp(-2e-3 * 10.7), rel=0.05)


def test_beats_are_uniform_over_the_speeds() -> None:
    """The sensor closes at 2 m/s on dust that flees at 10 to 30 m/s, of which half is along the beam."""
    beam = DustyBeam(ParticleBeam.of(INSTRUMENT, 1.0), PLUME, WAVEFORM, 0.0)
    poses_at, half_s = gliding([0.0, 0.0, -DOWN_MPS]), 0.5 * WAVEFORM.record_time_s
    sampled, _ = beam.sample(paths(0.6, False, 0.0), 0, 0, poses_at, -5e-4, 4.1e-4, np.random.default_rng(1))
    constant = frequency_plan(WAVEFORM)[1]
    light = record_light(GaussianMode.of(INSTRUMENT), constant, poses_at, sampled[0], -half_s, half_s)
    closing_mps = -0.5 * WAVEFORM.wavelength_m * light.middle_frequency_hz
    power = np.exp(2.0 * light.coefficients[:, 0].real)
    quarters, _ = np.histogram(
        closing_mps, np.linspace(2.0 - 15.0, 2.0 - 5.0, 5), weights=power / power.sum()
    )
    np.testing.assert_allclose(quarters, 0.25, atol=0.03)
