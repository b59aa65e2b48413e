"""Faults of packet contents (clock, counter, units), of encoded packets, and of the line between packets."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.device import DriftPpm, OffsetS
from lidar_emu.scenario.faults.beams import FaultWindow, TimedFault
from lidar_emu.scenario.section import Fraction, Positive, Switch, unusable


class TimeJump(TimedFault):
    """Clock jump: times of validity in packets are shifted, but not before the epoch nor beyond 2**32 s after it. The
    measurement and the time of transmission are not affected."""

    kind: Literal["time_jump"]
    jump_s: float
    """Added to the time."""


class FrozenCounter(TimedFault):
    """Frozen shot counter: the counter, and with it the sequence count, repeats its last value before the fault."""

    kind: Literal["frozen_counter"]


class Lost(TimedFault):
    """Lost packets: their sequence counts are missing."""

    kind: Literal["lost"]


class Doubled(TimedFault):
    """Duplicated packets."""

    kind: Literal["doubled"]


class Reordered(TimedFault):
    """Reordered packets: a packet is sent after the packet of the next shot. At the end of a run it is lost."""

    kind: Literal["reordered"]


class StalePacket(TimedFault):
    """Stale packet: the last packet before the fault is sent again instead of the current one, bit for bit."""

    kind: Literal["stale_packet"]


class BitErrors(TimedFault):
    """Bit errors on the link. CAN controllers repeat damaged frames; on CAN this fault stands for data that a gateway
    corrupted."""

    kind: Literal["bit_errors"]
    rate: Fraction
    """Probability of inversion of each bit; on CAN of each data bit."""


class Truncated(TimedFault):
    """Truncated packets: the last bytes are missing, on CAN the last frames."""

    kind: Literal["truncated"]
    keep: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Fraction of the packet that is sent, rounded down."""


class WrongCrc(TimedFault):
    """Wrong CRC in an otherwise correct packet. Only on byte links."""

    kind: Literal["wrong_crc"]


class Delayed(TimedFault):
    """Delayed packets: sent in order, later than the time of transmission in them. `late_after_s` counts from the
    delayed due time."""

    kind: Literal["delayed"]
    delay_s: Annotated[float, Field(gt=0, le=1)]
    """Delay."""


class Silence(TimedFault):
    """No measurement packets, as with the transmitter off or the cable unplugged."""

    kind: Literal["silence"]


class Garbage(TimedFault):
    """Random bytes before a packet, as from a loose connector or another transmitter. On CAN, random frames."""

    kind: Literal["garbage"]
    bytes: Annotated[int, Field(ge=1, le=1024)]
    """Number of bytes; on CAN eight per frame."""


class WrongUnit(TimedFault):
    """Lengths and speeds in packets are in another unit of length than the interface defines. The measurement is not
    affected."""

    kind: Literal["wrong_unit"]
    metres: Positive = 0.3048
    """Metres per unit; left out: one foot."""


class OtherUnit(TimedFault):
    """Packets carry the unit number of another device, with a correct CRC."""

    kind: Literal["other_unit"]
    unit: Annotated[int, Field(ge=0, le=15)]
    """Unit number in the packets; one that the interface has."""


class WrongEndian(TimedFault):
    """Wrong byte order: fields of several bytes in the measurement are byte-swapped, with a correct CRC. The packet
    header is not affected."""

    kind: Literal["wrong_endian"]


class OtherVersion(TimedFault):
    """Firmware with another interface version: packets state it, with a correct CRC. Only if the interface has a
    field `interface_version` of whole bytes."""

    kind: Literal["other_version"]
    version: Annotated[int, Field(ge=0, le=255)]
    """Version in the packets."""


ContentFault = TimeJump | FrozenCounter | WrongUnit
PacketFault = (
    Lost | Doubled | Reordered | StalePacket | BitErrors | Truncated | WrongCrc | Delayed | Silence | Garbage
) | (OtherUnit | WrongEndian | OtherVersion)


class Disconnect(FaultWindow):
    """The port is closed, and opened again after the window. The host sees a pulled cable; on a pseudo-terminal it
    sees a hang-up."""

    kind: Literal["disconnect"]


class SlowLine(FaultWindow):
    """Slow line: packets wait in the transmit buffer of 4096 bytes and leave it whole, one after another. A packet that
    does not fit into the buffer is dropped."""

    kind: Literal["slow_line"]
    bit_rate: Annotated[int, Field(ge=50, le=100_000_000)]
    """Bits per second: ten per byte on a serial line, all bits of a frame on CAN."""


class Babble(FaultWindow):
    """Babbling transmitter: random bytes between packets; on CAN frames of eight bytes with random identifiers."""

    kind: Literal["babble"]
    bytes_per_s: Annotated[int, Field(ge=1, le=100_000)]
    """Constant rate over the window."""


class ErrorFrames(FaultWindow):
    """Another node destroys frames on the CAN bus: the controller counts error frames. Only on CAN; injected error
    frames are counted and not sent."""

    kind: Literal["error_frames"]
    rate_hz: Annotated[float, Field(gt=0, le=10_000)]
    """Error frames per second."""


class BusOff(FaultWindow):
    """Bus off: after too many errors the CAN controller neither sends nor receives, until the window ends and it is
    restarted. Only on CAN."""

    kind: Literal["bus_off"]


LinkFault = Disconnect | SlowLine | Babble | ErrorFrames | BusOff


class BrownOut(FaultWindow):
    """Supply dip: the device is off during the window. Afterwards it boots, with its initial state, and stays in
    standby until commanded."""

    kind: Literal["brown_out"]


class Interlock(FaultWindow):
    """Open safety interlock: the laser is off, and the device is in mode `fault`. After the window the interlock is
    closed, and the device can be reset."""

    kind: Literal["interlock"]


class ClockError(FaultWindow):
    """Wrong clock: every time that the device states is wrong, in measurements, housekeeping and acknowledgements.
    `time_at_tone` does not correct it, and the lock flag does not show it."""

    kind: Literal["clock_error"]
    offset_s: OffsetS = 0.0
    """Added to the time."""
    drift_ppm: DriftPpm = 0.0
    """Rate of a further error that grows from the start of the window; positive if the clock is fast."""
    second_half: Switch = False
    """`on`: the time is wrong in the second half of each second of the clock, and right in the first."""

    def _check(self) -> None:
        super()._check()
        if self.offset_s == 0 == self.drift_ppm:
            raise unusable("offset_s", self.offset_s, "another number unless drift_ppm is given")


DeviceFault = BrownOut | Interlock | ClockError
