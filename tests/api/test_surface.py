"""The names of `import lidar_emu`: what is there, documented and typed; imported on first use."""

from __future__ import annotations

import inspect
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from click.testing import CliRunner

import lidar_emu
from lidar_emu.cli import cli

NAMES = [name for name in lidar_emu.__all__ if name != "__version__"]


def test_the_names_are_stable() -> None:
    assert sorted(NAMES) == [
        "BenchScenario", "CampaignResults", "EmbeddedDevice", "FlightScenario", "Ground", "GroundTruth", "ImuErrors",
        "ImuSamples", "InputError", "Measurement", "Reason", "RunError", "SegmentSpectrum", "detection_by_altitude",
        "load", "plan_run", "read_recording", "record_geometry", "run_campaign", "shipped_scenarios", "shot_spectra",
        "simulate", "simulate_imu",
    ]  # fmt: skip
    assert {name for name in dir(lidar_emu) if not name.startswith("__")} == set(NAMES)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = lidar_emu.nonsense


@pytest.mark.parametrize("name", NAMES)
def test_each_is_documented_and_is_no_module(name: str) -> None:
    found = getattr(lidar_emu, name)
    assert not isinstance(found, ModuleType)
    assert inspect.getdoc(found)
    if inspect.isfunction(found):
        signature = inspect.signature(found)
        assert all(each.annotation is not inspect.Parameter.empty for each in signature.parameters.values())
        assert signature.return_annotation is not inspect.Signature.empty
        if signature.parameters:
            assert "Raises:" in (found.__doc__ or "")


@pytest.mark.parametrize("name", NAMES)
def test_no_submodule_hides_a_name(name: str) -> None:
    """Importing `lidar_emu.x` sets the attribute x of the package."""
    from importlib.util import find_spec

    assert find_spec(f"lidar_emu.{name}") is None


def test_each_is_shown_on_the_page_but_for_types_of_results() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "python.md").read_text(encoding="utf-8")
    assert {name for name in NAMES if name not in page} <= {
        "BenchScenario", "CampaignResults", "FlightScenario", "GroundTruth", "ImuSamples", "Measurement",
        "RunError", "shipped_scenarios",
    }  # fmt: skip


def test_the_plan_is_that_of_the_command_line() -> None:
    import json

    printed = CliRunner().invoke(cli, ["plan", "descent", "--json", "--set", "site=flat"])
    rows = lidar_emu.plan_run("descent", site="flat").rows()
    assert json.loads(printed.output)["decisions"] == rows
    numbers = {"range_m", "speed_mps", "detection_probability"}
    assert {"stage", "computed", "how", "reason", "bound", *numbers} == set(rows[0])


def test_the_forecast_is_that_of_the_command_line() -> None:
    import json

    printed = CliRunner().invoke(cli, ["detection", "descent", "--json", "--altitudes", "100:5000"])
    rows = json.loads(printed.output)["rows"]
    altitude_m = [row["altitude_m"] for row in rows if row["angle_deg"] == rows[0]["angle_deg"]]
    forecast = lidar_emu.detection_by_altitude("descent", altitude_m)
    stated = np.array([row["measurement_steady"] for row in rows], dtype=float)
    np.testing.assert_allclose(forecast.measurement_steady.ravel(), stated)
    for wrong in ([-1.0], "high", [[1.0]], [], float("nan")):
        with pytest.raises(lidar_emu.InputError, match=r"altitude_m: .* positive numbers"):
            lidar_emu.detection_by_altitude("descent", wrong)


@pytest.mark.parametrize("path", [None, 1, b"flight.mcap", [], "\0"])
def test_what_is_no_path_is_refused(path: object) -> None:
    for call in (
        lambda: lidar_emu.read_recording(path),
        lambda: lidar_emu.record_geometry("descent", path),
        lambda: lidar_emu.run_campaign("dispersed_descent", path),
    ):
        with pytest.raises(lidar_emu.InputError, match="must be a path"):
            call()
