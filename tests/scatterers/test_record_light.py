"""The light of scatterers against closed forms: speckle's correlation and line, beats, lag, lever arm."""

from __future__ import annotations

import numpy as np
import pytest
from moving_beams import even_plane, gliding, speckled, turning

from lidar_emu.receiver.whole_spectrum import transform
from lidar_emu.reference.laser_sweep import frequency_plan
from lidar_emu.reference.record_light import GaussianMode, PosesAt, RecordLight, Scatterers, record_light
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Instrument

INSTRUMENT = Instrument()
WAVEFORM = INSTRUMENT.waveform
MODE = GaussianMode.of(INSTRUMENT)
UP, CONSTANT, DOWN = frequency_plan(WAVEFORM)
WAIST_M, WAVELENGTH_M = INSTRUMENT.optics.waist_radius_m, WAVEFORM.wavelength_m
RANGES_M = (20.0, 50.0, 300.0, 2000.0, 10_000.0)

ON_AXIS = np.zeros((1, 3))


def light(poses_at: PosesAt, scatterers: Scatterers, half_s: float, segment=CONSTANT) -> RecordLight:
    return record_light(MODE, segment, poses_at, scatterers, -half_s, half_s)


def fields(one: RecordLight, places: object) -> np.ndarray:
    """Field of each scatterer (n, times) at places from -1 to 1 of the time covered."""
    powers = np.vander(np.atleast_1d(places), one.coefficients.shape[1], increasing=True)
    return np.exp(one.coefficients @ powers.T)


def correlation(one: RecordLight, place: float) -> complex:
    """Correlation of the fields at -place and place, of independent scatterers of equal strength."""
    before, after = fields(one, [-place, place]).T
    power = np.sqrt(np.sum(np.abs(before) ** 2) * np.sum(np.abs(after) ** 2))
    return complex(np.vdot(before, after) / power)


@pytest.mark.parametrize("range_m", RANGES_M)
@pytest.mark.parametrize("shift_w", [0.25, 0.5, 1.0, 1.5])
def test_field_is_exchanged_as_the_beam_glides(range_m: float, shift_w: float) -> None:
    half_s = 1e-4
    velocity_mps = shift_w * WAIST_M / (2.0 * half_s)
    found = correlation(light(gliding([velocity_mps, 0, 0]), even_plane(INSTRUMENT, range_m), half_s), 1.0)
    assert abs(found) == pytest.approx(np.exp(-(shift_w**2)), abs=2e-4)


@pytest.mark.parametrize("range_m", RANGES_M)
@pytest.mark.parametrize("turned", [0.25, 0.5, 1.0])
def test_field_is_exchanged_as_the_beam_turns(range_m: float, turned: float) -> None:
    """In units of the divergence λ/(π w0); without the light's lag, which parts the axes at this rate."""
    half_s = 1e-4
    rate_radps = turned * WAVELENGTH_M / (np.pi * WAIST_M) / (2.0 * half_s)
    found = correlation(light(turning(rate_radps), even_plane(INSTRUMENT, range_m), half_s), 1.0)
    assert abs(found) == pytest.approx(np.exp(-(turned**2)), abs=2e-4)


@pytest.mark.parametrize("range_m", RANGES_M)
@pytest.mark.parametrize("velocity_mps", [(40.0, 0.0, -3.0), (0.0, 100.0, 0.0)])
def test_line_is_as_wide_at_every_range(range_m: float, velocity_mps: tuple[float, ...]) -> None:
    one = light(gliding(velocity_mps), even_plane(INSTRUMENT, range_m), 1e-5)
    power = np.exp(2.0 * one.coefficients[:, 0].real)
    power /= power.sum()
    rate_per_s = one.coefficients[:, 1] / one.half_s
    variance = power @ np.abs(rate_per_s) ** 2 - abs(power @ rate_per_s) ** 2
    expected_hz = np.hypot(*velocity_mps[:2]) / (np.pi * np.sqrt(2.0) * WAIST_M)
    assert np.sqrt(variance) / (2.0 * np.pi) == pytest.approx(expected_hz, rel=2e-4)


@pytest.mark.parametrize("segment", [UP, CONSTANT, DOWN], ids=["up", "constant", "down"])
@pytest.mark.parametrize(
    ("range_m", "speed_mps"), [(30.0, 0.0), (300.0, -20.0), (2000.0, 100.0), (9000.0, 3.0)]
)
def test_one_scatterer_on_the_axis_beats_as_its_delay(segment, range_m: float, speed_mps: float) -> None:
    """The beat is the rate of the phase with the delay τ that solves c τ/2 = R - v (t - τ/2) at reception t."""
    scatterers = Scatterers(np.array([[0.0, 0.0, -range_m]]), ON_AXIS, np.ones(1, dtype=complex))
    one = light(gliding([0.0, 0.0, -speed_mps]), scatterers, 1e-4, segment)
    share = speed_mps / SPEED_OF_LIGHT_MPS
    delay_s = 2.0 * (range_m - speed_mps * segment.centre_s) / SPEED_OF_LIGHT_MPS / (1.0 - share)
    delay_rate = -2.0 * share / (1.0 - share)
    since_s = segment.start_to_centre_s
    now_hz = segment.start_frequency_hz + segment.slope_hz_per_s * since_s
    # Their difference: now_hz - then_hz (1 - delay_rate) would be rounded to 0.03 Hz.
    beat_hz = now_hz * delay_rate + segment.slope_hz_per_s * delay_s * (1.0 - delay_rate)
    # The phase of the mode itself on the axis, -2 ψ.
    gouy_hz = speed_mps / (np.pi * MODE.rayleigh_m) / (1.0 + (range_m / MODE.rayleigh_m) ** 2)
    found_hz = one.coefficients[0, 1].imag / (2.0 * np.pi * one.half_s)
    # Delays of 60 us are rounded to 7e-21 s, 1.3e-6 of a cycle, within 1e-4 s; processors round differently.
    assert found_hz == pytest.approx(beat_hz + gouy_hz, abs=0.2)


def test_acceleration_chirps_the_beat() -> None:
    scatterers = Scatterers(np.array([[0.0, 0.0, -500.0]]), ON_AXIS, np.ones(1, dtype=complex))
    one = light(gliding([0.0, 0.0, -30.0], 12.0), scatterers, 1e-4)
    found = 2.0 * one.coefficients[0, 2].imag / (2.0 * np.pi * one.half_s**2)
    assert found == pytest.approx(-2.0 * 12.0 / WAVELENGTH_M, rel=1e-4)


def test_angular_acceleration_moves_the_end_of_a_lever_arm() -> None:
    """±0.2° at 3 Hz, 3 m beside: at the extreme the closing speed changes by 3.7 m/s²."""
    angular_radps2 = np.radians(0.2) * (2.0 * np.pi * 3.0) ** 2
    scatterers = Scatterers(np.array([[0.0, 0.0, -300.0]]), ON_AXIS, np.ones(1, dtype=complex))
    one = light(turning(0.0, 3.0, angular_radps2), scatterers, 1e-4)
    found_mps2 = 2.0 * one.coefficients[0, 2].imag / (2.0 * np.pi * one.half_s**2) * WAVELENGTH_M / 2.0
    assert found_mps2 == pytest.approx(3.0 * angular_radps2, rel=1e-3)
    assert found_mps2 == pytest.approx(3.7, abs=0.05)


@pytest.mark.parametrize(("rate_radps", "range_m"), [(2.0, 2000.0), (1.0, 5000.0), (5.0, 1000.0)])
def test_the_received_mode_lags_behind_the_transmitted_one(rate_radps: float, range_m: float) -> None:
    """Two modes of divergence θ that are apart by γ overlap by exp(-(R γ/w)²): -3.4 dB at 2 rad/s and 2 km."""
    powers = [
        np.sum(np.abs(fields(light(turning(rate), even_plane(INSTRUMENT, range_m), 1e-6), 0.0)) ** 2)
        for rate in (0.0, rate_radps)
    ]
    apart_m = rate_radps * 2.0 * range_m / SPEED_OF_LIGHT_MPS * range_m
    expected = np.exp(-((apart_m / MODE.radius_m(range_m)) ** 2))
    assert powers[1] / powers[0] == pytest.approx(expected, rel=1e-3)
    if rate_radps == 2.0:
        assert 10.0 * np.log10(expected) == pytest.approx(-3.4, abs=0.05)


def test_gliding_beams_lose_nothing_by_the_travel_of_light() -> None:
    """In the frame of the sensor the light of a beam at rest follows its axis, whatever the speed."""
    plane = even_plane(INSTRUMENT, 8000.0)
    at_rest, fast = (
        np.sum(np.abs(fields(light(gliding([speed, 0, 0]), plane, 1e-7), 0.0)) ** 2) for speed in (0.0, 1e3)
    )
    assert fast == pytest.approx(at_rest, rel=1e-4)


def test_samples_are_those_of_the_exponents() -> None:
    """Repeated multiplication against the exponentials, at every sample of a record."""
    half_s = 0.5 * WAVEFORM.record_time_s
    scatterers = speckled(even_plane(INSTRUMENT, 300.0, 0.3, 5), 1)
    one = light(gliding([40.0, 0.0, -20.0], 10.0), scatterers, half_s, DOWN)
    samples = np.zeros(4096, dtype=complex)
    one.add_to(samples, -half_s, 2.0 * half_s / len(samples))
    exact = fields(one, -1.0 + 2.0 * np.arange(len(samples)) / len(samples)).sum(axis=0)
    np.testing.assert_allclose(samples, exact, rtol=0, atol=1e-6 * np.abs(exact).max())


def test_shifting_multiplies_by_a_tone() -> None:
    one = light(gliding([0.0, 0.0, -20.0]), even_plane(INSTRUMENT, 100.0, 0.0, 3), 1e-4)
    hz = 12_345.0
    time_s = one.middle_s + one.half_s * np.array([-0.7, 0.1])
    expected = fields(one, [-0.7, 0.1]) * np.exp(2j * np.pi * hz * time_s)
    np.testing.assert_allclose(fields(one.shifted(hz), [-0.7, 0.1]), expected, rtol=1e-9)


def test_light_of_the_segment_before_is_left_out() -> None:
    """Beyond the record edge, the record's first part is dark."""
    range_m = WAVEFORM.record_edge_range_m + 0.25 * WAVEFORM.record_time_s * SPEED_OF_LIGHT_MPS / 2.0
    scatterers = Scatterers(np.array([[0.0, 0.0, -range_m]]), ON_AXIS, np.ones(1, dtype=complex))
    half_s = 0.5 * WAVEFORM.record_time_s
    samples = np.zeros(1000, dtype=complex)
    light(gliding([0.0, 0.0, 0.0]), scatterers, half_s).add_to(samples, -half_s, 2e-3 * half_s)
    assert np.flatnonzero(samples)[0] == pytest.approx(250, abs=2)


def test_no_scatterers_are_dark() -> None:
    none = Scatterers(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=complex))
    dark = light(gliding([0.0, 0.0, 0.0]), none, 1e-4)
    samples = np.zeros(16, dtype=complex)
    dark.add_to(samples, -1e-4, 1e-5)
    assert not samples.any()
    assert dark.mean_delay_s == 0.0
    assert not transform(samples.real, "rect").any()
