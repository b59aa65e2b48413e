"""Vibration of the vehicle: errors of range and speed against closed forms, exact light and the motion itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lidar_emu import InputError, Measurement
from lidar_emu.plan.expected_error import expected_error
from lidar_emu.receiver.vibration import VibratingLidar, draw_tones, vibration_variances
from lidar_emu.scenario.instrument import Detection, Instrument
from lidar_emu.scenario.load import load
from lidar_emu.scenario.vibration import Vibration, VibrationSpectrum
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model, initial_state, measure, measure_whole

LEAST_SQUARES, PUBLISHED = "least_squares", "chirp_minus_doppler"
FLAT = "{g_rms: 1}"
LAUNCH = "{frequency_hz: [20, 50, 800, 2000], g2_per_hz: [0.16, 1, 1, 0.16], g_rms: 1}"
"""The shape of the general environmental verification standard, GSFC-STD-7000: 6 dB an octave at both ends."""
LINE = "{frequency_hz: [20, 136, 137, 138, 2000], g2_per_hz: [1e-5, 1e-5, 1, 1e-5, 1e-5]}"
STEP_S = 1e-6
"""Half of the step of numerical derivatives."""
DOWN = "{pattern: {kind: ring, count: 1, angle_deg: 0}}"


def modelled(spectrum: str, combine: str = LEAST_SQUARES, shots: int = 4000, **keys: str) -> FlightModel:
    """A bright beam straight down, without a line, at 20 Hz; vibration along body z."""
    fallen_m = 0.5 * shots / 20
    waypoints = f"[{{altitude_m: 400, speed_mps: 0.5}}, {{altitude_m: {400 - fallen_m}, speed_mps: 0.5}}]"
    overrides = {
        "duration_s": str(shots / 20),
        "site": "flat",
        "scanner": DOWN,
        "trajectory": f"{{kind: profile, waypoints: {waypoints}}}",
        "instrument.detection.combine": combine,
        "instrument.detection.peak": "hann",
        "instrument.waveform.linewidth_hz": "0",
        "instrument.optics.laser_power_w": "30",
        "vibration": f"{{along_z: {spectrum}}}",
    }
    model = build_model(load("descent", overrides | {key.replace("__", "."): v for key, v in keys.items()}))
    assert isinstance(model, FlightModel)
    return model


def errors(run: Measurement) -> tuple[Any, Any]:
    """Errors (shots,) of range and closing speed."""
    return (run.range_m - run.true_range_m)[:, 0], (run.closing_speed_mps - run.true_closing_speed_mps)[:, 0]


def variances(spectrum: VibrationSpectrum, combine: str) -> Any:
    instrument = Instrument(detection=Detection(combine=combine))
    return vibration_variances(Vibration(along_z=spectrum), instrument)[:, 2]


@pytest.mark.parametrize(
    ("g_rms", "combine", "range_m", "speed_mps"),
    [
        (0.1, LEAST_SQUARES, 0.0171, 0.111e-3),
        (1.0, LEAST_SQUARES, 0.171, 1.11e-3),
        (4.4, LEAST_SQUARES, 0.751, 4.89e-3),
        (1.0, PUBLISHED, 0.228, 0.082e-3),
    ],
)
def test_closed_forms_of_a_flat_spectrum(
    g_rms: float, combine: str, range_m: float, speed_mps: float
) -> None:
    """Figures of a simulation of the light's phase by a separate program, without this package."""
    found = np.sqrt(variances(VibrationSpectrum(g_rms=g_rms), combine))
    np.testing.assert_allclose(found, [range_m, speed_mps, 1.554e-3 * g_rms, 7.80e-3 * g_rms], rtol=6e-3)


def test_a_slow_vibration_is_an_acceleration() -> None:
    """c T a / (λ S) = 29.0 mm per m/s² of range, as for a deceleration."""
    slow = VibrationSpectrum(frequency_hz=[10.0, 11.0], g_rms=1.0)
    assert np.sqrt(variances(slow, LEAST_SQUARES)[0]) == pytest.approx(29.0e-3 * 9.80665, rel=2e-3)


@pytest.mark.parametrize("spectrum", [FLAT, LAUNCH, LINE])
def test_tones_have_the_power_of_the_spectrum(spectrum: str) -> None:
    """Any density is sampled without bias, also where nearly all power is in a narrow line."""
    vibration = modelled(spectrum, shots=1).scenario.vibration
    assert vibration is not None
    assert vibration.along_z is not None
    points_hz, density = np.array(vibration.along_z.frequency_hz), vibration.along_z.g2_per_hz
    power = 1.0
    if spectrum == LINE:
        # Straight lines on logarithmic scales fall by five decades in a hertz, and beside them there is little.
        slope = np.log(1e5) / np.log(points_hz[2] / points_hz[1])
        power = 2.0 * 137.0 * density[2] / slope + 1e-5 * 1980.0
    amplitude = draw_tones(vibration, 1).amplitude_mps2[2]
    assert np.sum(amplitude**2) / 2.0 == pytest.approx(power * 9.80665**2, rel=0.03)


@pytest.mark.parametrize("peak", ["bin", "aboutanios_mulgrew", "hann"])
def test_records_show_the_weighted_velocity(peak: str) -> None:
    """The displacement, differentiated and weighted over each of the three records."""
    instrument = Instrument(detection=Detection(peak=peak))
    between_s, record_s = instrument.waveform.segment_time_s, instrument.waveform.record_time_s
    vibration = Vibration(along_x=VibrationSpectrum(g_rms=1.0), along_z=VibrationSpectrum(g_rms=3.0))
    tones, time_ns = draw_tones(vibration, 7), np.array([[123_456_789, 123_456_789, 987_654_321_000]])
    axis = np.array([[[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]])
    found = VibratingLidar(vibration, instrument, 7).motion(time_ns, axis)
    node, weight = np.polynomial.legendre.leggauss(40)
    weight *= {"bin": 1.0 - node**2, "hann": (1.0 + np.cos(np.pi * node)) ** 2}.get(
        peak, np.cos(0.5 * np.pi * node)
    )
    weight /= weight.sum()
    for b in range(3):
        valid_s = time_ns[0, b] * 1e-9

        def speed_mps(time_s: Any, valid_s: float = valid_s, b: int = b) -> Any:
            ahead, behind = (tones.displacement_body_m(valid_s + time_s + side) for side in (STEP_S, -STEP_S))
            return (ahead - behind) @ axis[0, b] / (2.0 * STEP_S)

        def shown_mps(time_s: float) -> float:
            return float(speed_mps(time_s + 0.5 * record_s * node) @ weight)

        assert found.speed_mps[0, b] == pytest.approx(float(speed_mps(np.zeros(1))[0]), rel=1e-4, abs=1e-9)
        for after_s in (-between_s, 0.0, between_s):
            parabola_mps = (
                found.record_speed_mps[0, b]
                + (found.acceleration_mps2[0, b] + 0.5 * found.jerk_mps3[0, b] * after_s) * after_s
            )
            assert parabola_mps == pytest.approx(shown_mps(after_s), rel=1e-3, abs=2e-7)


@pytest.mark.parametrize("combine", [LEAST_SQUARES, PUBLISHED])
@pytest.mark.parametrize("spectrum", ["{g_rms: 0.1}", FLAT, "{g_rms: 4.4}", LAUNCH])
def test_errors_of_a_run(spectrum: str, combine: str) -> None:
    model = modelled(spectrum, combine)
    assert model.scenario.vibration is not None
    expected = np.sqrt(vibration_variances(model.scenario.vibration, model.scenario.instrument)[:2, 2])
    run = measure_whole(model)
    assert run.range_valid.all()
    if expected[0] > 0.1:
        assert run.range_degrees_of_freedom.min() > 100.0
    sigmas = run.sigma_range_m[:, 0], run.sigma_speed_mps[:, 0]
    for error, sigma, rms in zip(errors(run), sigmas, expected, strict=True):
        if rms > 0.03e-3:  # beside the receiver's noise
            assert np.std(error) == pytest.approx(rms, rel=0.03)
        # Lines of a bin count as wide, which adds to the sigma of a speed from one record.
        least = 0.6 if rms < 1e-3 and spectrum == "{g_rms: 4.4}" else 0.9
        assert least < np.quantile(np.abs(error) / sigma, 0.6827) < 1.1


@pytest.mark.parametrize("combine", [LEAST_SQUARES, PUBLISHED])
def test_each_shot_against_exact_light(combine: str) -> None:
    """The reference moves the lidar by the tones' displacement while the light of scatterers arrives."""
    fast, exact = (
        errors(measure_whole(modelled(FLAT, combine, 24, level=level))) for level in ("spectral", "reference")
    )
    apart_m, apart_mps = (np.sqrt(np.mean((a - b) ** 2)) for a, b in zip(fast, exact, strict=True))
    assert np.std(exact[0]) > 0.1
    assert apart_m < 0.02 * np.std(exact[0])
    assert apart_mps < 0.03e-3


def test_a_shot_alone_is_the_shot_of_the_run() -> None:
    model = modelled(FLAT, shots=40)
    whole = measure_whole(model)
    alone, _, _ = measure(model, 17, 1, initial_state(model))
    for name in ("range_m", "closing_speed_mps", "sigma_range_m", "true_closing_speed_mps"):
        np.testing.assert_array_equal(getattr(alone, name)[0], getattr(whole, name)[17])


def test_vibration_across_a_beam_changes_nothing() -> None:
    still, across = (
        measure_whole(modelled(FLAT, shots=20, vibration=each)) for each in ("null", f"{{along_x: {FLAT}}}")
    )
    for name in ("range_m", "closing_speed_mps", "sigma_range_m", "sigma_speed_mps"):
        np.testing.assert_array_equal(getattr(across, name), getattr(still, name))


@pytest.mark.parametrize(
    ("axes", "range_m", "correlation"),
    [
        (f"{{along_x: {FLAT}}}", 0.172 * 0.5, -1.0),
        (f"{{along_z: {FLAT}}}", 0.172 * np.sqrt(0.75), 1.0),
        (f"{{along_x: {FLAT}, along_z: {FLAT}}}", 0.172, 0.5),
    ],
)
def test_beams_that_fire_together_share_the_motion(axes: str, range_m: float, correlation: float) -> None:
    """Beams 30 degrees to either side have the component 1/2 of x with opposite signs, and √(3/4) of z."""
    pair = "{pattern: {kind: directions, beams: [[30, 0], [30, 180]]}}"
    run = measure_whole(modelled(FLAT, shots=1000, scanner=pair, vibration=axes))
    error_m = (run.range_m - run.true_range_m)[run.range_valid.all(axis=1)]
    assert len(error_m) > 900
    assert np.std(error_m[:, 0]) == pytest.approx(range_m, rel=0.08)
    assert np.corrcoef(error_m.T)[0, 1] == pytest.approx(correlation, abs=0.1)


def test_the_plan_expects_it() -> None:
    model = modelled(FLAT, shots=40)
    (row,) = [each for each in model.plan.decisions if each.stage == "vibration"]
    assert row.reason.startswith("scatters ranges by 0.18 m, speeds by 0.0012 m/s")
    expected = expected_error(model.scenario, model.flight, model.plan.beamlets)
    assert expected.range_rms_m == pytest.approx(0.171, rel=0.02)
    assert expected.speed_rms_mps == pytest.approx(1.11e-3, rel=0.02)


def test_the_truth_has_none() -> None:
    run = measure_whole(modelled(FLAT, shots=20, level="geometric"))
    np.testing.assert_allclose(run.true_closing_speed_mps, 0.5, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(run.range_m, run.true_range_m)


@pytest.mark.parametrize(
    ("spectrum", "message"),
    [
        ("{}", "g_rms: missing; state g_rms, or g2_per_hz"),
        ("{g_rms: 1, frequency_hz: [200, 20]}", "frequency_hz: must be ascending (got [200, 20])"),
        ("{g2_per_hz: [1, 1, 1]}", "g2_per_hz: must be as long as frequency_hz (got [1, 1, 1])"),
        ("{g_rms: 1, frequency_hz: [1, 20]}", "frequency_hz.0: must be greater than or equal to 10 (got 1)"),
    ],
)
def test_spectra_that_mean_nothing(spectrum: str, message: str) -> None:
    with pytest.raises(InputError) as refused:
        modelled(spectrum)
    assert message in str(refused.value)


def test_several_looks_are_refused() -> None:
    with pytest.raises(InputError, match=r"detection\.looks: must be 1 with vibration"):
        modelled(FLAT, instrument__detection__looks="4")
