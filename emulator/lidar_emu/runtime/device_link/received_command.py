"""A command as the device has heard it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class ReceivedCommand(NamedTuple):
    """A command, good or bad, and what the device answered."""

    time_ns: int
    """Scenario time; before the flight, from power-up."""
    command: str | int | None
    """Its name; the code of one that cannot be read; None where that is missing, too."""
    values: Mapping[str, int | float | str | None]
    """Its arguments."""
    sequence: int | None
    verdict: str
    tone_ns: int | None = None
    """Scenario time of the last pulse before it; None: there was none, or the port has no pulse line."""
