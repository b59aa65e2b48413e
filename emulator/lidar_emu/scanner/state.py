"""The state of beam pattern selection, carried from shot to shot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ScannerState:
    """State of the pattern selection that passes from shot to shot."""

    active: tuple[bool, ...]
    """Whether each switch is active."""
    commanded: int | None = None
    """Pattern chosen by a command, which overrides the switches."""
