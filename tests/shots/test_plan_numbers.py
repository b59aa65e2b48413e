"""What a plan leaves out, in numbers: there for every row, and confirmed by runs with the effect and without it."""

from __future__ import annotations

import numpy as np
import pytest

import lidar_emu
from lidar_emu.plan import LeftOut
from lidar_emu.plan.beat_errors import steepest_detection
from lidar_emu.plan.detection_forecast import rule_probability
from lidar_emu.receiver.probability import detection_probability, shared_fade_probability, threshold_power
from lidar_emu.scenario.instrument import Detection
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model, measure_whole

SKIPPED = {"smear and migration", "laser line", "speckle within a record", "false alarms"}
"""Left out beam by beam."""
SETTINGS: list[tuple[str, dict[str, str]]] = [
    *((name, {}) for name in lidar_emu.shipped_scenarios()),
    ("descent.yaml", {"instrument": "ndl_as_flown"}),
    ("descent.yaml", {"instrument.waveform.slope_scatter": "1e-9", "instrument.optics.leakage_db": "-120"}),
    (
        "descent.yaml",
        {"level": "geometric", "site.surface.roughness_m": "0.01", "vibration": "{along_z: {g_rms: 1}}"},
    ),
]


@pytest.mark.parametrize(("name", "settings"), SETTINGS)
def test_every_row_that_leaves_something_out_has_numbers(name: str, settings: dict[str, str]) -> None:
    for row in lidar_emu.plan_run(load(name, settings)).rows():
        numbers = [row[field] for field in LeftOut._fields]
        if (name, row["stage"]) == ("live.yaml", "curvature of motion"):
            # It is left out in proportion to a jerk that no plan knows.
            assert numbers == [None, None, None]
        elif not row["computed"] or row["stage"] in SKIPPED:
            assert all(isinstance(number, float | int) and 0.0 <= number < np.inf for number in numbers), row
            assert row["stage"] not in SKIPPED or row["bound"] == "exact" or any(numbers), row


def scene(**settings: str) -> dict[str, str]:
    """Two beams without speckle over level ground, from an ideal receiver that resolves bins."""
    ideal = "receiver: {adc: null, bandwidth_hz: null, ac_coupling_hz: 0}"
    keys = {
        "site": "flat",
        "instrument": f"{{base: ndl_fine, {ideal}, optics: {{speckle: off, beamlets: 1}}}}",
        "instrument.waveform.linewidth_hz": "0",
        "scanner": "{pattern: {kind: directions, beams: [[0, 0], [20, 0]]}}",
        "timing.rate_hz": "100",
    }
    return keys | settings


def both_ways(settings: dict[str, str], stage: str) -> tuple[LeftOut, np.ndarray, np.ndarray, np.ndarray]:
    """What the plan states of a stage, differences of ranges and speeds by it, and of the number of valid beams."""
    runs = []
    for share in ("0", "0.05"):
        scenario = load("descent", settings | {"left_out_share": share})
        assert isinstance(scenario, FlightScenario)
        model = build_model(scenario)
        runs.append(measure_whole(model))
    (row,) = (each for each in model.plan.decisions if each.stage == stage)
    assert row.left_out is not None
    exact, default = runs
    valid = np.stack([exact.range_valid, default.range_valid]).astype(int)
    return (
        row.left_out,
        default.range_m - exact.range_m,
        default.closing_speed_mps - exact.closing_speed_mps,
        valid[1] - valid[0],
    )


def test_the_scatter_and_the_loss_by_a_laser_line() -> None:
    """Faint beams, hardly detected: the line's scatter of half a share of the noise is left out."""
    fall = "[{altitude_m: 2040, speed_mps: 0.4}, {altitude_m: 1960, speed_mps: 0.4}]"
    keys = {"instrument.waveform.linewidth_hz": "20", "instrument.optics.laser_power_w": "0.02"}
    keys |= {
        "trajectory": f"{{kind: profile, waypoints: {fall}}}",
        "timing.rate_hz": "1000",
        "duration_s": "60",
    }
    effect, range_m, speed_mps, detected = both_ways(scene(**keys), "laser line")
    for differences, most in ((range_m, effect.range_m), (speed_mps, effect.speed_mps)):
        for beam in differences.T:
            assert 0.15 * most < np.nanstd(beam) < most
    changed = np.abs(detected.mean(axis=0))
    assert (0.5 * effect.detection_probability < changed).all()
    assert (changed < effect.detection_probability).all()


def test_the_shift_by_smear() -> None:
    """A deceleration of half the limit, of a beam without noise."""
    brake = "{kind: profile, waypoints: [{altitude_m: 300, speed_mps: 4.6}, {altitude_m: 280, speed_mps: 1}]}"
    keys = {"instrument.optics.laser_power_w": "1e6", "instrument.detection.peak": "jacobsen"}
    effect, range_m, speed_mps, detected = both_ways(
        scene(trajectory=brake, **keys, duration_s="5"), "smear and migration"
    )
    assert 0.2 * effect.range_m < np.max(np.abs(range_m)) < effect.range_m
    assert 0.1 * effect.speed_mps < np.max(np.abs(speed_mps)) < effect.speed_mps
    assert not detected.any()


def test_the_height_that_a_map_plane_lacks() -> None:
    """Level ground on a grid without projection, and on the body's sphere."""
    keys = {
        "trajectory.waypoints": "[{altitude_m: 2000, speed_mps: 40}, {altitude_m: 1900, speed_mps: 40}]",
        "site.ground": "{kind: generated, size_m: 4096, spacing_m: 32}",
        "duration_s": "1",
        "level": "geometric",
    }
    model = build_model(load("descent", scene(**keys)))
    (row,) = (each for each in model.plan.decisions if each.stage == "curvature of the grid")
    assert row.left_out is not None
    on_sphere = load("descent", scene(**keys | {"site.ground": "{kind: sphere}"}))
    farther_m = measure_whole(build_model(on_sphere)).range_m - measure_whole(model).range_m
    assert np.max(farther_m) == pytest.approx(row.left_out.range_m, rel=0.01)
    assert row.left_out.range_m > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("rule", ["all_three", "any_two"])
@pytest.mark.parametrize("speckle", [True, False])
@pytest.mark.parametrize(("looks", "minus_log_pfa"), [(1, 2.0), (1, 18.0), (1, 690.0), (8, 18.0), (64, 18.0)])
def test_no_probability_is_steeper(rule: str, speckle: bool, looks: int, minus_log_pfa: float) -> None:
    """Against slopes of the probabilities themselves."""
    detection = Detection.model_validate({"rule": rule, "combine": "least_squares", "looks": looks})
    log_snr = np.linspace(-4.0, 9.0, 800)
    fading = "swerling_2" if speckle else "steady"

    def of_segments(segment: np.ndarray) -> np.ndarray:
        return np.asarray(rule_probability(detection, segment))

    tables = [of_segments(detection_probability(fading, np.exp(log_snr), minus_log_pfa, looks))]
    if speckle:
        tables.append(shared_fade_probability(of_segments, np.exp(log_snr), minus_log_pfa, looks))
    steepest = max(float(np.max(np.diff(table) / np.diff(log_snr))) for table in tables)
    bound = steepest_detection(threshold_power(minus_log_pfa, looks) / looks, looks, speckle=speckle)
    assert 0.3 * bound < steepest < bound
