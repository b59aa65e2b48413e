"""What a run leaves behind besides what it sent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lidar_emu.runtime.summary import Tally


@dataclass
class Outcome:
    """What is known at the end of a run."""

    tally: Tally
    details: dict[str, Any]
    error: str | None
    """Why the run ended early, if that is an error."""

    def to_json(self) -> dict[str, Any]:
        """The summary file."""
        return {**self.details, **self.tally.to_json()}
