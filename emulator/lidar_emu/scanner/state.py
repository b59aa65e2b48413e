"""Which pattern of beams a scanner uses, carried from shot to shot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ScannerState:
    """State that passes from shot to shot."""

    active: tuple[bool, ...]
    """One per switch."""
    commanded: int | None = None
    """The set that a command has chosen, instead of the switches."""
