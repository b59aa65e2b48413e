"""Faults of the port. They act in the port process by the clock, and only at pace `wall`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.scenario.faults.timing import FaultWindow


class Disconnect(FaultWindow):
    """The port is closed, and opened again after the window. The host sees a pulled cable; on a pseudo-terminal it
    sees a hang-up."""

    kind: Literal["disconnect"]
    """Chooses this fault."""


class SlowLine(FaultWindow):
    """Slow line: packets wait in the transmit buffer of 4096 bytes and leave it whole, one after another. A packet that
    does not fit into the buffer is dropped."""

    kind: Literal["slow_line"]
    """Chooses this fault."""
    bit_rate: Annotated[int, Field(ge=50, le=100_000_000)]
    """Bits per second: ten per byte on a serial line, all bits of a frame on CAN."""


class Babble(FaultWindow):
    """Babbling transmitter: random bytes between packets; on CAN frames of eight bytes with random identifiers."""

    kind: Literal["babble"]
    """Chooses this fault."""
    bytes_per_s: Annotated[int, Field(ge=1, le=100_000)]
    """Constant rate over the window."""


class ErrorFrames(FaultWindow):
    """Another node destroys frames on the CAN bus: the controller counts error frames. Only on CAN; injected error
    frames are counted and not sent."""

    kind: Literal["error_frames"]
    """Chooses this fault."""
    rate_hz: Annotated[float, Field(gt=0, le=10_000)]
    """Error frames per second."""


class BusOff(FaultWindow):
    """Bus off: after too many errors the CAN controller neither sends nor receives, until the window ends and it is
    restarted. Only on CAN."""

    kind: Literal["bus_off"]
    """Chooses this fault."""


LinkFault = Disconnect | SlowLine | Babble | ErrorFrames | BusOff
