"""Faults injected in flight."""

from __future__ import annotations

import json

from pydantic import BaseModel, ValidationError

from lidar_emu.errors import InputError
from lidar_emu.scenario.explain import Source, explained
from lidar_emu.scenario.faults import Fault, LinkFault, ScheduledFault
from lidar_emu.scenario.yaml_text import parse

_WHERE = "fault"
_Fault = ScheduledFault | LinkFault


class _Injection(BaseModel):
    fault: Fault
    """The fault; its times count from the first shot that it can affect."""


def read_fault(text: str) -> _Fault:
    """Read a fault injected in flight from a YAML mapping, as in a scenario.

    `lasts_s` without `probability` is the duration of the fault.

    Raises:
        InputError: names the key, what it must be, and the value.
    """
    tree = parse(text, _WHERE)
    if not isinstance(tree, dict):
        raise InputError(
            _WHERE, None, tree, "must be a mapping such as {kind: dropout, beams: [2], lasts_s: 2}"
        )
    if "lasts_s" in tree and not tree.keys() & {"probability", "at_s", "to_s"}:
        lasts_s, from_s = tree.pop("lasts_s"), tree.get("from_s", 0)
        whole = isinstance(lasts_s, int | float) and isinstance(from_s, int | float)
        if whole and not lasts_s > 0:
            raise InputError(_WHERE, "lasts_s", lasts_s, "must be greater than 0")
        tree["to_s"] = from_s + lasts_s if whole else lasts_s
    try:
        injection = _Injection.model_validate_json(json.dumps({"fault": tree}))
    except ValidationError as error:
        raise explained(error, _Injection, {"fault": tree}, {(): Source(_WHERE, 1)}) from None
    return injection.fault


def shifted(fault: _Fault, by_s: float) -> _Fault:
    """Fault with all of its times shifted to later ones by `by_s`."""
    times_s = {
        name: getattr(fault, name) for name in ("at_s", "from_s", "to_s") if name in type(fault).model_fields
    }
    if times_s.get("at_s") is not None:
        del times_s["from_s"]
    later_s: dict[str, float] = {
        name: time_s + by_s for name, time_s in times_s.items() if time_s is not None
    }
    return fault.model_copy(update=later_s)
