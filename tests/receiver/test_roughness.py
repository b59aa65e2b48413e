"""Rough ground: the scatter that it gives ranges, against its closed form and against scatterers."""

from __future__ import annotations

import numpy as np
import pytest

import lidar_emu
from benchmarks.scenes import scanner, trajectory
from lidar_emu import Measurement
from lidar_emu.receiver.received_echoes import depth_nodes
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, measure_whole

SHOTS, RATE_HZ, RANGE_M = 20, 50.0, 100.0


def flown(
    incidence_deg: float, roughness_m: float, seed: int, sink_mps: float = 5.0, level: str = "spectral"
) -> Measurement:
    """Beams at one incidence, without a line and with little noise."""
    flown_s = SHOTS / RATE_HZ
    keys = {
        "level": level,
        "timing.rate_hz": str(RATE_HZ),
        "duration_s": str(flown_s),
        "site": f"{{base: flat, surface: {{roughness_m: {roughness_m}}}}}",
        "scanner": scanner(incidence_deg, 0, 90, 180, 270),
        "trajectory": trajectory(
            RANGE_M * np.cos(np.radians(incidence_deg)), 0.51 * sink_mps * flown_s, sink_mps
        ),
        "instrument.detection.combine": "least_squares",
        "instrument.detection.peak": "hann",
        "instrument.waveform.linewidth_hz": "0",
        "instrument.optics.laser_power_w": "30",
    }
    return lidar_emu.simulate(load("descent", keys), seed=seed)


def scatter_m(incidence_deg: float, roughness_m: float, seeds: int, level: str = "spectral") -> float:
    """Robust standard deviation of the range."""
    runs = [flown(incidence_deg, roughness_m, seed, level=level) for seed in range(seeds)]
    error_m = np.concatenate([(run.range_m - run.true_range_m)[run.range_valid] for run in runs])
    return 1.4826 * float(np.median(np.abs(error_m - np.median(error_m))))


@pytest.mark.slow
@pytest.mark.parametrize("incidence_deg", [10.0, 30.0, 60.0])
@pytest.mark.parametrize("roughness_m", [0.003, 0.01, 0.03])
def test_ranges_scatter_by_the_closed_form(incidence_deg: float, roughness_m: float) -> None:
    """The quartiles of Re(n/a) are 1/√3; in quadrature with what smooth ground scatters."""
    smooth_m = scatter_m(incidence_deg, 0.0, 60)
    by_roughness_m = 1.4826 / np.sqrt(3.0) * roughness_m / np.cos(np.radians(incidence_deg))
    found_m = scatter_m(incidence_deg, roughness_m, 60)
    # At 0.1 bin and more a fade's lines no longer merge to first order.
    assert found_m == pytest.approx(
        np.hypot(smooth_m, by_roughness_m), rel=0.08 if roughness_m < 0.03 else 0.13
    )


@pytest.mark.slow
@pytest.mark.parametrize(("incidence_deg", "roughness_m"), [(10.0, 0.03), (30.0, 0.03), (30.0, 0.1)])
def test_scatterers_at_random_heights_agree(incidence_deg: float, roughness_m: float) -> None:
    assert scatter_m(incidence_deg, roughness_m, 60) == pytest.approx(
        scatter_m(incidence_deg, roughness_m, 7, "reference"), rel=0.12
    )


def test_speeds_stay_as_they_are() -> None:
    rough, smooth = flown(30.0, 0.03, 1), flown(30.0, 0.0, 1)
    errors = [np.abs(run.closing_speed_mps - run.true_closing_speed_mps) for run in (rough, smooth)]
    assert np.nanmedian(errors[0]) == pytest.approx(np.nanmedian(errors[1]), abs=3e-5)


@pytest.mark.parametrize("scenario", ["descent", "obstacles"])
def test_a_shot_alone_has_its_bits(scenario: str) -> None:
    """Over objects the depth along some rays alone is more than `FEW_DEPTHS_BELOW_BINS`."""
    model = build_model(load(scenario, {"site.surface.roughness_m": "0.02", "duration_s": "2"}))
    whole = measure_whole(model)
    for shot in range(17, len(whole.range_m), 17):
        alone, _ = model.measure(shot, 1, model.state_after(0, shot, model.initial_state))
        np.testing.assert_array_equal(alone.range_m[0], whole.range_m[shot])


@pytest.mark.parametrize("roughness_m", [0.01, 0.3])
def test_depths_have_the_variance_of_the_heights(roughness_m: float) -> None:
    depths, weights = depth_nodes(roughness_m, 0.343)
    assert [weights.sum(), weights @ depths, weights @ depths**2] == pytest.approx([1.0, 0.0, 1.0], abs=1e-12)
