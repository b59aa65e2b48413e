"""Faults of beams: they act on measurements."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_emu.scenario.faults.timing import BeamNumber, PerBeamFault, RampedFault, TimedFault
from lidar_emu.scenario.section import NonNegative, unusable

Interval = tuple[float, float]


class Dropout(PerBeamFault):
    """Loss of the echo: the beam is invalid, with reason `below_threshold`."""

    kind: Literal["dropout"]
    """Chooses this fault."""


class Stuck(PerBeamFault):
    """Stuck register: a valid range, speed or both repeat the last valid value before the fault. Flags,
    signal-to-noise ratio and time are current."""

    kind: Literal["stuck"]
    """Chooses this fault."""
    value: Literal["range", "closing_speed", "both"] = "both"
    """Stuck value."""


class Frozen(PerBeamFault):
    """Frozen beam: all values of the beam, including flags and reason, repeat the last shot before the fault, with
    the current time. The data are stale but valid."""

    kind: Literal["frozen"]
    """Chooses this fault."""


class Bias(RampedFault):
    """Constant calibration error, added to the measurement. A range is limited to 0 and above."""

    kind: Literal["bias"]
    """Chooses this fault."""
    range_m: float = 0.0
    """Added to the range."""
    closing_speed_mps: float = 0.0
    """Added to the closing speed."""


class Scale(RampedFault):
    """Scale error, as from a wrong chirp slope (range) or wavelength (speed)."""

    kind: Literal["scale"]
    """Chooses this fault."""
    range_factor: Annotated[float, Field(gt=0)] = 1.0
    """Factor on the range."""
    closing_speed_factor: Annotated[float, Field(gt=0)] = 1.0
    """Factor on the closing speed."""


class Drift(PerBeamFault):
    """Error that grows linearly from the start of the window, as with temperature. A range is limited to 0 and
    above."""

    kind: Literal["drift"]
    """Chooses this fault."""
    range_mps: float = 0.0
    """Rate of the range error."""
    closing_speed_mps2: float = 0.0
    """Rate of the closing speed error."""


class Noise(RampedFault):
    """Noise beyond the reported standard deviations: Gaussian, white from shot to shot. A range is limited to 0 and
    above."""

    kind: Literal["noise"]
    """Chooses this fault."""
    range_m: NonNegative = 0.0
    """Standard deviation of the added range noise."""
    closing_speed_mps: NonNegative = 0.0
    """Standard deviation of the added closing speed noise."""


class Outlier(PerBeamFault):
    """Outlier, as from plume, dust or a false alarm: the beam is valid, with range and speed drawn uniformly from
    intervals."""

    kind: Literal["outlier"]
    """Chooses this fault."""
    range_m: tuple[NonNegative, NonNegative]
    """Minimum and maximum range."""
    closing_speed_mps: Interval | None = None
    """Minimum and maximum closing speed. Left out: the speed is as measured, and only beams with a valid speed are
    affected."""

    @model_validator(mode="after")
    def _intervals_ascend(self) -> Self:
        for key, interval in (("range_m", self.range_m), ("closing_speed_mps", self.closing_speed_mps)):
            if interval is not None and interval[1] < interval[0]:
                raise unusable(key, list(interval), "minimum and maximum, in this order")
        return self


class WrongSign(PerBeamFault):
    """Doppler sign error: the closing speed is negated, and valid."""

    kind: Literal["wrong_sign"]
    """Chooses this fault."""


class SwappedBeams(TimedFault):
    """Swapped receivers: each of two beams reports the measurement of the other."""

    kind: Literal["swapped_beams"]
    """Chooses this fault."""
    beams: tuple[BeamNumber, BeamNumber]
    """Numbers of the two beams."""

    @model_validator(mode="after")
    def _beams_differ(self) -> Self:
        if self.beams[0] == self.beams[1]:
            raise unusable("beams", list(self.beams), "two different beams")
        return self


class FalseValid(PerBeamFault):
    """Invalid measurement marked valid: a beam without a detection reports fixed values."""

    kind: Literal["false_valid"]
    """Chooses this fault."""
    range_m: NonNegative
    """Reported range."""
    closing_speed_mps: float = 0.0
    """Reported closing speed."""


class FalseInvalid(PerBeamFault):
    """Valid measurement marked invalid: the values are reported, with the valid flags cleared."""

    kind: Literal["false_invalid"]
    """Chooses this fault."""


BeamFault = (
    Dropout | Stuck | Frozen | Bias | Scale | Drift | Noise | Outlier | WrongSign | SwappedBeams | FalseValid
) | FalseInvalid
