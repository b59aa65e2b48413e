"""The decisions of a run: what it computes and what it leaves out, each with its reason and the bound on its cost."""

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
        """For JSON."""
        return asdict(self)


@dataclass(frozen=True)
class Plan:
    """The decisions of a run, and the one figure that the model takes from them."""

    decisions: tuple[Decision, ...]
    beamlets: int = 1

    def rows(self) -> list[dict[str, str | bool]]:
        """The decisions for JSON."""
        return [decision.row() for decision in self.decisions]
