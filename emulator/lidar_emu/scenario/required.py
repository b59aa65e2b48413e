"""Requirements of commands on a scenario."""

from __future__ import annotations

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.schema import BenchScenario, FlightScenario


def require_flight(scenario: FlightScenario | BenchScenario) -> FlightScenario:
    """The scenario, if it is a flight.

    Raises:
        InputError: it is a bench pattern.
    """
    if isinstance(scenario, BenchScenario):
        found = Finding("a bench pattern has no geometry")
        raise InputError(scenario.name, None, found, "use a scenario with a flight")
    return scenario


def require_known_flight(scenario: FlightScenario | BenchScenario) -> None:
    """Refuse live truth, for commands that cannot wait for a simulator.

    Raises:
        InputError: the trajectory is live.
    """
    if scenario.live is not None:
        remedy = "must be profile, table or powered_descent; live truth is flown by lidar-emu run"
        raise InputError(scenario.name, "trajectory.kind", "live", remedy)
