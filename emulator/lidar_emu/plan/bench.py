"""The plan of a bench pattern."""

from __future__ import annotations

from lidar_emu.plan.faults import planned_faults
from lidar_emu.plan.plan import Decision, Plan
from lidar_emu.scenario.schema import BenchScenario


def plan_bench(scenario: BenchScenario) -> Plan:
    """Build the plan of a bench pattern, which needs neither flight nor receiver."""
    beams = len(scenario.bench_pattern.beams)
    return Plan(
        (
            Decision("pattern", True, f"{beams} beams", "the scenario gives bench_pattern", "exact"),
            Decision("flight, ground, receiver", False, "-", "a pattern needs none of them", "exact"),
            *planned_faults(scenario),
        )
    )
