"""When a packet goes out: a pure decision."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum


class Pace(StrEnum):
    """How the run's time passes."""

    WALL = "wall"
    """With the wall clock: a packet goes out when it is due, or not at all."""
    MAX = "max"
    """As fast as the link takes it; nothing is late.

    A full line is waited for, and so is the first reader of a pty, but not for ever: when the line has taken
    nothing for 5 s that is a link event, and when nothing moved for 30 s packets are dropped as full, or as
    nobody connected, until something moves again. Once a pty had a reader, none is waited for any more."""
    LOCKSTEP = "lockstep"
    """With live truth: a packet goes out, as with `MAX`, once truth has come that its shot precedes."""


class WhenLate(StrEnum):
    """What a late packet means for the run."""

    SKIP = "skip"
    """It is skipped, and the next one goes out when it is due."""
    ABORT = "abort"
    """It was the last one: nothing is sent any more."""


class Action(Enum):
    """What to do with the next packet."""

    WAIT = "wait"
    SEND = "send"
    SKIP = "skip"


@dataclass(frozen=True)
class Pacing:
    """The rule. After a stall what is too old is skipped: no burst follows that no instrument would make."""

    pace: Pace
    late_after_ns: int
    """A packet that could not start within this time after it was due is late, and skipped."""
    when_late: WhenLate = WhenLate.SKIP

    def action(self, now_ns: int, due_ns: int) -> Action:
        """What to do at `now_ns` with a packet due at `due_ns`, both from the start of the run."""
        if self.pace is not Pace.WALL:
            return Action.SEND
        if now_ns < due_ns:
            return Action.WAIT
        return Action.SKIP if now_ns > due_ns + self.late_after_ns else Action.SEND
