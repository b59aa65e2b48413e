"""What happened to the link, however often it happened."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

_KEPT_AT_EACH_END = 10


@dataclass(frozen=True)
class LinkEvent:
    """Something that happened to the link."""

    time_ns: int
    """From the start of the run."""
    text: str


def told(whose: str, count: int, events: Sequence[LinkEvent]) -> dict[str, Any]:
    """Events under the names of the summary file."""
    return {
        f"{whose}_event_count": count,
        f"{whose}_events": [{"time_s": event.time_ns * 1e-9, "what": event.text} for event in events],
    }


class EventLog:
    """The first and the last ten events, and the count of all: a link that flaps for hours costs no memory.

    Times are of the monotonic clock.
    """

    def __init__(self) -> None:
        self.count = 0
        """How many there were, with those that are not kept."""
        self._first: list[tuple[int, str]] = []
        self._last: deque[tuple[int, str]] = deque(maxlen=_KEPT_AT_EACH_END)

    def add(self, number: int, time_ns: int, text: str) -> None:
        """Note event `number`, counted from 1; numbers that never come are events that were lost on the way."""
        self.count = number
        kept = self._first if len(self._first) < _KEPT_AT_EACH_END else self._last
        kept.append((time_ns, text))

    def since(self, start_ns: int) -> list[LinkEvent]:
        """The events that were kept, with times from `start_ns`."""
        return [LinkEvent(time_ns - start_ns, text) for time_ns, text in (*self._first, *self._last)]
