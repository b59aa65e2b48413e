"""Faults of clock and counter, which stamp packets, of finished packets, and of what the line carries besides."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.faults.timing import TimedFault
from lidar_emu.scenario.part import Fraction, Positive


class TimeJump(TimedFault):
    """The clock is wrong: times of validity in packets are shifted, but never before the epoch. What was measured, and
    when packets are sent, stays."""

    kind: Literal["time_jump"]
    """Chooses this fault."""
    jump_s: float
    """Added to the time."""


class FrozenCounter(TimedFault):
    """The counter of shots, and with it the sequence count, repeats its last value from before the fault."""

    kind: Literal["frozen_counter"]
    """Chooses this fault."""


class Lost(TimedFault):
    """Packets are lost: their sequence counts are missing."""

    kind: Literal["lost"]
    """Chooses this fault."""


class Doubled(TimedFault):
    """Packets come twice."""

    kind: Literal["doubled"]
    """Chooses this fault."""


class Reordered(TimedFault):
    """A packet is held back, and follows that of the next shot. At the end of a run it is lost."""

    kind: Literal["reordered"]
    """Chooses this fault."""


class StalePacket(TimedFault):
    """In place of a packet the last one from before the fault is sent again, bit for bit."""

    kind: Literal["stale_packet"]
    """Chooses this fault."""


class BitErrors(TimedFault):
    """Bits are inverted on the way. On CAN, whose controllers repeat such frames, it is data that a gateway spoilt."""

    kind: Literal["bit_errors"]
    """Chooses this fault."""
    rate: Fraction
    """Probability for each bit; of frames on CAN, bits of the data."""


class Truncated(TimedFault):
    """The rest of a packet is missing: bytes, on CAN whole frames."""

    kind: Literal["truncated"]
    """Chooses this fault."""
    keep: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Part of the packet that is sent, rounded down."""


class WrongCrc(TimedFault):
    """A packet is whole, but for its CRC. On byte links alone."""

    kind: Literal["wrong_crc"]
    """Chooses this fault."""


class Delayed(TimedFault):
    """Packets are sent later than their contents say; none overtakes another. `late_after_s` counts from then."""

    kind: Literal["delayed"]
    """Chooses this fault."""
    delay_s: Annotated[float, Field(gt=0, le=1)]
    """By how much."""


class Silence(TimedFault):
    """The line carries no measurements: the transmitter is off, or the cable unplugged."""

    kind: Literal["silence"]
    """Chooses this fault."""


class Garbage(TimedFault):
    """Random bytes precede a packet: a loose plug, or somebody else's transmitter. On CAN, random frames."""

    kind: Literal["garbage"]
    """Chooses this fault."""
    bytes: Annotated[int, Field(ge=1, le=1024)]
    """So many; on CAN eight to a frame."""


class WrongUnit(TimedFault):
    """Lengths and speeds in packets are in another unit of length than the interface says. What was measured stays."""

    kind: Literal["wrong_unit"]
    """Chooses this fault."""
    metres: Positive = 0.3048
    """In one such unit; left out: a foot."""


class OtherUnit(TimedFault):
    """Another device answers in place of this one: packets carry its number, and a CRC that is right."""

    kind: Literal["other_unit"]
    """Chooses this fault."""
    unit: Annotated[int, Field(ge=0, le=15)]
    """Its number; one that the interface has."""


class WrongEndian(TimedFault):
    """A driver for the other sort of processor: numbers of several bytes stand in the packet the other way round, and
    the CRC is right. Of packet and beams; what the header of the packet itself holds stays readable."""

    kind: Literal["wrong_endian"]
    """Chooses this fault."""


class OtherVersion(TimedFault):
    """Firmware of another interface version: packets say so, and the CRC is right. Where the interface has a field
    `version` alone."""

    kind: Literal["other_version"]
    """Chooses this fault."""
    version: Annotated[int, Field(ge=0, le=255)]
    """What they say."""


ContentFault = TimeJump | FrozenCounter | WrongUnit
PacketFault = (
    Lost | Doubled | Reordered | StalePacket | BitErrors | Truncated | WrongCrc | Delayed | Silence | Garbage
) | (OtherUnit | WrongEndian | OtherVersion)
