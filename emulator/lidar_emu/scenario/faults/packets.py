"""Faults of packet contents (clock, counter, units), of encoded packets, and of the line between packets."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.faults.timing import TimedFault
from lidar_emu.scenario.section import Fraction, Positive


class TimeJump(TimedFault):
    """Clock jump: times of validity in packets are shifted, but not before the epoch nor beyond 2**32 s after it. The
    measurement and the time of transmission are not affected."""

    kind: Literal["time_jump"]
    """Chooses this fault."""
    jump_s: float
    """Added to the time."""


class FrozenCounter(TimedFault):
    """Frozen shot counter: the counter, and with it the sequence count, repeats its last value before the fault."""

    kind: Literal["frozen_counter"]
    """Chooses this fault."""


class Lost(TimedFault):
    """Lost packets: their sequence counts are missing."""

    kind: Literal["lost"]
    """Chooses this fault."""


class Doubled(TimedFault):
    """Duplicated packets."""

    kind: Literal["doubled"]
    """Chooses this fault."""


class Reordered(TimedFault):
    """Reordered packets: a packet is sent after the packet of the next shot. At the end of a run it is lost."""

    kind: Literal["reordered"]
    """Chooses this fault."""


class StalePacket(TimedFault):
    """Stale packet: the last packet before the fault is sent again instead of the current one, bit for bit."""

    kind: Literal["stale_packet"]
    """Chooses this fault."""


class BitErrors(TimedFault):
    """Bit errors on the link. CAN controllers repeat damaged frames; on CAN this fault stands for data that a gateway
    corrupted."""

    kind: Literal["bit_errors"]
    """Chooses this fault."""
    rate: Fraction
    """Probability of inversion of each bit; on CAN of each data bit."""


class Truncated(TimedFault):
    """Truncated packets: the last bytes are missing, on CAN the last frames."""

    kind: Literal["truncated"]
    """Chooses this fault."""
    keep: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Fraction of the packet that is sent, rounded down."""


class WrongCrc(TimedFault):
    """Wrong CRC in an otherwise correct packet. Only on byte links."""

    kind: Literal["wrong_crc"]
    """Chooses this fault."""


class Delayed(TimedFault):
    """Delayed packets: sent in order, later than the time of transmission in them. `late_after_s` counts from the
    delayed due time."""

    kind: Literal["delayed"]
    """Chooses this fault."""
    delay_s: Annotated[float, Field(gt=0, le=1)]
    """Delay."""


class Silence(TimedFault):
    """No measurement packets, as with the transmitter off or the cable unplugged."""

    kind: Literal["silence"]
    """Chooses this fault."""


class Garbage(TimedFault):
    """Random bytes before a packet, as from a loose connector or another transmitter. On CAN, random frames."""

    kind: Literal["garbage"]
    """Chooses this fault."""
    bytes: Annotated[int, Field(ge=1, le=1024)]
    """Number of bytes; on CAN eight per frame."""


class WrongUnit(TimedFault):
    """Lengths and speeds in packets are in another unit of length than the interface defines. The measurement is not
    affected."""

    kind: Literal["wrong_unit"]
    """Chooses this fault."""
    metres: Positive = 0.3048
    """Metres per unit; left out: one foot."""


class OtherUnit(TimedFault):
    """Packets carry the unit number of another device, with a correct CRC."""

    kind: Literal["other_unit"]
    """Chooses this fault."""
    unit: Annotated[int, Field(ge=0, le=15)]
    """Unit number in the packets; one that the interface has."""


class WrongEndian(TimedFault):
    """Wrong byte order: fields of several bytes in the measurement are byte-swapped, with a correct CRC. The packet
    header is not affected."""

    kind: Literal["wrong_endian"]
    """Chooses this fault."""


class OtherVersion(TimedFault):
    """Firmware with another interface version: packets state it, with a correct CRC. Only if the interface has a
    field `interface_version` of whole bytes."""

    kind: Literal["other_version"]
    """Chooses this fault."""
    version: Annotated[int, Field(ge=0, le=255)]
    """Version in the packets."""


ContentFault = TimeJump | FrozenCounter | WrongUnit
PacketFault = (
    Lost | Doubled | Reordered | StalePacket | BitErrors | Truncated | WrongCrc | Delayed | Silence | Garbage
) | (OtherUnit | WrongEndian | OtherVersion)
