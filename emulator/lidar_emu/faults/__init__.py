"""Injected faults and their effects on light, receiver, measurements and packets, imported only where there are any."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from lidar_emu.errors import Finding, InputError
from lidar_emu.scenario.faults import BeamFault, LightFault, ReceiverFault
from lidar_emu.scenario.schema import BenchScenario, FlightScenario, Scenario

if TYPE_CHECKING:
    from lidar_emu.beams.flight import Flight
    from lidar_emu.faults.beams import BeamFaults
    from lidar_emu.faults.physics import PhysicsFaults
    from lidar_emu.receiver.build_level import Level


_PHYSICS = LightFault | ReceiverFault


def indexed_faults(scenario: Scenario, kinds: Any) -> list[tuple[int, Any]]:
    """Faults of a union of kinds, each with its index in the scenario's list."""
    return [(index, fault) for index, fault in enumerate(scenario.faults) if type(fault) in get_args(kinds)]


def beam_faults(scenario: Scenario, beam_count: int) -> BeamFaults | None:
    """Faults that act on measurements; None if the scenario has none.

    Raises:
        InputError: a fault names a beam that does not exist.
    """
    found = indexed_faults(scenario, BeamFault)
    if not found:
        return None
    from lidar_emu.faults.beams import BeamFaults

    require_beams(scenario, found, beam_count)
    return BeamFaults(found, scenario.seed, scenario.timing.period_ns, beam_count)


def physics_faults(scenario: FlightScenario, flight: Flight, level: Level) -> PhysicsFaults | None:
    """Faults of light and receiver; None if the scenario has none.

    Raises:
        InputError: a fault does not apply to this level or this ground, or names a beam that does not exist.
    """
    found = indexed_faults(scenario, _PHYSICS)
    if not found:
        return None
    from lidar_emu.faults.physics import PhysicsFaults

    require_beams(scenario, found, flight.scanner.beam_count)
    return PhysicsFaults(found, scenario, flight, level)


def refuse_physics(scenario: BenchScenario) -> None:
    """Refuse faults of light and receiver in a bench pattern, which has neither.

    Raises:
        InputError: the scenario has such a fault.
    """
    for index, fault in indexed_faults(scenario, _PHYSICS):
        found = Finding(f"{fault.kind} on a bench pattern")
        raise InputError(scenario.name, f"faults.{index}.kind", found, "use a scenario with a flight")


def require_beams(scenario: Scenario, found: list[tuple[int, Any]], beam_count: int) -> None:
    """Refuse faults that name a beam that does not exist.

    Raises:
        InputError: a fault does.
    """
    for index, fault in found:
        beams = getattr(fault, "beams", None) or ()
        if any(beam >= beam_count for beam in beams):
            remedy = f"must be beams of the scenario, 0 to {beam_count - 1}"
            raise InputError(scenario.name, f"faults.{index}.beams", list(beams), remedy)
