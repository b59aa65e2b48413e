"""Reasons why a beam has no valid measurement, and sources of peaks that are not the surface's."""

from __future__ import annotations

from enum import IntEnum


class Reason(IntEnum):
    """Reason why a beam has no valid range and speed; the codes are sent over the wire."""

    VALID = 0
    NOT_FIRED = 1
    NO_SURFACE = 2
    """No beamlet hits a surface."""
    BELOW_THRESHOLD = 3
    """The echo was not detected in all three segments."""
    BEYOND_RANGE = 4
    """The measured range, or the surface itself, is beyond the instrument's maximum range."""
    INSIDE_GROUND = 5
    """The sensor touches the ground or is below it, at some time of the measurement."""
    AMBIGUOUS = 6
    """No choice of signs and folds gives a range that the instrument can measure, or the three frequencies do not
    belong to one surface (`lidar_emu.fmcw.residual_limit`)."""


class FalseTarget(IntEnum):
    """Source of a peak that is not the surface's."""

    NONE = 0
    BACK_REFLECTION = 1
    """Light that window and optics reflect."""
    SIDE_LINE = 2
    """Side line of the surface's line by a periodic non-linearity of the chirps."""
    LEAKAGE = 3
    """Echo of another beam."""
    HAZE = 4
    """Backscatter of the atmosphere."""
    DUST = 5
    """Dust of the plume."""
