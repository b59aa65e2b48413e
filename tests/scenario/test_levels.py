"""What the level `waveform` cannot measure is refused in one line."""

from __future__ import annotations

import pytest

from lidar_emu.errors import InputError
from lidar_emu.scenario.load import load
from lidar_emu.scenario.schema import FlightScenario

WAVEFORM = {"level": "waveform", "instrument.detection.peak": "hann"}


def test_level_waveform_is_usable() -> None:
    scenario = load("descent", WAVEFORM)
    assert isinstance(scenario, FlightScenario)
    assert scenario.level == "waveform"


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("detection.looks", "2"),
        ("detection.rule", "any_two"),
        ("detection.peak", "parabola"),
    ],
)
def test_others_are_refused(key: str, value: str) -> None:
    overrides = WAVEFORM | {
        "instrument.detection.combine": "least_squares",
        "timing.rate_hz": "10",
        f"instrument.{key}": value,
    }
    assert load("descent", overrides | {"level": "spectral"})
    with pytest.raises(InputError) as refused:
        load("descent", overrides)
    line = str(refused.value)
    assert key in line
    assert value in line
    assert "at level waveform" in line
    assert "\n" not in line
