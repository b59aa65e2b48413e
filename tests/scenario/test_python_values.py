"""Scenarios from Python: mappings, values of any type, changed copies; what is wrong is one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import lidar_emu
from lidar_emu.errors import InputError
from lidar_emu.scenario.load import load, load_with_settings, shipped_scenarios
from lidar_emu.scenario.schema import BenchScenario, FlightScenario

BENCH = {
    "name": "bench",
    "bench_pattern": {"duration_s": 1, "beams": [{"range_m": 100, "closing_speed_mps": 5}]},
}
WRONG = (None, 3, math.nan, b"x", [1], pd.DataFrame({"a": [1]}), object(), np.array([1.0, 2.0]))


@pytest.fixture(scope="module")
def descent() -> FlightScenario:
    scenario = load("descent")
    assert isinstance(scenario, FlightScenario)
    return scenario


def flight(*arguments: Any, **keys: Any) -> FlightScenario:
    scenario = load(*arguments, **keys)
    assert isinstance(scenario, FlightScenario)
    return scenario


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(InputError) as refused:
        call()
    line = str(refused.value)
    assert line.isprintable()
    return line


def test_values_of_python_and_text_as_on_the_command_line() -> None:
    asked = load_with_settings("descent.yaml", {"timing.rate_hz": "100", "duration_s": "5", "site": "mare"})
    assert asked == load("descent.yaml", {"timing.rate_hz": 100, "duration_s": 5, "site": "mare"})
    assert asked == load(Path("descent.yaml"), {"timing.rate_hz": "1e2", "site": "mare"}, duration_s=5)
    assert asked == load("descent", timing={"rate_hz": np.float64(100)}, duration_s=np.int64(5), site="mare")


def test_lists_tuples_arrays_and_instants() -> None:
    changed = flight("descent", {"mounting.lever_arm_m": np.array([1, 2, 3.0])})
    assert changed.mounting.lever_arm_m == (1.0, 2.0, 3.0)
    assert flight("descent", {"mounting.lever_arm_m": (1, 2, 3)}) == changed
    noon = datetime(2031, 1, 1, 12, tzinfo=UTC)
    assert load("bench", {"timing.epoch": noon}).timing.epoch == noon
    fault = {"kind": "dropout", "beams": [2]}
    assert load("bench", faults=[fault]) == load("bench", faults="[{kind: dropout, beams: [2]}]")


def test_parts_of_other_scenarios(descent: FlightScenario) -> None:
    fine = flight("paper_fig2").instrument
    assert flight("descent", instrument=fine).instrument == fine == descent.with_(instrument=fine).instrument


def test_a_mapping_is_a_file_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load(BENCH, {"bench_pattern.beams.0.range_m": 7})
    assert isinstance(scenario, BenchScenario)
    assert scenario.bench_pattern.beams[0].range_m == 7
    assert BENCH["bench_pattern"] == {"duration_s": 1, "beams": [{"range_m": 100, "closing_speed_mps": 5}]}
    monkeypatch.chdir(tmp_path)
    Path("bright.yaml").write_text("base: flat\nsurface: {reflectance: 0.9}\n")
    parts = {"instrument": "ndl_fine", "site": "bright", "scanner": "ndl_four_beam"}
    ramp = {"kind": "profile", "waypoints": [{"altitude_m": m, "speed_mps": 20} for m in (200, 100)]}
    assert flight({"name": "hop", **parts, "trajectory": ramp}).site.surface.reflectance == 0.9


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_scenario_is_checked_again_and_stays_the_same(name: str) -> None:
    scenario = load(name)
    assert load(scenario) == scenario.with_() == scenario
    assert scenario.with_(seed=5) == load(name, seed=5)


def test_a_part_is_changed_before_its_keys(descent: FlightScenario) -> None:
    changed = descent.with_({"site.surface.reflectance": 0.5, "site": "mare"})
    assert changed.site.surface.reflectance == 0.5
    assert changed.site.ground == flight("descent", site="mare").site.ground
    assert descent == load("descent")


def test_every_refusal_is_one_line_with_key_value_and_what_is_allowed(descent: FlightScenario) -> None:
    for change in (load, lidar_emu.simulate):
        line = refusal(lambda change=change: change("descent", {"timing.rate_hz": -100}))  # type: ignore[misc]
        assert line == "overrides: timing.rate_hz: must be greater than or equal to 0.001 (got -100)"
    assert refusal(lambda: descent.with_({"timing.rate_hz": -100})) == line
    on_the_command_line = refusal(lambda: load_with_settings("descent", {"timing.rate_hz": "-100"}))
    assert line == on_the_command_line.replace("--set", "overrides")
    unchecked = descent.timing.model_copy(update={"rate_hz": -100.0})
    line = refusal(lambda: lidar_emu.simulate(descent.model_copy(update={"timing": unchecked})))
    assert line.startswith("descent: timing.rate_hz: must be greater than or equal to 0.001 (got -100.0)")
    assert "no such key; known here: name, seed" in refusal(lambda: descent.with_(nothing=4))
    assert "overrides: bench_pattern" in refusal(lambda: descent.with_(bench_pattern={}))
    assert "nested too deeply" in refusal(lambda: load(endless()))


def endless() -> dict[str, Any]:
    mapping: dict[str, Any] = {}
    mapping["mapping"] = mapping
    return mapping


@pytest.mark.parametrize("value", WRONG, ids=lambda value: type(value).__name__)
def test_wrong_types_are_refused(descent: FlightScenario, value: Any) -> None:
    assert refusal(lambda: load(value)).startswith("scenario: ")
    assert refusal(lambda: lidar_emu.simulate(value)).startswith("scenario: ")
    for key in ("site", "name", "trajectory"):
        assert refusal(lambda key=key: load("descent", **{key: value})).startswith(f"overrides: {key}")  # type: ignore[misc]
        assert refusal(lambda key=key: descent.with_({key: value})).startswith(f"overrides: {key}")  # type: ignore[misc]
    if value is not None:
        assert refusal(lambda: load("descent", value)).startswith("overrides: ")
        if type(value) is not int:
            assert refusal(lambda: lidar_emu.simulate("bench", seed=value)).startswith("overrides: seed")
    assert refusal(lambda: load("descent", {value if value.__hash__ else ("a",): 1})).startswith(
        "overrides: "
    )
