"""Faults of the port itself. They act where it is, on the clock: at the pace of the clock alone."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.faults.timing import FaultWindow


class Disconnect(FaultWindow):
    """The port is closed, and opened again after the window. The other end sees what it sees when a cable is pulled:
    of a pty, that everybody has left."""

    kind: Literal["disconnect"]
    """Chooses this fault."""


class SlowLine(FaultWindow):
    """The line takes longer: packets wait in the transmitter's buffer and leave it whole, one after another. A packet
    that finds no room is dropped."""

    kind: Literal["slow_line"]
    """Chooses this fault."""
    bit_rate: Annotated[int, Field(ge=50, le=100_000_000)]
    """Bits per second: ten to a byte, of CAN frames all bits."""
    buffer_bytes: Annotated[int, Field(ge=256, le=1_048_576)] = 4096
    """Of the transmitter."""


class Babble(FaultWindow):
    """A transmitter that will not be silent: random bytes between packets, at a rate; on CAN frames of eight bytes with
    random identifiers."""

    kind: Literal["babble"]
    """Chooses this fault."""
    bytes_per_s: Annotated[int, Field(ge=1, le=100_000)]
    """On average over the window, evenly."""


class ErrorFrames(FaultWindow):
    """Somebody on the CAN bus destroys frames: the controller counts error frames. On CAN alone; ordered ones are
    counted and not sent."""

    kind: Literal["error_frames"]
    """Chooses this fault."""
    rate_hz: Annotated[float, Field(gt=0, le=10_000)]
    """So many in a second."""


class BusOff(FaultWindow):
    """The CAN controller has seen too many errors and is off: nothing is sent or heard until the window ends and it is
    restarted. On CAN alone."""

    kind: Literal["bus_off"]
    """Chooses this fault."""


LinkFault = Disconnect | SlowLine | Babble | ErrorFrames | BusOff
