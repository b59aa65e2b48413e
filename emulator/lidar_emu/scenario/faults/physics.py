"""Faults of light and receiver: they act in the model, and what they do to values follows from it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.faults.timing import PerBeamFault, RampedFault, TimedFault
from lidar_emu.scenario.part import NonNegative, Positive


class LaserFade(RampedFault):
    """Less light leaves the telescope: the laser ages, a fibre bends, dust settles on the window. The local oscillator
    stays, so that the echo loses as much of its signal-to-noise ratio."""

    kind: Literal["laser_fade"]
    """Chooses this fault."""
    loss_db: NonNegative
    """Of transmitted power. With `ramp_s` the decibels grow evenly."""


class Misalignment(RampedFault):
    """A beam leaves its published direction: a mount gives way, or bends with heat. Truth is that of the true axis."""

    kind: Literal["misalignment"]
    """Chooses this fault."""
    tilt_mrad: tuple[Annotated[float, Field(ge=-500, le=500)], Annotated[float, Field(ge=-500, le=500)]]
    """True direction less the one before the fault, as small rotations about sensor x and y."""


class ReflectancePatch(TimedFault):
    """A disc of ground that reflects otherwise: bright rock, shadowed dust, a retroreflector, a metal sheet."""

    kind: Literal["reflectance_patch"]
    """Chooses this fault."""
    centre_m: tuple[float, float]
    """East and north of the site's origin."""
    radius_m: Positive
    """Of the disc, on the map."""
    reflectance: NonNegative
    """In place of the site's. More than 1 sends light back rather than everywhere."""


class Clutter(PerBeamFault):
    """A part of the vehicle stands in the beam: it returns light from nearby at no speed, and what falls on it is
    missing on the ground. Which of the two is reported follows from their powers. Level `spectral` or `waveform`."""

    kind: Literal["clutter"]
    """Chooses this fault."""
    range_m: Annotated[float, Field(gt=0, le=1000)]
    """Where it stands."""
    reflectance: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Of a surface that faces the sensor."""
    share: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Part of the beam's power that falls on it."""


class MissingSegment(PerBeamFault):
    """A part of the waveform is lost: a chirp that was not driven, a record that was overwritten. What the other
    segments tell goes by the instrument's rule (`detection.rule`). Level `statistical` or `spectral`."""

    kind: Literal["missing_segment"]
    """Chooses this fault."""
    segments: Annotated[list[Literal["up", "constant", "down"]], Field(min_length=1, max_length=3)]
    """What is missing."""


class WrongBranch(PerBeamFault):
    """A homodyne receiver, which sees no signs of frequencies, settles on the other sign of the Doppler shift: range
    and closing speed are both wrong, explain the two beats that they rest on, and are reported as valid. Level
    `statistical` or `spectral`."""

    kind: Literal["wrong_branch"]
    """Chooses this fault."""


class Alias(PerBeamFault):
    """Only every so-manieth sample is taken, and nothing in front of the digitiser holds back what is too fast for
    that: beats beyond the new limit are folded below it, and so is the noise. Level `statistical` or `spectral`."""

    kind: Literal["alias"]
    """Chooses this fault."""
    decimation: Annotated[int, Field(ge=2, le=64)]
    """Of samples; the receiver knows nothing of it."""


class FalseAlarms(PerBeamFault):
    """The receiver's noise rises and its threshold stays: stray light, a disturbed supply. Peaks of noise pass for
    echoes as often as the model of noise says, and echoes are drowned. Level `statistical` or `spectral`."""

    kind: Literal["false_alarms"]
    """Chooses this fault."""
    noise_db: Annotated[float, Field(gt=0, le=30)]
    """By how much."""


LightFault = LaserFade | Misalignment | ReflectancePatch | Clutter
ReceiverFault = MissingSegment | WrongBranch | Alias | FalseAlarms
