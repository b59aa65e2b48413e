"""The plan of a run, and the forecast of what an instrument detects, from a scenario however it is stated."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lidar_emu.errors import InputError
from lidar_emu.plan.detection_forecast import DetectionForecast, forecast_detection
from lidar_emu.plan.plan import Plan
from lidar_emu.scenario.load import load
from lidar_emu.scenario.required import require_flight
from lidar_emu.scenario.schema import Scenario
from lidar_emu.shots.model import build_model


def plan_run(
    scenario: str | PathLike[str] | Mapping[str, Any] | Scenario,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> Plan:
    """Plan a run: the stages that it computes and leaves out, each with its reason and a bound of the error.

    Args:
        scenario: see `load`.
        overrides: see `load`.
        keys: see `load`.

    Raises:
        InputError: see `load`; or a file named by the scenario cannot be used, or the flight leaves the ground.
    """
    return build_model(load(scenario, overrides, **keys)).plan


def detection_by_altitude(
    scenario: str | PathLike[str] | Mapping[str, Any] | Scenario,
    altitude_m: ArrayLike,
    overrides: Mapping[str, Any] | None = None,
    **keys: Any,
) -> DetectionForecast:
    """Forecast the detection by an instrument that hovers upright over a level plane of its site's surface.

    Args:
        scenario: see `load`.
        overrides: see `load`.
        keys: see `load`.
        altitude_m: (altitudes,) heights of the sensor above the plane.

    Raises:
        InputError: see `load`; or an altitude is no positive number, or the scenario is a bench pattern.
    """
    flown = require_flight(load(scenario, overrides, **keys))
    try:
        altitudes = np.atleast_1d(np.asarray(altitude_m, dtype=np.float64))
    except (TypeError, ValueError):
        altitudes = np.array([np.nan])
    if altitudes.ndim != 1 or not np.all((altitudes > 0.0) & np.isfinite(altitudes)):
        allowed = "must be positive numbers, (altitudes,)"
        raise InputError("detection_by_altitude", "altitude_m", altitude_m, allowed)
    return forecast_detection(flown, altitudes)
