"""Footprints against a Gaussian: its moments, complex beam parameter, and decorrelation of its speckle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lidar_emu.beams.footprint import beam_radius_m, beamlet_pattern, sample_footprint, wavefront_radius_m
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.numerics.vector_arrays import cross, dot

COUNTS = [1, 7, 19, 37, 61, 91, 127]
WAIST_M, WAVELENGTH_M = 17e-3, 1550e-9
RAYLEIGH_M = np.pi * WAIST_M**2 / WAVELENGTH_M
DOWN = np.array([[0.0, 0.0, -1.0]])


def normalised(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.sqrt(dot(vector, vector))[..., None])


def inverse_beam_parameter(range_m: FloatArray) -> FloatArray:
    """1/q of a Gaussian beam: real part 1/Rc, imaginary part -wavelength/(pi w²)."""
    return np.asarray(1 / (range_m + 1j * RAYLEIGH_M))


def expected_power(offset: FloatArray, weight: FloatArray, x: int, y: int) -> float:
    return float((weight * offset[:, 0] ** x * offset[:, 1] ** y).sum())


@pytest.mark.parametrize("count", COUNTS)
def test_pattern_is_centred_and_holds_all_of_the_power(count: int) -> None:
    offset, weight = beamlet_pattern(count)
    assert offset.shape == (count, 2)
    assert weight.sum() == pytest.approx(1, rel=1e-14)
    assert offset[0].tolist() == [0, 0]
    assert np.argmax(weight) == 0
    np.testing.assert_allclose(weight @ offset, 0, atol=1e-15)


@pytest.mark.parametrize("count", COUNTS[1:])
def test_second_moments_are_the_gaussians(count: int) -> None:
    """exp(-4 r²) has the variance 1/8 along x and y, no correlation, and no third or fifth moments."""
    offset, weight = beamlet_pattern(count)
    moment = {(x, y): expected_power(offset, weight, x, y) for x in range(6) for y in range(6 - x)}
    assert moment[2, 0] == pytest.approx(1 / 8, rel=1e-13)
    assert moment[0, 2] == pytest.approx(1 / 8, rel=1e-13)
    for (x, y), value in moment.items():
        if x % 2 or y % 2:
            assert abs(value) < 1e-15


@pytest.mark.parametrize(
    ("count", "below"), [(7, 1e-14), (19, 1e-8), (37, 0.04), (61, 0.05), (91, 0.06), (127, 0.06)]
)
def test_fourth_moments(count: int, below: float) -> None:
    """3/64 along x, 1/64 mixed; a little low where the pattern is cut off."""
    offset, weight = beamlet_pattern(count)
    for powers, gaussian in (((4, 0), 3 / 64), ((0, 4), 3 / 64), ((2, 2), 1 / 64)):
        share = expected_power(offset, weight, *powers) / gaussian
        assert 1 - below <= share <= 1 + 1e-8


@pytest.mark.parametrize("count", [0, 2, 18, 20, 128])
def test_other_counts_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match="must be 1, 7, 19"):
        beamlet_pattern(count)


def test_radius_and_wavefront_agree_with_the_complex_beam_parameter() -> None:
    range_m = np.geomspace(1e-3, 1e7, 60)
    inverse = inverse_beam_parameter(range_m)
    radius = beam_radius_m(range_m, WAIST_M, WAVELENGTH_M)
    np.testing.assert_allclose(radius, np.sqrt(-WAVELENGTH_M / (np.pi * inverse.imag)), rtol=1e-12)
    np.testing.assert_allclose(
        wavefront_radius_m(range_m, WAIST_M, WAVELENGTH_M), 1 / inverse.real, rtol=1e-12
    )


def test_the_waist() -> None:
    zero = np.array([0.0, 5e-324, RAYLEIGH_M])
    np.testing.assert_allclose(
        beam_radius_m(zero, WAIST_M, WAVELENGTH_M), [WAIST_M, WAIST_M, WAIST_M * np.sqrt(2)], rtol=1e-15
    )
    np.testing.assert_allclose(
        wavefront_radius_m(zero, WAIST_M, WAVELENGTH_M), [np.inf, np.inf, 2 * RAYLEIGH_M]
    )


@pytest.mark.parametrize("range_m", [1e-9, 1.0, 50.0, 585.0, 2000.0, 1e4, 1e6])
def test_rays_reach_the_footprint(range_m: float) -> None:
    """On a plane across the axis every ray is at its offset times w."""
    axis = normalised(np.array([[0.3, -0.2, -0.8]]))
    sensor = np.array([[5.0, 6.0, 7.0]])
    offset, weight = beamlet_pattern(37)
    sampled = sample_footprint(sensor, axis, np.array([range_m]), 37, WAIST_M, WAVELENGTH_M)
    along = range_m / dot(sampled.ray_site[0], axis)
    reached = sampled.start_site_m[0] + along[:, None] * sampled.ray_site[0] - (sensor + range_m * axis)
    radius = beam_radius_m(np.array(range_m), WAIST_M, WAVELENGTH_M)
    np.testing.assert_allclose(
        np.sqrt(dot(reached, reached)), radius * np.hypot(*offset.T), rtol=1e-9, atol=1e-9 * range_m
    )
    np.testing.assert_allclose(dot(reached, axis), 0, atol=1e-12 * max(1, range_m))
    np.testing.assert_array_equal(sampled.weight, weight)


@pytest.mark.parametrize("range_m", [0.0, 1e-3, 50.0, 585.0, 1e4, 1e6])
def test_doppler_follows_the_phase_of_the_beam_back_to_its_place_in_the_aperture(range_m: float) -> None:
    """The phase k r²/(2 Rc) of the beam has the slope r/Rc at the distance r from the axis. From a point x of the
    footprint it looks back to x (1 - R/Rc), on which the turning of the sensor acts."""
    offset, _ = beamlet_pattern(19)
    sampled = sample_footprint(np.zeros((1, 3)), DOWN, np.array([range_m]), 19, WAIST_M, WAVELENGTH_M)
    inverse = inverse_beam_parameter(np.array(range_m))
    radius = np.sqrt(-WAVELENGTH_M / (np.pi * inverse.imag))
    lateral = sampled.doppler_site[0, :, :2] / -sampled.doppler_site[0, :, 2:]
    np.testing.assert_allclose(lateral, offset * radius * inverse.real, rtol=1e-9, atol=1e-18)
    start = np.stack([component[0] for component in sampled.doppler_start_m], axis=-1)
    np.testing.assert_allclose(start, offset * radius * (1 - range_m * inverse.real), rtol=1e-4, atol=1e-16)
    first, second = (across[0] for across in sampled.across_site)
    aside_m = WAIST_M * (offset[:, :1] * first + offset[:, 1:] * second)
    np.testing.assert_allclose(sampled.start_site_m[0], aside_m, atol=1e-17)


def test_from_the_waist_to_infinity_and_without_ground() -> None:
    range_m = np.array([0.0, 1e300, np.inf, np.nan])
    sampled = sample_footprint(
        np.zeros((4, 3)), np.repeat(DOWN, 4, axis=0), range_m, 7, WAIST_M, WAVELENGTH_M
    )
    assert np.isfinite(sampled.ray_site).all()
    np.testing.assert_array_equal(sampled.ray_site[0], np.repeat(DOWN, 7, axis=0))
    np.testing.assert_array_equal(sampled.doppler_site[0], np.repeat(DOWN, 7, axis=0))
    for far in sampled.ray_site[1:], sampled.doppler_site[1:]:
        slope = np.hypot(far[..., 0], far[..., 1]) / -far[..., 2]
        expected = WAVELENGTH_M / (np.pi * WAIST_M) * np.sqrt(0.5)
        np.testing.assert_allclose(slope[:, 1:], expected, rtol=1e-12)


def test_a_beam_that_does_not_fire_has_no_rays() -> None:
    absent = np.full((1, 3), np.nan)
    sampled = sample_footprint(np.zeros((1, 3)), absent, np.array([np.nan]), 7, WAIST_M, WAVELENGTH_M)
    assert np.isnan(sampled.ray_site).all()


def test_one_beamlet_is_the_axis() -> None:
    axis, sensor = normalised(np.array([[0.1, 0.2, -0.9]])), np.array([[1.0, 2.0, 3.0]])
    sampled = sample_footprint(sensor, axis, np.array([100.0]), 1, WAIST_M, WAVELENGTH_M)
    np.testing.assert_allclose(sampled.ray_site[:, 0], axis, rtol=1e-15)
    np.testing.assert_array_equal(sampled.start_site_m[:, 0], sensor)


parts = st.one_of(st.floats(-1, 1), st.sampled_from([0.0, -0.0, 1e-8, -1e-160, 1e-170, 1e-300, 5e-324]))


def across(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The directions of two corners of the hexagon, 60 degrees apart."""
    start = sample_footprint(np.zeros((1, 3)), axis[None], np.ones(1), 7, 1.0, WAVELENGTH_M).start_site_m[0]
    return start[1], start[2]


@given(st.tuples(parts, parts, st.sampled_from([-1.0, 1.0, 0.0, 0.3, -0.3])))
@example((0.0, 0.0, -1.0))
@example((0.0, 0.0, 1.0))
@example((1e-160, 1e-160, 1.0))
@example((3e-141, 0.0, 1.0))
def test_pattern_lies_across_any_axis(direction: tuple[float, float, float]) -> None:
    vector = np.array(direction) / max(np.max(np.abs(direction)), 1e-300)
    if not np.any(np.abs(vector) == 1):
        return
    axis = normalised(vector)
    first, second = across(axis)
    np.testing.assert_allclose([dot(first, axis), dot(second, axis)], 0, atol=1e-15)
    np.testing.assert_allclose([dot(first, first), dot(second, second)], 0.5, rtol=1e-13)
    assert dot(first, second) == pytest.approx(0.25, rel=1e-12)
    assert dot(cross(first, second), axis) == pytest.approx(-np.sqrt(3) / 4, rel=1e-12)


def test_pattern_turns_smoothly_with_the_axis() -> None:
    """Through straight down and on to ten degrees from straight up, the pattern never turns faster than the
    axis does times the tangent of half its angle from down, which is 11.4 there."""
    angle = np.radians(np.linspace(-170, 170, 20_001))
    for azimuth in np.radians([0.0, 37.0, 90.0]):
        side = np.sin(angle)[:, None] * np.array([np.cos(azimuth), np.sin(azimuth), 0])
        axis = side + np.array([0, 0, -1.0]) * np.cos(angle)[:, None] + np.array([1e-3, 0, 0])
        axis = normalised(axis)
        start = sample_footprint(
            np.zeros_like(axis), axis, np.ones(len(axis)), 7, 1.0, WAVELENGTH_M
        ).start_site_m
        turned = np.diff(start, axis=0)
        assert np.max(np.sqrt(dot(turned, turned))) < 12 * (angle[1] - angle[0])
