"""What each fault of beams makes of a measurement, against its definition; the rest stays as it was."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidar_emu.api import simulate
from lidar_emu.errors import InputError
from lidar_emu.measurement import Measurement
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.schema import BenchScenario
from lidar_emu.shots.model import build_model

BEAMS, INVALID = [0, 1, 2], 3
WINDOW = {"from_s": 0.4, "to_s": 1.0}
INSIDE = slice(20, 50)
COLUMNS = (
    "range_m", "closing_speed_mps", "range_valid", "speed_valid", "sign_resolved", "reason", "segments",
    "snr_db", "residual_mps", "sigma_range_m", "sigma_speed_mps", "returns", "second_range_m",
)  # fmt: skip
VALUES = ("range_m", "closing_speed_mps")


@pytest.fixture
def flown(bench: Any) -> Any:
    """The pattern with and without a fault in the window; checks that shots outside are the same."""

    def run(beams: list[int] | None = None, **fault: Any) -> tuple[Measurement, Measurement]:
        ordered = {**WINDOW, **fault} | ({} if beams is None else {"beams": beams})
        good, bad = simulate(bench()), simulate(bench(ordered))
        outside = np.ones(len(good), dtype=bool)
        outside[INSIDE] = False
        touched = range(4) if beams is None else beams
        for name in COLUMNS:
            np.testing.assert_array_equal(getattr(good, name)[outside], getattr(bad, name)[outside])
            others = [beam for beam in range(4) if beam not in touched]
            np.testing.assert_array_equal(getattr(good, name)[:, others], getattr(bad, name)[:, others])
        for name in ("shot", "time_ns", "due_ns", "fired", "true_range_m", "true_closing_speed_mps"):
            np.testing.assert_array_equal(getattr(good, name), getattr(bad, name))
        return good, bad

    return run


def same_but(good: Measurement, bad: Measurement, *changed: str) -> None:
    for name in set(COLUMNS) - set(changed):
        np.testing.assert_array_equal(getattr(good, name), getattr(bad, name), err_msg=name)


def test_dropout(flown: Any) -> None:
    good, bad = flown([1], kind="dropout")
    assert (bad.reason[INSIDE, 1] == Reason.BELOW_THRESHOLD).all()
    for name in ("range_valid", "speed_valid", "sign_resolved", "segments", "returns"):
        assert not getattr(bad, name)[INSIDE, 1].any()
    for name in (*VALUES, "snr_db", "second_range_m"):
        assert np.isnan(getattr(bad, name)[INSIDE, 1]).all()
    assert good.range_valid[INSIDE, 1].all()


@pytest.mark.parametrize("value", ["range", "closing_speed", "both"])
def test_stuck(flown: Any, value: str) -> None:
    good, bad = flown([0, 2, 3], kind="stuck", value=value)
    names = {"range": VALUES[:1], "closing_speed": VALUES[1:], "both": VALUES}[value]
    same_but(good, bad, *names)
    for name in names:
        before = getattr(good, name)[INSIDE.start - 1, [0, 2]]
        assert (getattr(bad, name)[INSIDE, [0, 2]] == before).all()


def test_stuck_takes_the_last_valid_value_and_leaves_an_invalid_beam(bench: Any) -> None:
    lost = {"kind": "dropout", "from_s": 0.3, "to_s": 0.6, "beams": [0]}
    bad = simulate(bench(lost, {"kind": "stuck", **WINDOW, "beams": [0]}))
    assert np.isnan(bad.range_m[15:30, 0]).all()
    assert (bad.range_m[30:50, 0] == simulate(bench()).range_m[14, 0]).all()


def test_frozen(flown: Any) -> None:
    good, bad = flown([1, 3], kind="frozen")
    for name in COLUMNS:
        expected = np.broadcast_to(getattr(good, name)[INSIDE.start - 1, [1, 3]], (30, 2))
        np.testing.assert_array_equal(getattr(bad, name)[INSIDE, [1, 3]], expected)


def test_frozen_from_the_start_repeats_the_first_shot(bench: Any) -> None:
    good, bad = simulate(bench()), simulate(bench({"kind": "frozen", "to_s": 0.5}))
    assert (bad.range_m[:25, 0] == good.range_m[0, 0]).all()
    assert bad.range_m[25, 0] == good.range_m[25, 0]


def test_a_frozen_dropout_stays_lost(bench: Any) -> None:
    lost = {"kind": "dropout", "at_s": 0.38, "beams": [0]}
    bad = simulate(bench(lost, {"kind": "frozen", **WINDOW, "beams": [0]}))
    assert (bad.reason[19:50, 0] == Reason.BELOW_THRESHOLD).all()
    assert bad.range_valid[50, 0]


def test_bias(flown: Any) -> None:
    good, bad = flown(BEAMS, kind="bias", range_m=-3.5, closing_speed_mps=0.25)
    same_but(good, bad, *VALUES)
    np.testing.assert_allclose((bad.range_m - good.range_m)[INSIDE, :3], -3.5, rtol=1e-12)
    np.testing.assert_allclose((bad.closing_speed_mps - good.closing_speed_mps)[INSIDE, :3], 0.25, rtol=1e-12)


def test_a_range_stops_at_zero(flown: Any) -> None:
    _, bad = flown([0], kind="bias", range_m=-5000.0)
    assert (bad.range_m[INSIDE, 0] == 0).all()


RAMPED = [
    {"kind": "bias", "range_m": 6.0, "closing_speed_mps": -0.5},
    {"kind": "scale", "range_factor": 1.02, "closing_speed_factor": 0.5},
    {"kind": "noise", "range_m": 2.0, "closing_speed_mps": 0.1},
]


def errors(bad: Measurement, good: Measurement) -> Any:
    """(shots, beams, 2) Errors of range and speed of the valid beams."""
    return np.stack([(getattr(bad, name) - getattr(good, name))[:, :3] for name in VALUES], axis=-1)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(RAMPED), st.integers(0, 1000), st.integers(20, 1500), st.integers(1, 1200))
def test_an_error_grows_along_its_ramp(
    bench: Any, fault: dict[str, Any], from_ms: int, lasts_ms: int, ramp_ms: int
) -> None:
    """From the first shot that begins in the window, in any window; with the random numbers of the whole error."""
    window = {"from_s": from_ms / 1000, "to_s": (from_ms + lasts_ms) / 1000}
    good, whole = simulate(bench()), simulate(bench(fault | window))
    bad = simulate(bench(fault | window | {"ramp_s": ramp_ms / 1000}))
    shot_ms = 20 * np.arange(100)
    first_ms = -(-from_ms // 20) * 20
    share = np.clip((shot_ms - first_ms) / ramp_ms, 0.0, 1.0)[:, None, None]
    np.testing.assert_allclose(errors(bad, good), share * errors(whole, good), atol=1e-9)
    acts = (shot_ms >= from_ms) & (shot_ms < from_ms + lasts_ms)
    np.testing.assert_array_equal((errors(whole, good) != 0).all(axis=(1, 2)), acts)
    for name in VALUES:
        assert np.isnan(getattr(bad, name)[:, INVALID]).all()


def test_scale(flown: Any) -> None:
    good, bad = flown([1], kind="scale", range_factor=1.01, closing_speed_factor=0.5)
    same_but(good, bad, *VALUES)
    np.testing.assert_allclose(bad.range_m[INSIDE, 1], 1.01 * good.range_m[INSIDE, 1], rtol=1e-14)
    np.testing.assert_allclose(bad.closing_speed_mps[INSIDE, 1], good.closing_speed_mps[INSIDE, 1] / 2)


def test_drift(flown: Any) -> None:
    good, bad = flown([1], kind="drift", range_mps=10.0, closing_speed_mps2=-2.0)
    same_but(good, bad, *VALUES)
    since_s = np.arange(30) / 50
    np.testing.assert_allclose((bad.range_m - good.range_m)[INSIDE, 1], 10 * since_s, atol=1e-9)
    difference = (bad.closing_speed_mps - good.closing_speed_mps)[INSIDE, 1]
    np.testing.assert_allclose(difference, -2 * since_s, atol=1e-9)


def test_noise(bench: Any) -> None:
    long = {"timing": {"rate_hz": 5000}}
    good = simulate(bench(**long))
    bad = simulate(bench({"kind": "noise", "range_m": 2.0, "closing_speed_mps": 0.1}, **long))
    same_but(good, bad, *VALUES)
    count = good.range_m[:, :3].size
    for name, sigma in (("range_m", 2.0), ("closing_speed_mps", 0.1)):
        error = (getattr(bad, name) - getattr(good, name))[:, :3]
        assert error.std() == pytest.approx(sigma, rel=5 / np.sqrt(2 * count))
        assert abs(error.mean()) < 5 * sigma / np.sqrt(count)
        assert (error**4).mean() == pytest.approx(3 * sigma**4, rel=5 * np.sqrt(96 / 9 / count))
        correlation = np.corrcoef(np.vstack([error.T, np.roll(error[:, 0], 1)]))
        assert np.abs(correlation - np.eye(4)).max() < 5 / np.sqrt(len(error))


def test_outlier(flown: Any) -> None:
    good, bad = flown([0, 3], kind="outlier", range_m=[10, 40], closing_speed_mps=[-5, 5])
    hit = bad.range_m[INSIDE, [0, 3]], bad.closing_speed_mps[INSIDE, [0, 3]]
    assert (hit[0] >= 10).all()
    assert (hit[0] <= 40).all()
    assert np.ptp(hit[0]) > 20
    assert (np.abs(hit[1]) <= 5).all()
    assert np.ptp(hit[1]) > 5
    assert len(np.unique(hit[0])) == 60
    assert bad.range_valid[INSIDE, 3].all()
    assert (bad.reason[INSIDE, 3] == Reason.VALID).all()
    assert (bad.segments[INSIDE, 3] == 7).all()
    assert (bad.returns[INSIDE, 3] == 1).all()
    assert not good.range_valid[INSIDE, 3].any()


def test_an_outlier_of_the_range_alone_needs_a_speed(flown: Any) -> None:
    good, bad = flown([0, 3], kind="outlier", range_m=[10, 40])
    same_but(good, bad, "range_m")
    assert (bad.range_m[INSIDE, 0] <= 40).all()
    assert np.isnan(bad.range_m[INSIDE, 3]).all()


def test_wrong_sign(flown: Any) -> None:
    good, bad = flown(None, kind="wrong_sign")
    same_but(good, bad, "closing_speed_mps")
    np.testing.assert_array_equal(bad.closing_speed_mps[INSIDE], -good.closing_speed_mps[INSIDE])


def test_swapped_beams(flown: Any) -> None:
    good, bad = flown([1, 3], kind="swapped_beams")
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(bad, name)[INSIDE, 1], getattr(good, name)[INSIDE, 3])
        np.testing.assert_array_equal(getattr(bad, name)[INSIDE, 3], getattr(good, name)[INSIDE, 1])


def test_false_valid(flown: Any) -> None:
    good, bad = flown(None, kind="false_valid", range_m=12.0, closing_speed_mps=3.0)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(bad, name)[:, :3], getattr(good, name)[:, :3])
    assert bad.range_valid[INSIDE, INVALID].all()
    assert bad.speed_valid[INSIDE, INVALID].all()
    assert (bad.range_m[INSIDE, INVALID] == 12).all()
    assert (bad.closing_speed_mps[INSIDE, INVALID] == 3).all()
    assert (bad.reason[INSIDE, INVALID] == Reason.VALID).all()


def test_false_invalid(flown: Any) -> None:
    good, bad = flown([2, 3], kind="false_invalid")
    same_but(good, bad, "range_valid", "speed_valid", "reason")
    assert not bad.range_valid[INSIDE, 2].any()
    assert not bad.speed_valid[INSIDE, 2].any()
    assert set(good.reason[INSIDE, 2]) == {Reason.VALID}
    assert set(bad.reason[INSIDE, 2]) == {Reason.BELOW_THRESHOLD}
    assert (bad.reason[INSIDE, 3] == good.reason[INSIDE, 3]).all()


def test_faults_act_in_their_order(bench: Any) -> None:
    bias, scale = {"kind": "bias", "range_m": 100.0}, {"kind": "scale", "range_factor": 2.0}
    good = simulate(bench()).range_m[:, 0]
    np.testing.assert_allclose(simulate(bench(bias, scale)).range_m[:, 0], 2 * (good + 100))
    np.testing.assert_allclose(simulate(bench(scale, bias)).range_m[:, 0], 2 * good + 100)


def test_another_fault_behind_it_changes_no_chance(bench: Any) -> None:
    noise = {"kind": "noise", "range_m": 1.0, "probability": 0.5}
    more = {"kind": "noise", "closing_speed_mps": 1.0, "probability": 0.5}
    alone, both = simulate(bench(noise)), simulate(bench(noise, more))
    np.testing.assert_array_equal(alone.range_m, both.range_m)


def test_a_beam_that_there_is_not_is_refused(bench: Any) -> None:
    scenario: BenchScenario = bench({"kind": "dropout"}, {"kind": "bias", "range_m": 1.0, "beams": [0, 4]})
    with pytest.raises(
        InputError, match=r"faults\.1\.beams: must be beams of the scenario, 0 to 3 \(got \[0, 4\]\)"
    ):
        build_model(scenario)
