"""Timing and beams of faults: the keys that all kinds share."""

from __future__ import annotations

from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from lidar_emu.scenario.section import Fraction, NonNegative, Part, unusable

BeamNumber = Annotated[int, Field(ge=0, le=63)]


class TimedFault(Part):
    """A fault that acts on shots that begin within a fault window: on all of them, or at random."""

    at_s: NonNegative | None = None
    """Act only on the first shot that begins at this scenario time or later, instead of in a window."""
    from_s: NonNegative = 0.0
    """Start of the fault window, scenario time."""
    to_s: Annotated[float, Field(gt=0)] | None = None
    """End of the fault window, exclusive, scenario time. Left out: the end of the run."""
    probability: Fraction = 1.0
    """Probability of onset at each shot in the window, and for each beam if the fault has `beams`."""
    lasts_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Duration after a random onset; 0: one shot. The fault ends with the window."""

    @model_validator(mode="after")
    def _when_is_clear(self) -> Self:
        window = self.from_s != 0 or self.to_s is not None
        if self.at_s is not None and window:
            raise unusable("at_s", self.at_s, "either at_s, or from_s and to_s")
        if self.to_s is not None and self.to_s <= self.from_s:
            raise unusable("to_s", self.to_s, f"more than from_s, {self.from_s:g}")
        if self.lasts_s > 0 and (self.probability == 1 or self.at_s is not None):
            raise unusable("lasts_s", self.lasts_s, "only with a probability below 1, and without at_s")
        return self


class PerBeamFault(TimedFault):
    """A fault that acts on beams; onsets are random for each beam."""

    beams: Annotated[list[BeamNumber], Field(min_length=1)] | None = None
    """Numbers of the affected beams, from 0. Left out: all."""


class RampedFault(PerBeamFault):
    """A fault of beams whose magnitude can grow."""

    ramp_s: NonNegative = 0.0
    """Time from the start of the window in which the magnitude grows linearly from zero to full; 0: full at once."""


class FaultWindow(Part):
    """A fault that acts throughout a fault window."""

    from_s: NonNegative = 0.0
    """Start of the fault window, scenario time."""
    to_s: Annotated[float, Field(gt=0)] | None = None
    """End of the fault window. Left out: the end of the run."""

    at_s: ClassVar[None] = None
    probability: ClassVar[float] = 1.0
    lasts_s: ClassVar[float] = 0.0

    @model_validator(mode="after")
    def _window_is_one(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise unusable("to_s", self.to_s, f"more than from_s, {self.from_s:g}")
        return self
