"""A command as the device has received it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class ReceivedCommand(NamedTuple):
    """A command, valid or not, and its verdict."""

    time_ns: int
    """Scenario time; before the flight, time from power-up."""
    command: str | int | None
    """Its name; the code of an unreadable command; None if that is missing, too."""
    values: Mapping[str, int | float | str | None]
    """Its arguments."""
    sequence: int | None
    """Its sequence number."""
    verdict: str
    tone_ns: int | None = None
    """Scenario time of the last pulse before it; None: there was none, or the port has no pulse line."""
