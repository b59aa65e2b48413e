"""Pacing: when a packet is sent, as a pure decision."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum


class Pace(StrEnum):
    """What sets the pace of a run."""

    WALL = "wall"
    """The wall clock: a packet goes out when it is due, or not at all."""
    MAX = "max"
    """The link: packets go out as fast as it takes them; nothing is late.

    The sender waits for a full line and for the first reader of a pty, but not forever: after 5 s in which the line
    has taken nothing there is a link event, and after 30 s without progress packets are dropped, as line full or as
    no reader, until there is progress again. Once a pty has had a reader, the sender no longer waits for one."""
    LOCKSTEP = "lockstep"
    """Live truth: a packet goes out, as with `MAX`, once truth beyond its shot has arrived."""


class WhenLate(StrEnum):
    """What happens when a packet is late."""

    SKIP = "skip"
    """It is skipped, and the next one goes out when it is due."""
    ABORT = "abort"
    """The run ends: nothing more is sent."""


class Action(Enum):
    """What to do with the next packet."""

    WAIT = "wait"
    SEND = "send"
    SKIP = "skip"


@dataclass(frozen=True)
class Pacing:
    """Decides when packets are sent.

    After a stall, overdue packets are skipped: an instrument would not send them in a burst either.
    """

    pace: Pace
    late_after_ns: int
    """A packet is late, and skipped, if its transmission could not begin within this time after it was due."""
    when_late: WhenLate = WhenLate.SKIP

    def action(self, now_ns: int, due_ns: int) -> Action:
        """What to do at `now_ns` with a packet due at `due_ns`, both from the start of the run."""
        if self.pace is not Pace.WALL:
            return Action.SEND
        if now_ns < due_ns:
            return Action.WAIT
        return Action.SKIP if now_ns > due_ns + self.late_after_ns else Action.SEND
