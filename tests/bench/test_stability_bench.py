"""`lidar-emu bench stability`: extremes that are extremes, what must not be reported, and what it prints."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from pydantic import ValidationError

from lidar_emu.bench import stability
from lidar_emu.cli import cli
from lidar_emu.errors import RunError
from lidar_emu.measurement import Measurement
from lidar_emu.receiver.returns import Reason
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario
from lidar_emu.shots.model import build_model

NUMBERS = list(stability.numbers(Instrument(), "instrument"))
SIGMAS, RANGES = ("sigma_range_m", "sigma_speed_mps"), ("range_m", "second_range_m")
BOUNDS = {
    "greater_than",
    "greater_than_equal",
    "less_than",
    "less_than_equal",
    "finite_number",
    "literal_error",
}


def scenario(**keys: Any) -> FlightScenario:
    loaded = load("descent", keys)
    assert isinstance(loaded, FlightScenario)
    return loaded


def refusals(key: str, value: float) -> set[str]:
    """Kinds of errors of a key that is set by itself."""
    _, part, *adc, name = key.split(".")
    tree: dict[str, Any] = {name: value}
    for above in (*adc, part):
        tree = {above: tree}
    try:
        Instrument.model_validate_json(json.dumps(tree))
    except ValidationError as error:
        return {
            each["type"] for each in error.errors() if name in (*each["loc"], each.get("ctx", {}).get("key"))
        }
    return set()


@pytest.mark.parametrize(("key", "ends"), NUMBERS, ids=[key for key, _ in NUMBERS])
def test_the_ends_of_a_key_are_admitted_and_nothing_beyond(key: str, ends: list[float]) -> None:
    least, largest = ends
    for end, towards in ((least, -math.inf), (largest, math.inf)):
        assert not refusals(key, end) & BOUNDS
        beyond = end + math.copysign(1, towards) if isinstance(end, int) else math.nextafter(end, towards)
        assert refusals(key, beyond) or math.isinf(beyond)


def test_every_number_of_an_instrument_has_its_ends() -> None:
    """As the reference of a scenario's keys lists them, in a page made by other code."""
    page = (Path(__file__).parents[2] / "docs" / "reference" / "instrument.md").read_text(encoding="utf-8")
    found = set()
    for part, table in re.findall(r"\nAt `(instrument\.[\w.]+)`\.(.*?)(?=\n#|\Z)", page, re.DOTALL):
        found |= {f"{part}.{key}" for key in re.findall(r"\n\| `(\w+)` \| (?:number|integer|`?1`?,)", table)}
    assert found == {key for key, _ in NUMBERS}


@pytest.fixture(scope="module")
def report() -> Measurement:
    """A beam that meets no surface, and valid ones."""
    keys = stability.over_level_ground(600.0, (23.0, 23.0), 0.5)
    attitude = {"trajectory.attitude.roll_deg": 70.0}
    model = build_model(scenario().with_(keys | attitude))
    run, _ = model.measure(0, model.shot_count, model.initial_state)
    assert 0 < run.range_valid.sum() < run.range_valid.size
    return run


def test_a_sound_report_has_no_violation(report: Measurement) -> None:
    assert list(stability.violations(report, 12_000.0)) == []


@pytest.mark.parametrize(
    ("column", "valid", "value"),
    [
        *((name, True, np.nan) for name in (*SIGMAS, "range_m", "closing_speed_mps", "snr_db")),
        *((name, True, np.inf) for name in (*RANGES, "closing_speed_mps", "snr_db", "residual_mps")),
        *((name, True, -1.0) for name in (*SIGMAS, *RANGES)),
        ("sigma_range_m", True, 0.0),
        ("range_m", True, 12_001.0),
        ("range_m", False, 1.0),
        ("range_valid", False, True),
        ("speed_valid", True, False),
        ("reason", False, int(Reason.VALID)),
        ("reason", False, 99),
    ],
)  # fmt: skip
def test_one_wrong_value_is_a_violation(report: Measurement, column: str, valid: bool, value: Any) -> None:
    values = getattr(report, column).copy()
    values[tuple(np.argwhere(report.range_valid == valid)[0])] = value
    assert list(stability.violations(replace(report, **{column: values}), 12_000.0))


def outcome(valid: int, range_m: float, speed_mps: float) -> stability.ExtremeOutcome:
    return stability.ExtremeOutcome(
        None, {"valid": valid, "beyond_range": 100 - valid}, 1.0, range_m, 0, speed_mps, 0
    )


def test_verdicts() -> None:
    usual = outcome(90, 0.1, 1e-3)
    for verdict, found in (
        ("as before", outcome(86, 0.19, 1.9e-3)),
        ("degraded", outcome(90, 0.21, 1e-3)),
        ("degraded", outcome(90, 0.1, 2.1e-3)),
        ("degraded", outcome(84, 0.1, 1e-3)),
        ("nothing valid", outcome(0, np.nan, np.nan)),
        ("unsound", outcome(90, 0.1, 1e-3)._replace(unsound=("range_m is infinite",))),
        ("refused", stability.ExtremeOutcome("timing.rate_hz: must be smaller")),
    ):
        assert found.verdict(usual) == verdict


def test_an_alias_is_no_error_of_speed_and_motion_within_a_measurement_is() -> None:
    """A closing speed is measured modulo λ fs/2; braking changes the range by c T a / (λ S)."""
    found = {each.name: each for each in stability.extremes(scenario(), 600.0)}
    braking = stability.measure(scenario(), found["braking by 30 m/s²"], "spectral")
    along_mps2 = 30.0 * math.cos(math.radians(22.5))
    assert braking.range_rms_m == pytest.approx(299792458 * 300e-6 * along_mps2 / (1550e-9 * 2e12), rel=0.1)
    fast = stability.measure(scenario(), found["speed 581.2 m/s"], "spectral")
    assert fast.valid > 0.8
    assert fast.speed_largest_mps < 0.05


@pytest.mark.parametrize(
    ("key", "value"), [("waveform.chirp_slope_hz_per_s", 5e-324), ("waveform.ripple_frequency_hz", 5e-324)]
)
def test_numbers_that_once_failed(key: str, value: float) -> None:
    usual = stability.extremes(scenario(), 600.0)[0].keys
    found = stability.measure(
        scenario(), stability.Extreme("", usual | {f"instrument.{key}": value}), "spectral"
    )
    assert found.verdict(found) in ("refused", "as before")


@pytest.mark.slow
@pytest.mark.parametrize("instrument", ["ndl_four_beam", "ndl_fine", "ndl_as_published", "ndl_as_flown"])
def test_the_shipped_instruments_are_sound(instrument: str) -> None:
    flown = scenario(instrument=instrument)
    for extreme in stability.extremes(flown, 600.0):
        for level in ("geometric", "spectral"):
            assert stability.measure(flown, extreme, level).unsound == (), (extreme.name, level)


class Bench:
    """A command whose extremes are replaced."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.monkeypatch = monkeypatch
        found = {each.name: each for each in stability.extremes(scenario(), 600.0)}
        self.extremes = [found[name] for name in ("level ground", "reflectance 0", "fft_length 1.678e+07")]

    def run(self, *words: str, outcomes: Iterator[stability.ExtremeOutcome] | None = None) -> Result:
        """Run it; with `outcomes`, of these."""
        self.monkeypatch.setattr(stability, "extremes", lambda *_: self.extremes)
        if outcomes is not None:
            self.monkeypatch.setattr(stability, "measure", lambda *_: next(outcomes))
        return CliRunner().invoke(cli, ["bench", "stability", *words], standalone_mode=False)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_what_it_prints(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    bench.extremes = [each._replace(safe=False) for each in bench.extremes]
    done = bench.run("--set", "instrument=ndl_fine")
    assert done.exception is None, done.exception
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert any(line.startswith("level ground 100/") for line in lines)
    assert any(line.startswith("reflectance 0 100/0/- below threshold") for line in lines)
    assert (
        "refused: fft_length 1.678e+07: instrument.waveform.fft_length: must be at most 180000" in done.stdout
    )
    assert lines[-1] == "2 extremes, at level spectral: 1 nothing valid, 1 refused"


def test_json_until_ctrl_c(bench: Bench) -> None:
    def outcomes() -> Iterator[stability.ExtremeOutcome]:
        yield from [outcome(90, 0.1, 1e-3)] * 4
        raise KeyboardInterrupt

    done = bench.run("live", "--json", outcomes=outcomes())
    assert done.exception is None, done.exception
    found = json.loads(done.stdout)
    assert found["interrupted"]
    assert [row["extreme"] for row in found["extremes"]] == ["level ground"]
    assert found["extremes"][0]["levels"]["reference"]["verdict"] == "as before"
    assert "interrupted after 1 extremes" in done.stderr


def test_what_is_unsound_fails(bench: Bench) -> None:
    wrong = outcome(90, 0.1, 1e-3)._replace(unsound=("range_m is infinite",))
    outcomes = iter([outcome(90, 0.1, 1e-3)] * 4 + [wrong] * 5)
    error = bench.run(outcomes=outcomes).exception
    assert isinstance(error, RunError)
    assert "reflectance 0, spectral: range_m is infinite" in str(error)
