"""What shots are to follow, commanded or ordered, in the order in which it was heard."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from lidar_emu.session import Session


class Change(NamedTuple):
    """Something that shots are to follow."""

    apply: Callable[[Session], None]
    """Lets the session's next shot be the first to follow it."""
    arrived_ns: int
    """When it came, or from when on it can be followed, on the monotonic clock."""
    settled: Callable[[int | None, int | None], None] | None = None
    """Told which shot is the first to follow it, None if none does; and when that begins on the monotonic clock, None
    where that does not set the pace."""


class Changes:
    """They are followed one after another: no change takes effect before one that was heard earlier."""

    def __init__(self) -> None:
        self._waiting: deque[Change] = deque()

    def add(self, change: Change) -> None:
        """One more was heard."""
        self._waiting.append(change)

    @property
    def first(self) -> Change | None:
        """The oldest that no shot follows yet."""
        return self._waiting[0] if self._waiting else None

    def follow(self, session: Session, begins_ns: int | None) -> None:
        """Let the session's next shot, which begins then, be the first to follow the oldest change."""
        change = self._waiting.popleft()
        change.apply(session)
        if change.settled is not None:
            change.settled(session.next_shot, begins_ns)

    def close(self) -> None:
        """No shot follows what is left."""
        while self._waiting:
            if (settled := self._waiting.popleft().settled) is not None:
                settled(None, None)
