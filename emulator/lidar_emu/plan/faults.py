"""The faults of a scenario, as lines of a plan."""

from __future__ import annotations

from lidar_emu.plan.plan import Decision
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.schema import Scenario

_WHEN = frozenset({"kind", "at_s", "from_s", "to_s", "probability", "lasts_s"})


def planned_faults(scenario: Scenario) -> list[Decision]:
    """One line per fault, in the scenario's order."""
    return [
        Decision(f"fault {number}", True, _how(fault), f"the scenario injects it {_when(fault)}", "as stated")
        for number, fault in enumerate(scenario.faults)
    ]


def _how(fault: Fault) -> str:
    stated = fault.model_dump(exclude=set(_WHEN), exclude_defaults=True)
    return ", ".join([fault.kind, *(f"{key} {_shown(value)}" for key, value in stated.items())])


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return ", ".join(map(_shown, value)) if isinstance(value, list | tuple) else str(value)


def _when(fault: Fault) -> str:
    if fault.at_s is not None:
        when = f"at {fault.at_s:g} s"
    else:
        when = f"from {fault.from_s:g} s to " + ("the end" if fault.to_s is None else f"{fault.to_s:g} s")
    if fault.probability == 1:
        return when
    lasts = f", for {fault.lasts_s:g} s each" if fault.lasts_s else ""
    return f"{when}, probability {fault.probability:g} per shot{lasts}"
