"""What a receiver hands on, whatever it travelled by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from lidar_protocol.fields import Value


class Message(NamedTuple):
    """One shot of one unit.

    `header` and each of `beams` hold what was sent under the names of the interface definition, in the units
    of the names; None where the code for "none" was sent. A core set on CAN carries less than a packet.
    """

    unit: int
    header: Mapping[str, Value]
    beams: tuple[Mapping[str, Value], ...]
    sequence: int | None = None
    """The packet's sequence count, where its header has one."""

    @property
    def time_ns(self) -> int | None:
        """Time of validity from the epoch, as finely as the interface sends it."""
        return self._time("time")

    @property
    def due_ns(self) -> int | None:
        """Time from the epoch at which the transmission was due."""
        return self._time("due")

    @property
    def shot(self) -> int | None:
        """Number of the shot."""
        shot = self.header.get("shot")
        return None if shot is None else int(shot)

    def _time(self, name: str) -> int | None:
        """From the field in nanoseconds, or that in seconds."""
        time_ns = self.header.get(f"{name}_ns")
        if time_ns is not None:
            return int(time_ns)
        time_s = self.header.get(f"{name}_s")
        return None if time_s is None else round(time_s * 1e9)


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """What a device says to a command."""

    unit: int
    command: str | None
    """Name of the command; None if its code is none of the interface's."""
    sequence: int | None
    """That of the command."""
    verdict: str
    """`accepted`, or why it was rejected, in the words of the interface."""
    values: Mapping[str, Value]
    """Every field."""


@dataclass(frozen=True, slots=True)
class Housekeeping:
    """How a device is; on CAN, the part of it that one frame carries."""

    unit: int
    values: Mapping[str, Value]


Received = Message | Acknowledge | Housekeeping


@dataclass(frozen=True, slots=True)
class Command:
    """A command that a device can follow."""

    unit: int
    name: str
    sequence: int
    values: Mapping[str, Value]
    """Its arguments."""


@dataclass(frozen=True, slots=True)
class BadCommand:
    """An undamaged packet for this unit that is no command of the interface: to be rejected."""

    unit: int
    code: int | None
    """Of the command that was meant, if it can be told."""
    sequence: int | None
    verdict: str
    """`unknown`, `malformed` or `out_of_range`."""
    text: str
    """What is wrong, in words."""
