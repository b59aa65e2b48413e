"""Faults of light and receiver: they act in the model, which computes their effects on measurements."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.faults.timing import PerBeamFault, RampedFault, TimedFault
from lidar_emu.scenario.section import NonNegative, Positive


class LaserFade(RampedFault):
    """Loss of transmitted power: an ageing laser, a bent fibre, dust on the window. The local oscillator is not
    affected, so the signal-to-noise ratio falls by the same amount."""

    kind: Literal["laser_fade"]
    """Chooses this fault."""
    loss_db: NonNegative
    """Loss of transmitted power. With `ramp_s` the loss in decibels grows linearly."""


class Misalignment(RampedFault):
    """Misaligned beam, as from a loose or thermally bent mount. The published direction is unchanged; ground truth is
    along the true axis."""

    kind: Literal["misalignment"]
    """Chooses this fault."""
    tilt_mrad: tuple[Annotated[float, Field(ge=-500, le=500)], Annotated[float, Field(ge=-500, le=500)]]
    """Rotation of the true direction, as small angles about sensor x and y."""


class ReflectancePatch(TimedFault):
    """Disc of ground with another reflectance: bright rock, shadowed dust, a retroreflector, a metal sheet."""

    kind: Literal["reflectance_patch"]
    """Chooses this fault."""
    centre_m: tuple[float, float]
    """East and north coordinates of the centre, from the site's origin."""
    radius_m: Positive
    """Horizontal radius."""
    reflectance: NonNegative
    """Reflectance of the disc. Values above 1 stand for retroreflection."""


class Clutter(PerBeamFault):
    """Part of the vehicle in the beam: it returns an echo from a short range at zero speed, and its share of the
    power does not reach the ground. The received powers decide which echo is reported. Level `spectral` or
    `waveform`."""

    kind: Literal["clutter"]
    """Chooses this fault."""
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
    """Chooses this fault."""
    segments: Annotated[list[Literal["up", "constant", "down"]], Field(min_length=1, max_length=3)]
    """Missing segments."""


class WrongBranch(PerBeamFault):
    """Doppler sign ambiguity of a homodyne receiver, resolved to the wrong sign: range and closing speed are both
    wrong, consistent with the two beat frequencies they are computed from, and reported as valid. Level `spectral`."""

    kind: Literal["wrong_branch"]
    """Chooses this fault."""


class Alias(PerBeamFault):
    """Undersampling: the digitiser takes only every Nth sample without an anti-aliasing filter. Beat frequencies
    beyond the lower Nyquist frequency are folded below it, and so is the noise. Level `spectral`."""

    kind: Literal["alias"]
    """Chooses this fault."""
    decimation: Annotated[int, Field(ge=2, le=64)]
    """N. The receiver is not aware of the decimation."""


class FalseAlarms(PerBeamFault):
    """Raised receiver noise with an unchanged threshold, as from stray light or a disturbed supply: noise peaks are
    detected as false alarms at the rate of the noise model, and echoes are lost in noise. Level `spectral`."""

    kind: Literal["false_alarms"]
    """Chooses this fault."""
    noise_db: Annotated[float, Field(gt=0, le=30)]
    """Increase of the noise power."""


LightFault = LaserFade | Misalignment | ReflectancePatch | Clutter
ReceiverFault = MissingSegment | WrongBranch | Alias | FalseAlarms
