"""The plan of a run: the stages computed and left out, each with its reason and error bound."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Decision:
    """One stage of the model, computed or left out."""

    stage: str
    computed: bool
    how: str
    reason: str
    bound: str
    """The largest effect of the decision; `exact` where there is none."""

    def row(self) -> dict[str, str | bool]:
        """Convert to JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class Plan:
    """The decisions of a run, and the number of beamlets that the model uses."""

    decisions: tuple[Decision, ...]
    beamlets: int = 1

    def rows(self) -> list[dict[str, str | bool]]:
        """Convert the decisions to JSON values."""
        return [decision.row() for decision in self.decisions]
