"""Reasons why a beam has no valid measurement."""

from __future__ import annotations

from enum import IntEnum


class Reason(IntEnum):
    """Reason why a beam has no valid range and speed; the codes are sent over the wire."""

    VALID = 0
    NOT_FIRED = 1
    NO_SURFACE = 2
    """No beamlet meets anything."""
    BELOW_THRESHOLD = 3
    """The echo was not detected in all three segments."""
    BEYOND_RANGE = 4
    """The measured range, or the surface itself, lies beyond what the instrument may report."""
    INSIDE_GROUND = 5
    """The sensor touches the ground or is below it."""
    AMBIGUOUS = 6
    """No choice of signs and folds gives a range from 0 to what the instrument can have measured."""
