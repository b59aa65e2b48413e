"""Small flights over simple ground."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from lidar_emu.scenario.schema import FlightScenario

FlightMaker = Callable[..., FlightScenario]


@pytest.fixture
def make_flight() -> FlightMaker:
    """Build a scenario: keyword arguments replace whole parts."""

    def make(**parts: Any) -> FlightScenario:
        tree: dict[str, Any] = {
            "name": "test",
            "instrument": {
                "optics": {"speckle": False},
                "detection": {"peak": "hann", "combine": "least_squares"},
            },
            "site": {"ground": {"kind": "plane"}},
            "scanner": {"pattern": {"kind": "square", "angle_deg": 22.5}},
            "trajectory": {
                "kind": "profile",
                "waypoints": [{"altitude_m": 1000, "speed_mps": 60}, {"altitude_m": 100, "speed_mps": 20}],
            },
        }
        return FlightScenario.model_validate_json(json.dumps({**tree, **parts}))

    return make
