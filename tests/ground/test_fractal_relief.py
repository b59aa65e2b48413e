"""Fractal relief against the closed form of fractional Brownian surfaces."""

import numpy as np
import pytest
from scipy import fft
from scipy.interpolate import RegularGridInterpolator

from lidar_emu.scene.procedural.generate import fractional_surface, generate, torus_spectrum


@pytest.mark.parametrize("hurst", [0.05, 0.3, 0.5, 0.75, 0.76, 0.9, 0.99])
@pytest.mark.parametrize("side", [33, 130, 257])
def test_the_law_of_the_field_is_exact(side, hurst):
    """The covariance that the spectrum stands for, and the tilt, make 2 r^2H: so nothing negative was cut off."""
    spectrum, parabola = torus_spectrum(side, hurst)
    covariance = fft.idctn(spectrum, type=1)
    place = np.arange(side) / (side - 1)
    r = np.hypot(place[:, None], place)
    variogram = 2 * (covariance[0, 0] - covariance[:side, :side]) + 2 * parabola * r**2
    near = r <= 1
    np.testing.assert_allclose(variogram[near], 2 * r[near] ** (2 * hurst), atol=1e-12)


@pytest.mark.parametrize("hurst", [0.2, 0.5, 0.9])
def test_surfaces_have_that_law(hurst):
    """Mean squares over many surfaces, across, along and askew, within four of their standard errors."""
    side, surfaces = 33, 600
    rng = np.random.default_rng(3)
    offsets = [(1, 0), (0, 1), (4, 0), (0, 16), (3, 4), (12, 16), (32, 0), (0, 32), (8, -8)]
    squares = np.empty((surfaces, len(offsets)))
    for k in range(surfaces):
        height = fractional_surface(side, hurst, rng)
        for j, (down, right) in enumerate(offsets):
            height_j = height[:, ::-1] if right < 0 else height
            right = abs(right)
            difference = height_j[down:, right:] - height_j[: side - down, : side - right]
            squares[k, j] = np.mean(difference**2)
    asked = [2 * (np.hypot(*offset) / (side - 1)) ** (2 * hurst) for offset in offsets]
    error = squares.std(axis=0) / surfaces**0.5
    assert (np.abs(squares.mean(axis=0) - asked) < 4 * error).all()
    # The last two lags but one go from edge to edge: a periodic surface would have next to nothing there.
    assert (error < 0.12 * np.array(asked)).all()


@pytest.mark.parametrize("baseline_m", [2.0, 10.0, 33.3])
def test_slope_is_as_asked_between_any_points(ground, baseline_m):
    """By bilinear interpolation between random points, a baseline apart along the axes of the grid."""
    asked = ground(relief={"hurst": 0.8, "rms_slope_deg": 7.0, "baseline_m": baseline_m})
    height = generate(asked).relief_m
    surface = RegularGridInterpolator((np.arange(257.0), np.arange(257.0)), height)
    rng = np.random.default_rng(8)
    squares = []
    for axis in (0, 1):
        start = rng.integers(0, 257, (200_000, 2)).astype(float)
        start[:, axis] = rng.uniform(0, 256 - baseline_m, len(start))
        end = start.copy()
        end[:, axis] += baseline_m
        squares.append(np.mean((surface(end) - surface(start)) ** 2))
    slope_deg = np.degrees(np.arctan(np.sqrt(np.mean(squares)) / baseline_m))
    # Between samples the bilinear surface is smoother than the relief: by a few per cent over two samples.
    assert slope_deg == pytest.approx(7.0, rel=0.07 if baseline_m < 5 else 0.02)


def test_seeds_differ_and_repeat(ground):
    relief = {"hurst": 0.8, "rms_slope_deg": 7.0, "baseline_m": 4.0}
    one, same, other = (generate(ground(relief=relief, seed=seed)).relief_m for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, same)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.9
    assert abs(one.mean()) < 1e-12
