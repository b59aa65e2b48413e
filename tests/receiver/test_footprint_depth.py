"""Depth of footprints in the stated sigma: planes, Student's law, and a filter that trusts both."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, t

import lidar_emu
from benchmarks.depth_sigma import plane_ratios, quantile
from benchmarks.flight_sigma import correct_locks, fly
from benchmarks.scenes import scanner, trajectory
from lidar_emu.beams.footprint import beam_radius_m
from lidar_emu.numerics.kernels import interpreted
from lidar_emu.receiver.footprint_depth import MOST_FREEDOM, FootprintDepth, plane_normal
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.receiver.returns import Returns
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import Scenario

FINE = {"instrument.detection.combine": "least_squares", "instrument.detection.peak": "hann"}


def cone(angle_deg: float, beams: int = 4) -> np.ndarray:
    """Axes (beams, 3) at one angle off the third."""
    turn, off = 2.0 * np.pi * np.arange(beams) / beams, np.radians(angle_deg)
    return np.stack(
        [np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn), np.full(beams, np.cos(off))], axis=-1
    )


def deepened(axes: np.ndarray, range_m: np.ndarray, quadrature_bin2: np.ndarray, noise_m: float) -> Returns:
    """Returns (shots, beams) at these ranges, with so much noise and this quadrature of the range."""
    shape = range_m.shape
    speckle_bin2 = np.zeros((*shape, 2, 2))
    speckle_bin2[..., 0, 1] = quadrature_bin2
    returns = Returns.with_columns(
        shape,
        range_m=range_m,
        range_valid=np.isfinite(range_m),
        sigma_range_m=np.full(shape, noise_m),
        speckle_bin2=speckle_bin2,
    )
    off_deg = np.degrees(np.arccos(axes[..., 2]))
    axes, off_deg = np.broadcast_to(axes, (*shape, 3)), np.broadcast_to(off_deg, shape)
    return FootprintDepth(build_receiver(Instrument())).added(returns, axes, off_deg)


@given(
    angle_deg=st.floats(5.0, 60.0),
    beams=st.integers(3, 6),
    tilt_deg=st.floats(0.0, 25.0),
    toward_rad=st.floats(0.0, 6.3),
    distance_m=st.floats(1.0, 1e4),
)
def test_points_of_a_plane_give_its_normal(
    angle_deg: float, beams: int, tilt_deg: float, toward_rad: float, distance_m: float
) -> None:
    tilt = np.radians(tilt_deg)
    normal = np.array([np.sin(tilt) * np.cos(toward_rad), np.sin(tilt) * np.sin(toward_rad), np.cos(tilt)])
    axes = cone(angle_deg, beams)
    found = np.array(interpreted(plane_normal)(axes, distance_m / (axes @ normal)))
    np.testing.assert_allclose(found / np.linalg.norm(found), normal, atol=1e-6)


@pytest.mark.parametrize("range_m", [[np.nan, 5.0, 5.0, np.nan], [np.nan] * 4, [0.0, 0.0, 0.0, 0.0]])
def test_without_three_ranges_there_is_no_plane(range_m: list[float]) -> None:
    assert interpreted(plane_normal)(cone(22.5), np.array(range_m)) == (0.0, 0.0, 0.0)


def test_a_beam_alone_is_over_level_ground() -> None:
    """A beam without its three neighbours states the sigma that it has with them over a level plane."""
    axes, quadrature = cone(22.5), np.full((1, 4), 0.3)
    whole = deepened(axes, np.full((1, 4), 500.0), quadrature, 1e-3)
    alone = deepened(axes, np.array([[500.0, np.nan, np.nan, np.nan]]), quadrature, 1e-3)
    assert alone.sigma_range_m[0, 0] == pytest.approx(whole.sigma_range_m[0, 0], rel=1e-9)
    assert np.isnan(alone.range_degrees_of_freedom[0, 1:]).all()


@pytest.mark.parametrize("range_m", [500.0, 2000.0])
def test_errors_on_a_slope_without_noise(range_m: float) -> None:
    """The ratio of two Gaussian numbers, Student's law of two degrees of freedom, of shots that share no speckle."""
    keys = FINE | {
        "site": "flat",
        "timing.rate_hz": "1",
        "duration_s": "200",
        "scanner": scanner(22.5, 0, 90, 180, 270),
        "trajectory": trajectory(range_m * np.cos(np.radians(22.5)), 51.0, 0.5),
        "instrument.waveform.linewidth_hz": "0",
        "instrument.optics.laser_power_w": "1e4",
    }
    scenario = load("descent", keys)
    runs = [lidar_emu.simulate(scenario, seed=seed) for seed in range(12)]
    optics, waveform = scenario.instrument.optics, scenario.instrument.waveform
    deviations = [
        (run.range_m - run.true_range_m)
        / beam_radius_m(run.true_range_m, optics.waist_radius_m, waveform.wavelength_m)
        * np.sqrt(8.0)
        / np.tan(np.radians(22.5))
        for run in runs
    ]
    share = np.array([0.5, 0.68, 0.9])
    found = np.nanquantile(np.abs(deviations), share)
    np.testing.assert_allclose(found, share / np.sqrt(1.0 - share**2), rtol=0.05)


@pytest.mark.parametrize("incidence_deg", [10.0, 45.0])
def test_the_law_of_a_still_footprint(incidence_deg: float) -> None:
    """d Re(n/a) over the sigma from d and d Im(n/a) is Student's law of three degrees of freedom, scaled to 68.27 %."""
    rng, shots = np.random.default_rng(1), 40_000
    distance_m, instrument = 1000.0, Instrument()
    waist_m, waveform = instrument.optics.waist_radius_m, instrument.waveform
    radius_m = np.hypot(waist_m, waveform.wavelength_m / (np.pi * waist_m) * distance_m)
    depth_m = radius_m * np.tan(np.radians(incidence_deg)) / np.sqrt(8.0)
    parts = rng.normal(size=(4, shots, 4))
    ratio = (parts[0] + 1j * parts[1]) / (parts[2] + 1j * parts[3])
    quadrature_bin2 = (depth_m / waveform.range_bin_m * ratio.imag) ** 2
    returns = deepened(cone(incidence_deg), np.full((shots, 4), distance_m), quadrature_bin2, 1e-9)
    score = np.abs(depth_m * ratio.real / returns.sigma_range_m)
    scales = t.ppf(0.5 + 0.5 * 0.6827, 3)
    for sigmas in (1.0, 2.0, 3.0, 5.0):
        expected = 2.0 * t.cdf(sigmas * scales, 3) - 1.0
        assert np.mean(score < sigmas) == pytest.approx(expected, abs=0.004)
    np.testing.assert_allclose(returns.range_degrees_of_freedom, 3.0, rtol=1e-6)


def test_noise_alone_is_gaussian() -> None:
    returns = deepened(cone(22.5), np.full((1, 4), 10.0), np.zeros((1, 4)), 1.0)
    np.testing.assert_array_equal(returns.range_degrees_of_freedom, MOST_FREEDOM)
    np.testing.assert_allclose(returns.sigma_range_m, 1.0, rtol=1e-4)


@pytest.mark.parametrize(("incidence_deg", "range_m"), [(22.5, 50.0), (45.0, 200.0), (62.0, 1700.0)])
def test_ranges_of_a_still_footprint(incidence_deg: float, range_m: float) -> None:
    ratios = plane_ratios(incidence_deg, range_m, 0.5, 45.0, FINE, 800)
    assert 0.85 < quantile(ratios[0]) < 1.25
    assert np.mean(np.abs(ratios[0]) < 3.0) > 0.93
    assert quantile(ratios[1]) > 0.75


@pytest.mark.slow
def test_a_filter_that_trusts_sigma_and_freedom_is_consistent() -> None:
    """Height from 40 shots of 200 flights: its error over the information of Student's laws, squared."""
    flown_s, sink_mps, height_m = 2.0, 5.0, 100.0
    keys = FINE | {
        "timing.rate_hz": "20",
        "duration_s": str(flown_s),
        "site": "flat",
        "scanner": scanner(45.0, 0, 90, 180, 270),
        "trajectory": trajectory(height_m, 0.51 * sink_mps * flown_s, sink_mps),
    }
    scenario, flights = load("descent", keys), 200
    squares = np.array(
        [_normalised_square(scenario.model_copy(update={"seed": k + 1})) for k in range(flights)]
    )
    low, high = chi2.ppf([0.025, 0.975], flights)
    assert low <= squares.sum() <= high


def _normalised_square(scenario: Scenario) -> float:
    """Squared error of a height, by maximum likelihood of Student's laws, over its variance."""
    run, error, bias, _ = fly(scenario)
    right = correct_locks(run, error - bias)
    freedom, sigma_m = run.range_degrees_of_freedom[right], run.sigma_range_m[right]
    error_m = (error - bias)[0, right]
    scale_m = sigma_m / t.ppf(0.5 + 0.5 * 0.6827, freedom)
    cosine = np.cos(np.radians(45.0))
    shift_m = 0.0
    for _ in range(30):
        weight = (freedom + 1.0) / (freedom + ((error_m - shift_m / cosine) / scale_m) ** 2) / scale_m**2
        shift_m = cosine * float(np.sum(weight * error_m) / np.sum(weight))
    information = np.sum((freedom + 1.0) / (freedom + 3.0) / scale_m**2) / cosine**2
    return float(shift_m**2 * information)
