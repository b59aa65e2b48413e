"""Faults on order: what goes wrong, when, how often and in which beams."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lidar_emu.scenario.part import Fraction, NonNegative, Part, unusable

Interval = tuple[float, float]


class _Fault(Part):
    """When a fault acts: in shots that begin within a window, in all of them or by chance."""

    at_s: NonNegative | None = None
    """Only the first shot that begins at this scenario time or later, in place of a window."""
    from_s: NonNegative = 0.0
    """Start of the window, scenario time."""
    to_s: Annotated[float, Field(gt=0)] | None = None
    """End of the window: shots that begin then are spared. Left out: the end of the run."""
    probability: Fraction = 1.0
    """Of setting in, for each shot (and each beam, where the fault is one of beams) in the window."""
    lasts_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """How long it lasts once it has set in by chance; 0: one shot. It ends with the window."""

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


class _OfBeams(_Fault):
    """A fault of beams, each by its own chance."""

    beams: Annotated[list[Annotated[int, Field(ge=0, le=63)]], Field(min_length=1)] | None = None
    """Numbers of the beams, from 0. Left out: all."""


class _Ramped(_OfBeams):
    """A fault of beams that grows."""

    ramp_s: NonNegative = 0.0
    """Time from the start of the window in which it grows, evenly, to its full size."""


class Dropout(_OfBeams):
    """The echo is lost: the beam is invalid, with reason `below_threshold`."""

    kind: Literal["dropout"]
    """Chooses this fault."""


class Stuck(_OfBeams):
    """A register is not renewed: a valid range, speed or both repeat the last valid value from before the fault. Flags,
    signal-to-noise ratio and time go on."""

    kind: Literal["stuck"]
    """Chooses this fault."""
    value: Literal["range", "closing_speed", "both"] = "both"
    """What is stuck."""


class Frozen(_OfBeams):
    """A beam's processing hangs: everything that it reports, flags and reason too, is that of the last shot before the
    fault, under the time of the present one. Stale but valid."""

    kind: Literal["frozen"]
    """Chooses this fault."""


class Bias(_Ramped):
    """A constant error of calibration, added. A range stops at 0."""

    kind: Literal["bias"]
    """Chooses this fault."""
    range_m: float = 0.0
    """Added to the range."""
    closing_speed_mps: float = 0.0
    """Added to the closing speed."""


class Scale(_Ramped):
    """A wrong chirp slope (range) or wavelength (speed): values are multiplied."""

    kind: Literal["scale"]
    """Chooses this fault."""
    range_factor: Annotated[float, Field(gt=0)] = 1.0
    """Of the range."""
    closing_speed_factor: Annotated[float, Field(gt=0)] = 1.0
    """Of the closing speed."""


class Drift(_OfBeams):
    """An error that grows steadily from the start of the window, as with temperature. A range stops at 0."""

    kind: Literal["drift"]
    """Chooses this fault."""
    range_mps: float = 0.0
    """Added to the range per second."""
    closing_speed_mps2: float = 0.0
    """Added to the closing speed per second."""


class Noise(_Ramped):
    """More noise than the instrument admits to: Gaussian, white from shot to shot. A range stops at 0."""

    kind: Literal["noise"]
    """Chooses this fault."""
    range_m: NonNegative = 0.0
    """Standard deviation added to the range."""
    closing_speed_mps: NonNegative = 0.0
    """Standard deviation added to the closing speed."""


class Outlier(_OfBeams):
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


class WrongSign(_OfBeams):
    """The sign of the Doppler shift is taken for the other one: the closing speed is negated, and valid."""

    kind: Literal["wrong_sign"]
    """Chooses this fault."""


class SwappedBeams(_Fault):
    """Two receivers are crossed: each of two beams reports what the other one measured."""

    kind: Literal["swapped_beams"]
    """Chooses this fault."""
    beams: tuple[Annotated[int, Field(ge=0, le=63)], Annotated[int, Field(ge=0, le=63)]]
    """The two."""

    @model_validator(mode="after")
    def _beams_differ(self) -> Self:
        if self.beams[0] == self.beams[1]:
            raise unusable("beams", list(self.beams), "two different beams")
        return self


class FalseValid(_OfBeams):
    """A beam that has found nothing claims a valid measurement."""

    kind: Literal["false_valid"]
    """Chooses this fault."""
    range_m: NonNegative
    """What it then reports."""
    closing_speed_mps: float = 0.0
    """What it then reports."""


class FalseInvalid(_OfBeams):
    """A good measurement is marked as none: the values stand there, the valid flags do not."""

    kind: Literal["false_invalid"]
    """Chooses this fault."""


class TimeJump(_Fault):
    """The clock is wrong: times of validity in packets are shifted, but never before the epoch. What was measured, and
    when packets are sent, stays."""

    kind: Literal["time_jump"]
    """Chooses this fault."""
    jump_s: float
    """Added to the time."""


class FrozenCounter(_Fault):
    """The counter of shots, and with it the sequence count, repeats its last value from before the fault."""

    kind: Literal["frozen_counter"]
    """Chooses this fault."""


class Lost(_Fault):
    """Packets are lost: their sequence counts are missing."""

    kind: Literal["lost"]
    """Chooses this fault."""


class Doubled(_Fault):
    """Packets come twice."""

    kind: Literal["doubled"]
    """Chooses this fault."""


class Reordered(_Fault):
    """A packet is held back, and follows that of the next shot. At the end of a run it is lost."""

    kind: Literal["reordered"]
    """Chooses this fault."""


class StalePacket(_Fault):
    """In place of a packet the last one from before the fault is sent again, bit for bit."""

    kind: Literal["stale_packet"]
    """Chooses this fault."""


class BitErrors(_Fault):
    """Bits are inverted on the way. On CAN, whose controllers repeat such frames, it is data that a gateway spoilt."""

    kind: Literal["bit_errors"]
    """Chooses this fault."""
    rate: Fraction
    """Probability for each bit; of frames on CAN, bits of the data."""


class Truncated(_Fault):
    """The rest of a packet is missing: bytes, on CAN whole frames."""

    kind: Literal["truncated"]
    """Chooses this fault."""
    keep: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Part of the packet that is sent, rounded down."""


class WrongCrc(_Fault):
    """A packet is whole, but for its CRC. On byte links alone."""

    kind: Literal["wrong_crc"]
    """Chooses this fault."""


class Delayed(_Fault):
    """Packets are sent later than their contents say; none overtakes another. `late_after_s` counts from then."""

    kind: Literal["delayed"]
    """Chooses this fault."""
    delay_s: Annotated[float, Field(gt=0, le=1)]
    """By how much."""


class Silence(_Fault):
    """The line carries no measurements: the transmitter is off, or the cable unplugged."""

    kind: Literal["silence"]
    """Chooses this fault."""


class Garbage(_Fault):
    """Random bytes precede a packet: a loose plug, or somebody else's transmitter. On CAN, random frames."""

    kind: Literal["garbage"]
    """Chooses this fault."""
    bytes: Annotated[int, Field(ge=1, le=1024)]
    """So many; on CAN eight to a frame."""


BeamFault = (
    Dropout | Stuck | Frozen | Bias | Scale | Drift | Noise | Outlier | WrongSign | SwappedBeams | FalseValid
) | FalseInvalid
StampFault = TimeJump | FrozenCounter
PacketFault = (
    Lost | Doubled | Reordered | StalePacket | BitErrors | Truncated | WrongCrc | Delayed | Silence | Garbage
)
Fault = Annotated[BeamFault | StampFault | PacketFault, Field(discriminator="kind")]
