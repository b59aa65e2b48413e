"""Motion within a measurement, against beam geometry differentiated numerically at the three records' times."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidar_emu.api import simulate
from lidar_emu.beams.flight import Flight
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.plan import Decision
from lidar_emu.plan import motion as plan_motion
from lidar_emu.receiver.echoes import EchoModel
from lidar_emu.scenario.instrument import Waveform
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.flight_model import FlightModel
from lidar_emu.shots.model import build_model, measure_whole

C_MPS = 299_792_458.0
WAVEFORM = Waveform(linewidth_hz=0)
SEGMENT_S = WAVEFORM.segment_time_s
QUIET = {
    "waveform": {"linewidth_hz": 0},
    "optics": {"speckle": False, "laser_power_w": 1e3},
    "receiver": {"adc": None, "bandwidth_hz": None, "ac_coupling_hz": 0},
    "detection": {"peak": "aboutanios_mulgrew", "combine": "least_squares", "window": "rect"},
}
"""70 dB above the noise: a reading's scatter is some hundredths of a millimetre."""

ROLL_RAD, ROLL_HZ, ARM_M = np.radians(0.2), 3.0, 3.0
UP_M, SINKING_MPS = 500.0, 20.0
ROWS_HZ = 8000
"""The second derivative of the curve through the rows is of first order in their spacing."""

Planar = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""East and up of the sensor, and of its beam's unit vector, (2, n) each, at times (n,)."""


def rolling(time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A sensor at the end of an arm to the right of a vehicle that sinks steadily and rolls, looking along body z."""
    roll = ROLL_RAD * np.sin(2 * np.pi * ROLL_HZ * time_s)
    up_m = UP_M - SINKING_MPS * time_s
    return (
        np.stack([ARM_M * np.cos(roll), up_m - ARM_M * np.sin(roll)]),
        np.stack([-np.sin(roll), -np.cos(roll)]),
    )


def beam(path: Planar, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range to a level plane and closing speed (n,), the latter by differences of the sensor's position."""
    step_s = 1e-5
    sensor_m, axis = path(time_s)
    velocity_mps = (path(time_s + step_s)[0] - path(time_s - step_s)[0]) / (2 * step_s)
    return -sensor_m[1] / axis[1], np.sum(velocity_mps * axis, axis=0)


def reading(
    path: Planar, time_s: FloatArray, combine: str = "least_squares"
) -> tuple[FloatArray, FloatArray]:
    """Range and closing speed (n,) that three records make of the true motion; times are of validity."""
    slope, carrier_hz = WAVEFORM.chirp_slope_hz_per_s, C_MPS / WAVEFORM.wavelength_m
    half_s = WAVEFORM.record_time_s / 2
    beats = []
    for segment, chirp, from_carrier_s in ((-1, -1, half_s), (0, 0, 0.0), (1, 1, SEGMENT_S - half_s)):
        received_s = time_s + segment * SEGMENT_S
        # The light met the ground R/c before.
        range_m, closing_mps = beam(path, received_s - beam(path, received_s)[0] / C_MPS)
        shift_hz = slope * 2 * range_m / C_MPS
        doppler = (1 + closing_mps / C_MPS) / (1 - closing_mps / C_MPS) - 1
        optical_hz = carrier_hz - slope * from_carrier_s + chirp * shift_hz
        beats.append(shift_hz * abs(chirp) + (chirp or 1) * optical_hz * doppler)
    up_hz, constant_hz, down_hz = beats
    if combine == "least_squares":
        beat_hz, doppler_hz = (up_hz + down_hz) / 2, (down_hz - up_hz + constant_hz) / 3
    else:
        beat_hz, doppler_hz = down_hz - constant_hz, constant_hz
    return beat_hz * C_MPS / (2 * slope), doppler_hz * WAVEFORM.wavelength_m / 2


@pytest.fixture
def fly(tmp_path: Path, make_flight: Callable[..., FlightScenario]) -> Callable[..., FlightScenario]:
    """Build a flight of one beam along a path given as columns of a table."""

    def made(columns: dict[str, FloatArray], **parts: Any) -> FlightScenario:
        file = tmp_path / "motion.csv"
        names = list(columns)
        rows = np.stack([columns[name] for name in names], axis=1)
        np.savetxt(file, rows, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
        length = {
            axis: {"column": axis, "unit": "m", "rate_column": f"{axis}_rate", "rate_unit": "m/s"}
            for axis in ("east", "up")
            if axis in columns
        }
        angle = {a: {"column": a, "unit": "rad"} for a in ("roll", "pitch") if a in columns}
        table = {
            "kind": "table",
            "file": str(file),
            "time": {"column": "time", "unit": "s"},
            **length,
            **angle,
        }
        nadir = {"pattern": {"kind": "ring", "count": 1, "angle_deg": 0}}
        scene = {"trajectory": table, "scanner": nadir, "instrument": QUIET, "timing": {"rate_hz": 100}}
        return make_flight(**(scene | parts))

    return made


def rolling_columns() -> dict[str, FloatArray]:
    time_s = np.arange(-0.05, 1.05, 1 / ROWS_HZ)
    return {
        "time": time_s - time_s[0],
        "up": UP_M - SINKING_MPS * time_s,
        "up_rate": np.full_like(time_s, -SINKING_MPS),
        "roll": ROLL_RAD * np.sin(2 * np.pi * ROLL_HZ * time_s),
    }


def times_s(run: Measurement) -> FloatArray:
    """Times of validity on the clock of `rolling`, away from the table's ends."""
    return run.time_s[5:-5, 0] - 0.05


def test_rolling_about_a_lever_arm_shifts_range_by_a_decimetre(fly) -> None:
    """±0.2 degrees at 3 Hz, 3 m from the centre: 3.7 m/s² across the arm, c T a / (λ S) of range."""
    run = simulate(fly(rolling_columns(), mounting={"lever_arm_m": [0, ARM_M, 0]}))
    range_m, closing_mps = reading(rolling, times_s(run))
    true_m, true_mps = beam(rolling, times_s(run))
    np.testing.assert_allclose(run.true_range_m[5:-5, 0], true_m, atol=1e-5)
    np.testing.assert_allclose(run.true_closing_speed_mps[5:-5, 0], true_mps, atol=1e-4)
    np.testing.assert_allclose(run.range_m[5:-5, 0], range_m, atol=1e-3)
    np.testing.assert_allclose(run.closing_speed_mps[5:-5, 0], closing_mps, atol=1e-4)
    bias_m = (run.range_m - run.true_range_m)[5:-5, 0]
    accelerating_mps2 = ARM_M * ROLL_RAD * (2 * np.pi * ROLL_HZ) ** 2
    assert accelerating_mps2 == pytest.approx(3.72, abs=0.01)
    assert (np.max(bias_m) - np.min(bias_m)) / 2 == pytest.approx(0.108, abs=0.002)


def vibrating(jerk_mps3: float) -> Planar:
    """A sensor that sinks steadily and vibrates at 20 Hz, looking down."""
    swing = 2 * np.pi * 20
    amplitude_m = jerk_mps3 / swing**3

    def path(time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        up_m = UP_M - SINKING_MPS * time_s + amplitude_m * np.sin(swing * time_s)
        still = np.zeros_like(up_m)
        return np.stack([still, up_m]), np.stack([still, still - 1])

    return path


def vibrating_columns(jerk_mps3: float) -> dict[str, FloatArray]:
    time_s, swing = np.arange(-0.05, 0.25, 1 / ROWS_HZ), 2 * np.pi * 20
    return {
        "time": time_s - time_s[0],
        "up": vibrating(jerk_mps3)(time_s)[0][1],
        "up_rate": -SINKING_MPS + jerk_mps3 / swing**2 * np.cos(swing * time_s),
    }


NODDING_RAD, BEAM_RAD = np.radians(5), np.radians(22.5)


def nodding(time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A sensor at the centre of a vehicle that rolls by ±5 degrees, with a beam 22.5 degrees to the right."""
    angle = BEAM_RAD - NODDING_RAD * np.sin(2 * np.pi * ROLL_HZ * time_s)
    up_m = UP_M - SINKING_MPS * time_s
    return np.stack([0 * up_m, up_m]), np.stack([np.sin(angle), -np.cos(angle)])


def nodding_columns() -> dict[str, FloatArray]:
    columns = rolling_columns()
    return columns | {"roll": columns["roll"] / ROLL_RAD * NODDING_RAD}


TO_THE_RIGHT = {"pattern": {"kind": "directions", "beams": [[22.5, 90]]}}


def curvature(scenario: FlightScenario) -> tuple[Decision, Measurement]:
    model = build_model(scenario)
    (decision,) = [d for d in model.plan.decisions if d.stage == "curvature of motion"]
    return decision, measure_whole(model)


def worst(run: Measurement, path: Planar, combine: str) -> tuple[float, float]:
    """Largest difference of range and closing speed from what the true motion reads."""
    range_m, closing_mps = reading(path, times_s(run), combine)
    return (
        float(np.max(np.abs(run.range_m[5:-5, 0] - range_m))),
        float(np.max(np.abs(run.closing_speed_mps[5:-5, 0] - closing_mps))),
    )


def bounds(decision: Decision) -> tuple[float, float]:
    range_m, speed_mps = decision.bound.split(", ")
    return float(range_m.removesuffix(" m")), float(speed_mps.removesuffix(" m/s"))


def combined(combine: str) -> dict[str, Any]:
    return QUIET | {"detection": QUIET["detection"] | {"combine": combine}}


NOISE_M, NOISE_MPS = 5e-4, 3e-6
"""Noise, the table's interpolation, and the estimator's error for a line that motion smears over half a bin."""


@pytest.mark.parametrize("combine", ["least_squares", "chirp_minus_doppler"])
@pytest.mark.parametrize(("jerk_mps3", "follows"), [(0.01, False), (1000, True)])
def test_jerk_is_left_out_within_its_bound_and_followed_beyond(fly, jerk_mps3, follows, combine) -> None:
    decision, run = curvature(fly(vibrating_columns(jerk_mps3), instrument=combined(combine)))
    range_m, speed_mps = worst(run, vibrating(jerk_mps3), combine)
    assert decision.computed is follows
    if not follows:
        assert bounds(decision)[0] <= 0.03 * np.nanmin(run.sigma_range_m)
    limit_m, limit_mps = (0.0, 0.0) if follows else bounds(decision)
    assert range_m <= limit_m + NOISE_M
    # Within a record the mean speed exceeds the centre's by up to jerk T² / 24, followed or not.
    assert speed_mps <= limit_mps + NOISE_MPS + jerk_mps3 * WAVEFORM.record_time_s**2 / 24


def test_bound_of_jerk_is_what_leaving_it_out_costs(fly, monkeypatch) -> None:
    """c δv / (λ S) with δv = j T²/2, by the published combination of chirp and constant segment."""
    monkeypatch.setattr(plan_motion, "CURVATURE_SHARE", 1e9)
    scenario = fly(vibrating_columns(1000), instrument=combined("chirp_minus_doppler"))
    decision, run = curvature(scenario)
    range_m, _ = worst(run, vibrating(1000), "chirp_minus_doppler")
    assert not decision.computed
    assert range_m == pytest.approx(C_MPS * 0.5 * 1000 * SEGMENT_S**2 / (1550e-9 * 2e12), rel=0.1)
    assert 0.9 * bounds(decision)[0] < range_m < bounds(decision)[0] + NOISE_M
    least_squares = fly(vibrating_columns(1000), instrument=combined("least_squares"))
    decision, run = curvature(least_squares)
    _, speed_mps = worst(run, vibrating(1000), "least_squares")
    assert 0.5 * bounds(decision)[1] < speed_mps < bounds(decision)[1] + NOISE_MPS


@pytest.mark.parametrize("follows", [True, False])
def test_echoes_of_a_turning_beam_at_the_times_of_the_chirps(fly, monkeypatch, follows) -> None:
    """Such a beam sweeps over the ground at 900 m/s: its line is too wide to read a range to a millimetre from."""
    if not follows:
        monkeypatch.setattr(plan_motion, "CURVATURE_SHARE", 1e9)
    one = QUIET | {"optics": QUIET["optics"] | {"beamlets": 1}}
    model = build_model(fly(nodding_columns(), scanner=TO_THE_RIGHT, instrument=one))
    assert isinstance(model, FlightModel)
    pointing, _ = model.aim(np.arange(5, 95), model.initial_state)
    echoes = model.echo_model.echoes(pointing, model.flight.cast(pointing))
    (decision,) = [d for d in model.plan.decisions if d.stage == "curvature of motion"]
    assert decision.computed is follows
    range_m, closing_mps, rate_mps = (
        a[..., 0] for a in (echoes.range_m, echoes.closing_speed_mps, echoes.range_rate_mps)
    )
    off_m, off_mps = [], []
    for since_s in (-SEGMENT_S, SEGMENT_S):
        there_m = range_m + (rate_mps + 0.5 * echoes.range_curvature_mps2 * since_s) * since_s
        gained = echoes.closing_acceleration_mps2 + 0.5 * echoes.closing_jerk_mps3 * since_s
        true_m, true_mps = beam(nodding, pointing.time_ns[:, 0] * 1e-9 - 0.05 + since_s)
        off_m.append(np.abs(there_m[:, 0] - true_m).max())
        off_mps.append(np.abs((closing_mps + gained * since_s)[:, 0] - true_mps).max())
    if follows:
        assert max(off_m) < 3e-6
        assert max(off_mps) < 1e-6
        return
    limit_m, limit_mps = bounds(decision)
    bend_m = float(decision.reason.split(", ")[1].split(" m of")[0])
    assert 0.1 * bend_m < max(off_m) < 1.01 * bend_m < limit_m
    assert 0.5 * limit_mps < max(off_mps) < limit_mps


def spinning(make_flight: Callable[..., FlightScenario], rate_radps: float) -> FlightScenario:
    """Over a nadir point 2000 m below, turning about a horizontal axis."""
    waypoints = [{"altitude_m": 2000.0 + above_m, "speed_mps": 1e-3} for above_m in (1e-6, 0.0)]
    attitude = {"body_rate_radps": [rate_radps, 0, 0]}
    profile = {"kind": "profile", "waypoints": waypoints, "attitude": attitude}
    nadir = {"pattern": {"kind": "ring", "count": 1, "angle_deg": 0}}
    return make_flight(trajectory=profile, scanner=nadir, timing={"rate_hz": 1000})


def test_a_turning_beam_receives_beside_its_own_footprint(make_flight) -> None:
    """2 rad/s for the 13 us to a ground 2 km away and back: 26.7 urad, with a divergence of 29."""
    scenario = spinning(make_flight, 2.0)
    flight = Flight(scenario)
    pointing, _ = flight.point(np.arange(1), flight.scanner.initial)
    hits = flight.cast(pointing)
    lagging, still = (
        EchoModel(scenario.instrument, scenario.site, flight, 1, lag).echoes(pointing, hits).power_w.item()
        for lag in (True, False)
    )
    assert 10 * np.log10(lagging / still) == pytest.approx(-3.381, abs=2e-3)


def test_lag_is_left_out_within_its_bound(make_flight) -> None:
    """On both sides of a hundredth of a decibel, and always on in an exact run."""
    limit_radps = 2.0 * np.sqrt(plan_motion.LEAST_LAG_DB / 3.381)
    for rate_radps, exact, computed in ((0.98, False, False), (1.02, False, True), (0.98, True, True)):
        scenario = spinning(make_flight, rate_radps * limit_radps).model_copy(
            update={"left_out_share": 0.0 if exact else 0.05}
        )
        model = build_model(scenario)
        (decision,) = [d for d in model.plan.decisions if d.stage == "lag of the receiving beam"]
        assert decision.computed is computed
        assert model.plan.receiving_lag is computed


def test_a_misaligned_beam_is_misaligned_in_every_record(fly) -> None:
    """Tilted about sensor x by 50 mrad, a beam to the right points that much closer to nadir, also while it turns."""
    tilt = [{"kind": "misalignment", "tilt_mrad": [50, 0]}]
    closer = {"pattern": {"kind": "directions", "beams": [[22.5 - np.degrees(0.05), 90]]}}
    aimed = []
    for scanner, faults in ((TO_THE_RIGHT, tilt), (closer, [])):
        model = build_model(fly(nodding_columns(), scanner=scanner, faults=faults))
        assert isinstance(model, FlightModel)
        aimed.append(model.aim(np.arange(20), model.initial_state)[0].at_chirps)
    np.testing.assert_allclose(aimed[0], aimed[1], rtol=0, atol=1e-12)
