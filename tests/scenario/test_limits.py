"""Absurd numbers in every numeric key: a refusal in one line, or a plan without a warning of NumPy."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator

import pytest

from lidar_emu import InputError, load, plan_run
from lidar_emu.scenario.section import LIMITS, Part

ABSURD = (1e300, -1e300, math.nan, math.inf, 1e-300)
SCENARIOS = (
    "descent",
    "bench",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("powered_descent", "dusty_landing")),
)


def numeric_keys(value: object, key: str = "") -> Iterator[str]:
    """Dotted keys of the numbers in a scenario, and of the optional ones left out."""
    below: dict[str, object] = {}
    if isinstance(value, Part):
        for name, field in type(value).model_fields.items():
            stated = getattr(value, name)
            below[name] = 1.0 if stated is None and "float" in str(field.annotation) else stated
    elif isinstance(value, list | tuple):
        below = {str(i): item for i, item in enumerate(value)}
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key
    for name, item in below.items():
        yield from numeric_keys(item, f"{key}.{name}" if key else name)


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_absurd_number_is_refused_in_one_line_or_planned(name: str) -> None:
    scenario = load(name)
    keys = list(numeric_keys(scenario))
    assert len(keys) > 10
    wrong = []
    for key in keys:
        for number in ABSURD:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    plan_run(scenario, {key: number})
            except InputError as error:
                line = str(error)
                if "\n" in line or not ("(got " in line or "; " in line):
                    wrong.append((key, number, line))
            except Exception as error:
                wrong.append((key, number, repr(error)))
            else:
                unit = key.rpartition("_")[2]
                if not math.isfinite(number) or (abs(number) > 1 and unit in LIMITS and "_per_" not in key):
                    wrong.append((key, number, "accepted"))
    assert not wrong


@pytest.mark.parametrize(
    ("key", "number", "limit"),
    [
        ("instrument.optics.laser_power_w", 1e300, "at most 1e+09 W in magnitude"),
        ("instrument.waveform.linewidth_hz", 1e300, "at most 1e+15 Hz in magnitude"),
        ("mounting.yaw_deg", -1e300, "at most 1e+06 deg in magnitude"),
        ("device.clock.holdover_s", 1e300, "at most 1e+09 s in magnitude"),
    ],
)
def test_the_refusal_names_limit_and_unit(key: str, number: float, limit: str) -> None:
    with pytest.raises(InputError) as refused:
        load("descent", {key: number})
    assert str(refused.value).endswith(f"{key}: must be {limit} (got {number})")


def test_the_numbers_of_a_ramp_have_the_limit_of_its_key() -> None:
    with pytest.raises(InputError, match=r"closing_speed_mps\.stop: must be at most 3e\+08 m/s"):
        load("bench", {"bench_pattern.beams.1.closing_speed_mps.stop": 1e300})


@pytest.mark.parametrize("line", ["k{}: 1", "- {}"])
def test_a_text_of_more_values_than_a_user_waits_for_is_refused_unread(tmp_path, monkeypatch, line):
    path = tmp_path / "many.yaml"
    path.write_text("\n".join(line.format(n) for n in range(20_001)))
    monkeypatch.setattr("lidar_emu.scenario.yaml_text.read_values", lambda _: pytest.fail("it was read"))
    with pytest.raises(
        InputError, match=r"many.yaml: 20001 colons, commas and dashes; use at most 20000 values"
    ):
        load(path)


@pytest.mark.parametrize(
    ("scenario", "key"),
    [
        ("descent", "instrument.receiver.bandwidth_hz"),
        ("descent", "site.surface.roughness_m"),
        ("powered_descent", "trajectory.vehicle.gear.stiffness_npm"),
    ],
)
def test_the_least_number_of_all_is_planned_with(scenario: str, key: str) -> None:
    assert plan_run(scenario, {key: 5e-324}).decisions
