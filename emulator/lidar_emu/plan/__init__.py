"""Plan of a run: stages computed and left out, with error bounds; expected errors and detection forecast."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, isfinite, log10
from typing import NamedTuple

from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.schema import Scenario

_LEAST_ROUNDED = 1e-300
"""Value from which a hundredth of it is a number, too."""


def at_most(value: float) -> str:
    """Write a bound with two digits, rounded up."""
    if not (isfinite(value) and value > _LEAST_ROUNDED):
        return f"{value:g}"
    unit = 10.0 ** (floor(log10(value)) - 1)
    return f"{ceil(value / unit) * unit:.2g}"


class LeftOut(NamedTuple):
    """Largest error of a beam's measurement by what a decision leaves out, before frequencies are rounded to bins: a
    bias, or a standard deviation at the beam's mean power where the effect scatters."""

    range_m: float = 0.0
    speed_mps: float = 0.0
    detection_probability: float = 0.0
    """Change of the probability of a valid measurement."""

    def __str__(self) -> str:
        detected = self.detection_probability
        share = f", {at_most(detected)} of P_d" if detected > 0.0 else ""
        return f"{at_most(self.range_m)} m, {at_most(self.speed_mps)} m/s{share}"


@dataclass(frozen=True)
class Decision:
    """One stage of the model, computed or left out."""

    stage: str
    computed: bool
    how: str
    reason: str
    bound: str
    """The largest effect of the decision; `exact` where there is none."""
    left_out: LeftOut | None = None
    """What the decision leaves out, in numbers; None: nothing, or as much as the bound says."""

    @property
    def limits(self) -> str:
        """The bound, and its numbers where it does not state them."""
        stated = self.left_out is None or not any(self.left_out) or str(self.left_out) in self.bound
        return self.bound if stated else f"{self.bound}: {self.left_out}"

    def row(self) -> dict[str, str | bool | float | None]:
        """Convert to JSON values; None where a limit is not known as a number."""
        values: dict[str, str | bool | float | None] = {
            name: getattr(self, name) for name in ("stage", "computed", "how", "reason", "bound")
        }
        effect = LeftOut() if self.bound.startswith("exact") else self.left_out
        return values | (dict.fromkeys(LeftOut._fields) if effect is None else effect._asdict())


def plan_walk(beside: list[str], has_faults: bool) -> Decision:
    """How a single shot is computed.

    Args:
        beside: what of a shot is not in recorded calls.
        has_faults: whether there are faults of light or receiver.
    """
    stage, bound = "a shot alone", "exact, bit for bit"
    if beside:
        return Decision(stage, True, "as a block of one", f"a shot has {', '.join(beside)}", bound)
    reason = "except where a fault may act" if has_faults else "all its effects are in them"
    return Decision(stage, True, "recorded calls", reason, bound)


@dataclass(frozen=True)
class Plan:
    """Decisions of a run: their description, and the values that the model follows."""

    decisions: tuple[Decision, ...]
    beamlets: int = 1
    """Beamlets per beam."""
    follows_chirps: bool = False
    """Whether beams are pointed at the times of the chirps' records, to follow the curvature of their motion."""
    receiving_lag: bool = True
    """Whether echoes are dimmed by the rotation of the beam while the light travels."""
    leakage: bool = True
    """Whether beams receive the echoes of others, if the instrument has leakage."""

    def rows(self) -> list[dict[str, str | bool | float | None]]:
        """Convert the decisions to JSON values."""
        return [decision.row() for decision in self.decisions]


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
