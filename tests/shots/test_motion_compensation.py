"""An instrument that corrects for motion: what is left of the systematic errors, and from what it may conclude."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidar_emu import Measurement
from lidar_emu.scenario.instrument import SPEED_OF_LIGHT_MPS, Detection, Instrument
from lidar_emu.scenario.load import load
from lidar_emu.shots.model import build_model, initial_state, measure, measure_in_blocks, measure_whole
from lidar_emu.shots.motion_compensation import MotionCompensation

PER_MPS2 = 29.0e-3
"""c T/(λ S) of the default waveform, in metres per m/s²."""


def flown(name: str, compensate: str, **keys: str) -> Measurement:
    instrument = f"{{base: ndl_fine, detection: {{compensate: {compensate}}}}}"
    return measure_whole(build_model(load(name, {"instrument": instrument, **keys})))


def ratios(run: Measurement) -> np.ndarray:
    """Errors of ranges over sigma, from the second shot on."""
    error_m = run.range_m - run.true_range_m
    right = run.range_valid & (np.abs(error_m) < 3.0)
    right[0] = False
    return (error_m / run.sigma_range_m)[right]


@pytest.mark.parametrize("name", ["descent", "powered_descent"])
def test_errors_of_deceleration_are_within_sigma(name: str) -> None:
    before, after = (
        np.quantile(np.abs(ratios(flown(name, how))), 0.6827) for how in ("none", "acceleration")
    )
    assert before > 3.0
    assert after < 1.1


def given_shots(rate_hz: float, speed_mps: np.ndarray, range_m: float = 1000.0) -> Measurement:
    """One beam with these speeds (shots,), without noise."""
    shots = len(speed_mps)
    shape = shots, 1
    time_ns = np.round(np.arange(shots) * 1e9 / rate_hz).astype(np.int64)
    axis = np.broadcast_to([0.0, 0.0, 1.0], (*shape, 3))
    return Measurement.with_columns(
        np.arange(shots),
        time_ns[:, None],
        time_ns,
        range_m=np.full(shape, range_m),
        closing_speed_mps=speed_mps[:, None],
        range_valid=np.ones(shape, dtype=bool),
        speed_valid=np.isfinite(speed_mps)[:, None],
        sign_resolved=np.isfinite(speed_mps)[:, None],
        sigma_range_m=np.full(shape, 0.01),
        sigma_speed_mps=np.full(shape, 1e-3),
        beam_axis_body=axis,
    )


def corrected(shots: Measurement, combine: str = "least_squares") -> Measurement:
    compensation = MotionCompensation(Instrument(detection=Detection(combine=combine)), 1)
    return compensation.apply(shots, compensation.initial)[0]


def by_motion(speed_mps: np.ndarray, combine: str = "least_squares") -> np.ndarray:
    """Errors (2, shots) at 1000 m of range and speed that no acceleration changes, as docs/physics.md has them."""
    between_s, record_s, light_s = 300e-6, 2**17 / 600e6, 1000.0 / SPEED_OF_LIGHT_MPS
    if combine == "least_squares":
        time_s, share = -(between_s - record_s) / 2, 2e12 * between_s / (SPEED_OF_LIGHT_MPS / 1550e-9)
    else:
        time_s = np.where(speed_mps > 0, -(2 * between_s - record_s / 2), between_s + record_s / 2)
        share = 0.0
    range_m = speed_mps * (time_s + 3.0 * light_s)
    return np.stack([range_m, speed_mps**2 / SPEED_OF_LIGHT_MPS - share * speed_mps])


@given(
    rate_hz=st.sampled_from([10.0, 20.0, 50.0, 1000.0]),
    acceleration_mps2=st.floats(-50.0, 50.0),
    speed_mps=st.floats(-200.0, 200.0),
    combine=st.sampled_from(["least_squares", "chirp_minus_doppler"]),
)
@settings(deadline=None)
def test_a_steady_acceleration(
    rate_hz: float, acceleration_mps2: float, speed_mps: float, combine: str
) -> None:
    """The closed forms from 0.15 s on, whatever the rate; before, those without the acceleration."""
    speeds = speed_mps + acceleration_mps2 * np.arange(int(0.4 * rate_hz) + 2) / rate_hz
    speeds = speeds[np.abs(speeds) > 1e-6]
    if len(speeds) < 0.4 * rate_hz:
        return
    found = corrected(given_shots(rate_hz, speeds), combine)
    longer_m, faster_mps = by_motion(speeds, combine)
    shorter_m = 1000.0 - found.range_m[:, 0] - longer_m
    assert shorter_m[0] == pytest.approx(0.0, abs=1e-9)
    late = np.arange(len(speeds)) / rate_hz >= 0.15
    np.testing.assert_allclose(shorter_m[late], PER_MPS2 * acceleration_mps2, rtol=2e-3, atol=1e-9)
    expected = speeds - faster_mps + acceleration_mps2 * 1000.0 / SPEED_OF_LIGHT_MPS
    np.testing.assert_allclose(found.closing_speed_mps[late, 0], expected[late], rtol=0, atol=1e-9)


@pytest.mark.parametrize("rate_hz", [20.0, 1000.0])
def test_sigma_has_the_noise_of_the_correction(rate_hz: float) -> None:
    rng = np.random.default_rng(1)
    found = corrected(given_shots(rate_hz, 50.0 + 1e-3 * rng.normal(size=20_000)))
    late = slice(int(rate_hz), None)
    added_m = np.std(found.range_m[late, 0])
    stated_m = np.sqrt(np.median(found.sigma_range_m[late, 0]) ** 2 - 0.01**2)
    assert stated_m == pytest.approx(added_m, rel=0.1)


@pytest.mark.parametrize("gap", ["long", "axis", "lock"])
def test_what_does_not_continue_corrects_nothing(gap: str) -> None:
    speeds = 50.0 - 3.0 * np.arange(20) / 20.0
    shots = given_shots(20.0, speeds)
    if gap == "long":
        shots.time_ns[10:] += 10**9
    if gap == "axis":
        shots = Measurement(**{**vars(shots), "beam_axis_body": shots.beam_axis_body.copy()})
        shots.beam_axis_body[10:] = [0.0, 0.1, np.sqrt(0.99)]
    if gap == "lock":
        shots.closing_speed_mps[10:] += 90.0
    found = corrected(shots)
    shorter_m = 1000.0 - found.range_m[:, 0] - by_motion(shots.closing_speed_mps[:, 0])[0]
    assert shorter_m[10] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(shorter_m[[9, 12]], -3.0 * PER_MPS2, rtol=2e-3)


def test_blocks_do_not_matter() -> None:
    keys = {"instrument": "{base: ndl_fine, detection: {compensate: acceleration}}", "duration_s": "4"}
    model = build_model(load("descent", keys))
    whole = measure_whole(model)
    for block_shots in (1, 7):
        parts = Measurement.concatenate(list(measure_in_blocks(model, block_shots)))
        np.testing.assert_array_equal(parts.range_m, whole.range_m)
        np.testing.assert_array_equal(parts.point_site_m, whole.point_site_m)


def test_a_state_is_not_changed_by_measuring_from_it() -> None:
    keys = {"instrument": "{base: ndl_fine, detection: {compensate: acceleration}}", "duration_s": "4"}
    model = build_model(load("descent", keys))
    _, before, _ = measure(model, 0, 10, initial_state(model))
    first, _, _ = measure(model, 10, 5, before)
    again, _, _ = measure(model, 10, 5, before)
    np.testing.assert_array_equal(first.range_m, again.range_m)
