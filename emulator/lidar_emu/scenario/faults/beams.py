"""Faults of beams: they act on measurements."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from lidar_emu.scenario.section import Fraction, NonNegative, Part, Positive, unusable

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

    def _check(self) -> None:
        window = self.from_s != 0 or self.to_s is not None
        if self.at_s is not None and window:
            raise unusable("at_s", self.at_s, "left out beside from_s and to_s")
        if self.to_s is not None and self.to_s <= self.from_s:
            raise unusable("to_s", self.to_s, f"more than from_s, {self.from_s:g}")
        if self.lasts_s > 0 and (self.probability == 1 or self.at_s is not None):
            raise unusable("lasts_s", self.lasts_s, "left out beside at_s, and with a probability of 1")


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

    def _check(self) -> None:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise unusable("to_s", self.to_s, f"more than from_s, {self.from_s:g}")


Interval = tuple[float, float]


class Dropout(PerBeamFault):
    """Loss of the echo: the beam is invalid, with reason `below_threshold`."""

    kind: Literal["dropout"]


class Stuck(PerBeamFault):
    """Stuck register: a valid range, speed or both repeat the last valid value before the fault. Flags,
    signal-to-noise ratio and time are current."""

    kind: Literal["stuck"]
    value: Literal["range", "closing_speed", "both"] = "both"
    """Stuck value."""


class Frozen(PerBeamFault):
    """Frozen beam: all values of the beam, including flags and reason, repeat the last shot before the fault, with
    the current time. The data are stale but valid."""

    kind: Literal["frozen"]


class Bias(RampedFault):
    """Constant calibration error, added to the measurement. A range is limited to 0 and above."""

    kind: Literal["bias"]
    range_m: float = 0.0
    """Added to the range."""
    closing_speed_mps: float = 0.0
    """Added to the closing speed."""


class Scale(RampedFault):
    """Scale error, as from a wrong chirp slope (range) or wavelength (speed)."""

    kind: Literal["scale"]
    range_factor: Annotated[float, Field(gt=0)] = 1.0
    """Factor on the range."""
    closing_speed_factor: Annotated[float, Field(gt=0)] = 1.0
    """Factor on the closing speed."""


class Drift(PerBeamFault):
    """Error that grows linearly from the start of the window, as with temperature. A range is limited to 0 and
    above."""

    kind: Literal["drift"]
    range_mps: float = 0.0
    """Rate of the range error."""
    closing_speed_mps2: float = 0.0
    """Rate of the closing speed error."""


class Noise(RampedFault):
    """Noise beyond the reported standard deviations: Gaussian, white from shot to shot. A range is limited to 0 and
    above."""

    kind: Literal["noise"]
    range_m: NonNegative = 0.0
    """Standard deviation of the added range noise."""
    closing_speed_mps: NonNegative = 0.0
    """Standard deviation of the added closing speed noise."""


class Outlier(PerBeamFault):
    """Outlier, as from plume, dust or a false alarm: the beam is valid, with range and speed drawn uniformly from
    intervals."""

    kind: Literal["outlier"]
    range_m: tuple[NonNegative, NonNegative]
    """Minimum and maximum range."""
    closing_speed_mps: Interval | None = None
    """Minimum and maximum closing speed. Left out: the speed is as measured, and only beams with a valid speed are
    affected."""

    def _check(self) -> None:
        super()._check()
        for key, interval in (("range_m", self.range_m), ("closing_speed_mps", self.closing_speed_mps)):
            if interval is not None and interval[1] < interval[0]:
                raise unusable(key, list(interval), "minimum and maximum, in this order")


class WrongSign(PerBeamFault):
    """Doppler sign error: the closing speed is negated, and valid."""

    kind: Literal["wrong_sign"]


class SwappedBeams(TimedFault):
    """Swapped receivers: each of two beams reports the measurement of the other."""

    kind: Literal["swapped_beams"]
    beams: tuple[BeamNumber, BeamNumber]
    """Numbers of the two beams."""

    def _check(self) -> None:
        super()._check()
        if self.beams[0] == self.beams[1]:
            raise unusable("beams", list(self.beams), "two different beams")


class FalseValid(PerBeamFault):
    """Invalid measurement marked valid: a beam without a detection reports fixed values."""

    kind: Literal["false_valid"]
    range_m: NonNegative
    """Reported range."""
    closing_speed_mps: float = 0.0
    """Reported closing speed."""


class FalseInvalid(PerBeamFault):
    """Valid measurement marked invalid: the values are reported, with the valid flags cleared."""

    kind: Literal["false_invalid"]


BeamFault = (
    Dropout | Stuck | Frozen | Bias | Scale | Drift | Noise | Outlier | WrongSign | SwappedBeams | FalseValid
) | FalseInvalid


class LaserFade(RampedFault):
    """Loss of transmitted power: an ageing laser, a bent fibre, dust on the window. The local oscillator is not
    affected, so the signal-to-noise ratio falls by the same amount."""

    kind: Literal["laser_fade"]
    loss_db: NonNegative
    """Loss of transmitted power. With `ramp_s` the loss in decibels grows linearly."""


class Misalignment(RampedFault):
    """Misaligned beam, as from a loose or thermally bent mount. The published direction is unchanged; ground truth is
    along the true axis."""

    kind: Literal["misalignment"]
    tilt_mrad: tuple[Annotated[float, Field(ge=-500, le=500)], Annotated[float, Field(ge=-500, le=500)]]
    """Rotation of the true direction, as small angles about sensor x and y."""


class ReflectancePatch(TimedFault):
    """Disc of ground with another reflectance: bright rock, shadowed dust, a retroreflector, a metal sheet."""

    kind: Literal["reflectance_patch"]
    centre_m: tuple[float, float]
    """East and north coordinates of the centre, from the site's origin."""
    radius_m: Positive
    """Horizontal radius."""
    reflectance: NonNegative
    """Reflectance of the disc. Values above 1 stand for retroreflection."""


class Clutter(PerBeamFault):
    """Part of the vehicle in the beam: it returns an echo from a short range at zero speed, and its share of the
    power does not reach the ground. The received powers decide which echo is reported. Level `spectral`."""

    kind: Literal["clutter"]
    range_m: Annotated[float, Field(gt=0, le=1000)]
    """Range of the part."""
    reflectance: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Reflectance of the part, whose surface faces the sensor."""
    share: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Fraction of the beam's power on the part."""


class MissingSegment(PerBeamFault):
    """Missing segment of the waveform: a chirp that was not driven, a record that was overwritten. The instrument's
    rule (`detection.rule`) decides what the other segments yield. Level `spectral`."""

    kind: Literal["missing_segment"]
    segments: Annotated[list[Literal["up", "constant", "down"]], Field(min_length=1, max_length=3)]
    """Missing segments."""


class WrongBranch(PerBeamFault):
    """Doppler sign ambiguity of a homodyne receiver, resolved to the wrong sign: range and closing speed are both
    wrong, consistent with the two beat frequencies they are computed from, and reported as valid. Level `spectral`."""

    kind: Literal["wrong_branch"]


class Alias(PerBeamFault):
    """Undersampling: the digitiser takes only every Nth sample without an anti-aliasing filter. Beat frequencies
    beyond the lower Nyquist frequency are folded below it, and so is the noise. Level `spectral`."""

    kind: Literal["alias"]
    decimation: Annotated[int, Field(ge=2, le=64)]
    """N. The receiver is not aware of the decimation."""


class FalseAlarms(PerBeamFault):
    """Raised receiver noise with an unchanged threshold, as from stray light or a disturbed supply: noise peaks are
    detected as false alarms at the rate of the noise model, and echoes are lost in noise. Level `spectral`."""

    kind: Literal["false_alarms"]
    noise_db: Annotated[float, Field(gt=0, le=30)]
    """Increase of the noise power."""


LightFault = LaserFade | Misalignment | ReflectancePatch | Clutter
ReceiverFault = MissingSegment | WrongBranch | Alias | FalseAlarms
