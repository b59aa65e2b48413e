"""The shipped powered descent, from its scenario to its measurements and its plan."""

from __future__ import annotations

import numpy as np

import lidar_emu
from lidar_emu.beams.flight import Flight
from lidar_emu.plan.flight import plan_flight
from lidar_emu.scenario.schema import FlightScenario


def scenario(**settings: str) -> FlightScenario:
    loaded = lidar_emu.load("powered_descent.yaml", settings)
    assert isinstance(loaded, FlightScenario)
    return loaded


def test_plan_reports_cut_off_touchdown_and_ground() -> None:
    flown = scenario(**{"trajectory.guidance": "{kind: gravity_turn}"})
    flight = Flight(flown)
    reported = next(d for d in plan_flight(flown, flight).decisions if d.stage == "trajectory")
    assert "cut-off at 75.4" in reported.reason
    assert "with 1.94 m/s" in reported.reason
    end = flight.trajectory.state(np.array([flight.trajectory.duration_s])).position_site_m[0]
    apart_m = flight.scene.height_m(end[:1], end[1:2])[0]
    assert abs(apart_m) > 0.02
    assert f"{apart_m:+.2f} m off" in reported.bound
