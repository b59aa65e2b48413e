"""The faults of beams that a scenario orders; what they need is imported where there are some."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from lidar_emu.scenario.faults import BeamFault
from lidar_emu.scenario.schema import Scenario

if TYPE_CHECKING:
    from lidar_emu.faults.measured import BeamFaults


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
    from lidar_emu.faults.measured import BeamFaults

    return BeamFaults(found, scenario.seed, scenario.timing.period_ns, beam_count, scenario.name)
