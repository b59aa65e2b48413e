"""The faults that a scenario orders; what they need is imported where there are some."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.faults import BeamFault, LightFault, ReceiverFault
from lidar_emu.scenario.schema import BenchScenario, FlightScenario, Scenario

if TYPE_CHECKING:
    from lidar_emu.faults.beams import BeamFaults
    from lidar_emu.faults.physics import PhysicsFaults
    from lidar_emu.flight.flight import Flight
    from lidar_emu.fmcw.levels import Level

_PHYSICS = LightFault | ReceiverFault


def numbered(scenario: Scenario, kinds: Any) -> list[tuple[int, Any]]:
    """The faults of a union of kinds, with their places in the scenario's list."""
    return [(number, fault) for number, fault in enumerate(scenario.faults) if type(fault) in get_args(kinds)]


def beam_faults(scenario: Scenario, beam_count: int) -> BeamFaults | None:
    """None where the scenario orders none.

    Raises:
        InputError: a fault is of a beam that there is not.
    """
    found = numbered(scenario, BeamFault)
    if not found:
        return None
    from lidar_emu.faults.beams import BeamFaults

    require_beams(scenario, found, beam_count)
    return BeamFaults(found, scenario.seed, scenario.timing.period_ns, beam_count)


def physics_faults(scenario: FlightScenario, flight: Flight, level: Level) -> PhysicsFaults | None:
    """None where the scenario orders none.

    Raises:
        InputError: a fault is none of this level, of this ground, or of a beam that there is not.
    """
    found = numbered(scenario, _PHYSICS)
    if not found:
        return None
    from lidar_emu.faults.physics import PhysicsFaults

    require_beams(scenario, found, flight.scanner.beam_count)
    return PhysicsFaults(found, scenario, flight, level)


def refuse_physics(scenario: BenchScenario) -> None:
    """A bench pattern has neither light nor receiver.

    Raises:
        InputError: the scenario orders a fault of theirs.
    """
    for number, fault in numbered(scenario, _PHYSICS):
        found = Finding(f"{fault.kind} on a bench pattern")
        allowed = "allowed: in a scenario with a flight"
        raise InputError(scenario.name, f"faults.{number}.kind", found, allowed)


def require_beams(scenario: Scenario, found: list[tuple[int, Any]], beam_count: int) -> None:
    """Refuse faults of beams that there are not.

    Raises:
        InputError: there is one.
    """
    for number, fault in found:
        beams = getattr(fault, "beams", None) or ()
        if any(beam >= beam_count for beam in beams):
            allowed = f"allowed: 0 to {beam_count - 1}, the scenario's beams"
            raise InputError(scenario.name, f"faults.{number}.beams", list(beams), allowed)
