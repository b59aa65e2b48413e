"""Shorten a plan that fails: leave out what the failure does not need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from simulated_runtime.plan import Plan

_NEEDED = ("level", "timing.rate_hz", "duration_s")
_SHORTEST_S = 0.1


def shorten(plan: Plan, fails: Callable[[Plan], bool]) -> Plan:
    """The plan without the happenings and settings that it fails without, and as short as it still fails.

    Args:
        fails: whether a plan fails in the same way.
    """
    plan = _without_happenings(plan, fails)
    for key in [key for key in plan.settings if key not in _NEEDED]:
        fewer = replace(plan, settings={name: text for name, text in plan.settings.items() if name != key})
        plan = fewer if fails(fewer) else plan
    while (duration_s := float(plan.settings["duration_s"]) / 2) > _SHORTEST_S:
        shorter = replace(plan, settings={**plan.settings, "duration_s": f"{duration_s:.3f}"})
        if not fails(shorter):
            break
        plan = shorter
    for calmer in (replace(plan, preempted=0.0), replace(plan, control=False), replace(plan, start=None)):
        plan = calmer if calmer != plan and fails(calmer) else plan
    return plan


def _without_happenings(plan: Plan, fails: Callable[[Plan], bool]) -> Plan:
    """Leave out halves, then quarters, down to single happenings, as long as the plan fails without them."""
    size = len(plan.happenings)
    while size:
        first = 0
        while first < len(plan.happenings):
            fewer = replace(plan, happenings=plan.happenings[:first] + plan.happenings[first + size :])
            if fails(fewer):
                plan = fewer
            else:
                first += size
        size = size // 2
    return plan
