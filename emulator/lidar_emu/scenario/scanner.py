"""The scanner: beam directions, changes of pattern, and the mounting on the vehicle."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.section import NonNegative, Part, Vector3

OffBoresight = Annotated[float, Field(ge=0, lt=90)]


class Square(Part):
    """Four beams at azimuths 45, 135, 225 and 315 degrees."""

    kind: Literal["square"]
    angle_deg: OffBoresight
    """Off-boresight angle of every beam."""

    @property
    def beams_deg(self) -> list[tuple[float, float]]:
        return [(self.angle_deg, 45.0 + 90.0 * k) for k in range(4)]


class BeamRing(Part):
    """Beams evenly spaced in azimuth."""

    kind: Literal["ring"]
    count: Annotated[int, Field(ge=1, le=64)]
    """Number of beams."""
    angle_deg: OffBoresight
    """Off-boresight angle of every beam."""
    first_azimuth_deg: float = 0.0
    """Azimuth of beam 0, from sensor x towards y."""

    @property
    def beams_deg(self) -> list[tuple[float, float]]:
        return [(self.angle_deg, self.first_azimuth_deg + 360.0 * k / self.count) for k in range(self.count)]


class Directions(Part):
    """A list of beam directions."""

    kind: Literal["directions"]
    beams: Annotated[list[tuple[OffBoresight, float]], Field(min_length=1, max_length=64)]
    """Off-boresight angle and azimuth of each beam, in degrees."""

    @property
    def beams_deg(self) -> list[tuple[float, float]]:
        return self.beams


Pattern = Annotated[Square | BeamRing | Directions, Field(discriminator="kind")]


class AltitudeSwitch(Part):
    """Another pattern from an altitude downward; it stays."""

    kind: Literal["altitude"]
    below_m: NonNegative
    """Active once the vehicle has been below this altitude."""
    datum: Literal["origin", "ground"] = "origin"
    """Altitude above the origin of the site frame, or above the ground straight below the sensor."""
    pattern: Pattern
    """The beams while active."""


class TimeSwitch(Part):
    """Another pattern from an instant on."""

    kind: Literal["time"]
    at_s: NonNegative
    """Scenario time."""
    pattern: Pattern
    """The beams from then on."""


class Scan(Part):
    """A scan program: after each shot all beams are deflected by one more step along a line from one side to the
    other; after a line they return to its start. The deflection is constant during a shot."""

    half_angle_deg: Annotated[float, Field(gt=0, lt=90)]
    """Largest deflection to each side of the pattern's direction."""
    steps: Annotated[int, Field(ge=2, le=10_000)]
    """Shots per line, evenly spaced in angle, both ends included."""
    azimuth_deg: float = 90.0
    """Direction in which a line ends, from sensor x towards y: at 90 the scan runs across track to the right."""


class Scanner(Part):
    """Non-mechanical scanner: patterns change between shots."""

    pattern: Pattern
    """The beams at the start."""
    switches: list[Annotated[AltitudeSwitch | TimeSwitch, Field(discriminator="kind")]] = []
    """Changes of pattern in flight, at the start of a shot; of several active ones, the last in the list applies."""
    firing: Literal["together", "in_turn"] = "together"
    """All beams in one cycle (one receiver each), or one cycle after another, each with its own validity (the latter
    for a lidar that switches one laser between its telescopes)."""
    scan: Scan | None = None
    """Left out: no scan."""
    misalignment_mrad: list[tuple[float, float]] = []
    """True direction minus published direction, per beam, as small rotations about sensor x and y. Left out: none.
    The flight software knows the published direction only. For flight software that must live with an uncalibrated
    beam."""

    @property
    def patterns(self) -> list[Pattern]:
        """The pattern at the start, then the pattern of each switch."""
        return [self.pattern, *(switch.pattern for switch in self.switches)]

    @property
    def beam_count(self) -> int:
        """Beams of the pattern that has most."""
        return max(len(pattern.beams_deg) for pattern in self.patterns)


class Mounting(Part):
    """The position and attitude of the sensor on the body."""

    lever_arm_m: Vector3 = (0.0, 0.0, 0.0)
    """Position of the sensor in the body frame (x forward, y right, z down), from the point whose trajectory is
    flown."""
    roll_deg: float = 0.0
    """Rotation of the sensor relative to the body about x (order yaw, pitch, roll). At zero the boresight is body z."""
    pitch_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    """Rotation of the sensor relative to the body about y."""
    yaw_deg: float = 0.0
    """Rotation of the sensor relative to the body about z."""
