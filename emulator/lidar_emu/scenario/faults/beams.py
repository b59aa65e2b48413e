"""Faults of beams: what goes wrong with what they have measured."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_emu.scenario.faults.timing import BeamNumber, PerBeamFault, RampedFault, TimedFault
from lidar_emu.scenario.part import NonNegative, unusable

Interval = tuple[float, float]


class Dropout(PerBeamFault):
    """The echo is lost: the beam is invalid, with reason `below_threshold`."""

    kind: Literal["dropout"]
    """Chooses this fault."""


class Stuck(PerBeamFault):
    """A register is not renewed: a valid range, speed or both repeat the last valid value from before the fault. Flags,
    signal-to-noise ratio and time go on."""

    kind: Literal["stuck"]
    """Chooses this fault."""
    value: Literal["range", "closing_speed", "both"] = "both"
    """What is stuck."""


class Frozen(PerBeamFault):
    """A beam's processing hangs: everything that it reports, flags and reason too, is that of the last shot before the
    fault, under the time of the present one. Stale but valid."""

    kind: Literal["frozen"]
    """Chooses this fault."""


class Bias(RampedFault):
    """A constant error of calibration, added. A range stops at 0."""

    kind: Literal["bias"]
    """Chooses this fault."""
    range_m: float = 0.0
    """Added to the range."""
    closing_speed_mps: float = 0.0
    """Added to the closing speed."""


class Scale(RampedFault):
    """A wrong chirp slope (range) or wavelength (speed): values are multiplied."""

    kind: Literal["scale"]
    """Chooses this fault."""
    range_factor: Annotated[float, Field(gt=0)] = 1.0
    """Of the range."""
    closing_speed_factor: Annotated[float, Field(gt=0)] = 1.0
    """Of the closing speed."""


class Drift(PerBeamFault):
    """An error that grows steadily from the start of the window, as with temperature. A range stops at 0."""

    kind: Literal["drift"]
    """Chooses this fault."""
    range_mps: float = 0.0
    """Added to the range per second."""
    closing_speed_mps2: float = 0.0
    """Added to the closing speed per second."""


class Noise(RampedFault):
    """More noise than the instrument admits to: Gaussian, white from shot to shot. A range stops at 0."""

    kind: Literal["noise"]
    """Chooses this fault."""
    range_m: NonNegative = 0.0
    """Standard deviation added to the range."""
    closing_speed_mps: NonNegative = 0.0
    """Standard deviation added to the closing speed."""


class Outlier(PerBeamFault):
    """Plume, dust or a false alarm: the beam is valid, with a range and a speed drawn evenly from intervals."""

    kind: Literal["outlier"]
    """Chooses this fault."""
    range_m: tuple[NonNegative, NonNegative]
    """Least and greatest range."""
    closing_speed_mps: Interval | None = None
    """Least and greatest closing speed. Left out: as measured, and only beams that have one are hit."""

    @model_validator(mode="after")
    def _intervals_ascend(self) -> Self:
        for key, interval in (("range_m", self.range_m), ("closing_speed_mps", self.closing_speed_mps)):
            if interval is not None and interval[1] < interval[0]:
                raise unusable(key, list(interval), "least and greatest, in this order")
        return self


class WrongSign(PerBeamFault):
    """The sign of the Doppler shift is taken for the other one: the closing speed is negated, and valid."""

    kind: Literal["wrong_sign"]
    """Chooses this fault."""


class SwappedBeams(TimedFault):
    """Two receivers are crossed: each of two beams reports what the other one measured."""

    kind: Literal["swapped_beams"]
    """Chooses this fault."""
    beams: tuple[BeamNumber, BeamNumber]
    """The two."""

    @model_validator(mode="after")
    def _beams_differ(self) -> Self:
        if self.beams[0] == self.beams[1]:
            raise unusable("beams", list(self.beams), "two different beams")
        return self


class FalseValid(PerBeamFault):
    """A beam that has found nothing claims a valid measurement."""

    kind: Literal["false_valid"]
    """Chooses this fault."""
    range_m: NonNegative
    """What it then reports."""
    closing_speed_mps: float = 0.0
    """What it then reports."""


class FalseInvalid(PerBeamFault):
    """A good measurement is marked as none: the values stand there, the valid flags do not."""

    kind: Literal["false_invalid"]
    """Chooses this fault."""


BeamFault = (
    Dropout | Stuck | Frozen | Bias | Scale | Drift | Noise | Outlier | WrongSign | SwappedBeams | FalseValid
) | FalseInvalid
