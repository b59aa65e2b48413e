"""Decoded messages, the same for all links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from lidar_protocol.fields import Value


class Message(NamedTuple):
    """One shot of one unit.

    `header` and each of `beams` hold values by the names of the interface definition, in the units of the names; None
    stands for the code "none". The set `core` on CAN carries fewer values than a packet.
    """

    unit: int
    header: Mapping[str, Value]
    beams: tuple[Mapping[str, Value], ...]
    sequence: int | None = None
    """Sequence count of the packet, if its header has one."""

    @property
    def time_ns(self) -> int | None:
        """Time of validity from the epoch, with the resolution of the interface."""
        return self._time("time")

    @property
    def due_ns(self) -> int | None:
        """Scheduled time of transmission from the epoch."""
        return self._time("due")

    @property
    def shot(self) -> int | None:
        """Shot number."""
        shot = self.header.get("shot")
        return None if shot is None else int(shot)

    def _time(self, name: str) -> int | None:
        """Time from the field in nanoseconds, or else from the one in seconds."""
        time_ns = self.header.get(f"{name}_ns")
        if time_ns is not None:
            return int(time_ns)
        time_s = self.header.get(f"{name}_s")
        return None if time_s is None else round(time_s * 1e9)


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """Acknowledgement of a command."""

    unit: int
    command: str | None
    """Name of the command; None if the interface does not have its code."""
    sequence: int | None
    """Sequence number of the command."""
    verdict: str
    """`accepted`, or the reason for rejection, by the names of the interface."""
    values: Mapping[str, Value]
    """All fields by name."""


@dataclass(frozen=True, slots=True)
class Housekeeping:
    """Housekeeping of a device; on CAN the part in one frame."""

    unit: int
    values: Mapping[str, Value]


Received = Message | Acknowledge | Housekeeping


@dataclass(frozen=True, slots=True)
class Command:
    """A valid command."""

    unit: int
    name: str
    sequence: int
    values: Mapping[str, Value]
    """Arguments by name."""


@dataclass(frozen=True, slots=True)
class BadCommand:
    """An undamaged packet to this unit that is not a valid command of the interface: to be rejected."""

    unit: int
    code: int | None
    """Code of the command, if it can be decoded."""
    sequence: int | None
    """Sequence number; None if the packet ends before it."""
    verdict: str
    """`unknown`, `malformed` or `out_of_range`."""
    text: str
    """Description of the error."""
