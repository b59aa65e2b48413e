"""When a simulator's truth is expected, so that it finds the process awake and the shot fresh in the caches."""

from __future__ import annotations

from typing import NamedTuple

_SHOTS_AROUND = 2
"""The window opens so many times the time of a shot before truth: room for a rehearsal, and for truth that is early."""

_INERTIA = 8
"""A truth moves the expectation by one part in so many of what it is off by."""


class Window(NamedTuple):
    """Instants of the monotonic clock between which truth is expected."""

    opens_ns: int
    closes_ns: int

    def holds(self, now_ns: int) -> bool:
        """Whether it is open."""
        return self.opens_ns <= now_ns < self.closes_ns


_NEVER = Window(0, 0)


class ArrivalPredictor:
    """Expects the truth of each shot as long before its packet is due as it came for the last ones.

    Args:
        most_ns: the longest time to be awake before truth comes, and after it should have come; 0: never.
    """

    def __init__(self, most_ns: int) -> None:
        self._most_ns = most_ns
        self._after_due_ns: int | None = None
        self._shot_took_ns = 0

    def window(self, due_ns: int) -> Window:
        """Around the truth of a shot whose packet is due then; never, before the first was seen."""
        if self._after_due_ns is None:
            return _NEVER
        expected_ns = due_ns + self._after_due_ns
        around_ns = min(_SHOTS_AROUND * self._shot_took_ns, self._most_ns)
        return Window(expected_ns - around_ns, expected_ns + around_ns)

    @property
    def has_time_to_rehearse(self) -> bool:
        """Whether a shot computed as the window opens is over well before truth comes."""
        return _SHOTS_AROUND * self._shot_took_ns <= self._most_ns

    def learn(self, due_ns: int, arrived_ns: int, shot_took_ns: int) -> None:
        """Take into account when a truth arrived, and how long its shot took to compute."""
        found_ns = arrived_ns - due_ns
        if self._after_due_ns is None:
            self._after_due_ns = found_ns
        self._after_due_ns += (found_ns - self._after_due_ns) // _INERTIA
        self._shot_took_ns = shot_took_ns
