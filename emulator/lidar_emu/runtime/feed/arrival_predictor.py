"""Predicts when a simulator's truth arrives, so that the process is awake and the shot's data are in the caches."""

from __future__ import annotations

from typing import NamedTuple

_SHOTS_AROUND = 2
"""The window opens and closes this many times the computing time of a shot around the predicted arrival: room for a
warm-up, and for truth that is early."""

_INERTIA = 8
"""Each arrival moves the prediction by 1 / `_INERTIA` of its deviation."""


class ArrivalWindow(NamedTuple):
    """Instants of the monotonic clock between which truth is expected."""

    opens_ns: int
    closes_ns: int

    def contains(self, now_ns: int) -> bool:
        """Whether the window is open."""
        return self.opens_ns <= now_ns < self.closes_ns


_NEVER = ArrivalWindow(0, 0)


class ArrivalPredictor:
    """Predicts when each shot's truth arrives: as long before its packet is due as for the last shots.

    Args:
        longest_ns: longest busy wait before and after the predicted arrival; 0: none.
    """

    def __init__(self, longest_ns: int) -> None:
        self._longest_ns = longest_ns
        self._after_due_ns: int | None = None
        self._computing_ns = 0

    def window(self, due_ns: int) -> ArrivalWindow:
        """Window of the truth of a shot whose packet is due at `due_ns`; empty before the first arrival."""
        if self._after_due_ns is None:
            return _NEVER
        predicted_ns = due_ns + self._after_due_ns
        around_ns = min(_SHOTS_AROUND * self._computing_ns, self._longest_ns)
        return ArrivalWindow(predicted_ns - around_ns, predicted_ns + around_ns)

    @property
    def has_time_to_warm_up(self) -> bool:
        """Whether a shot computed as the window opens is complete well before truth arrives."""
        return _SHOTS_AROUND * self._computing_ns <= self._longest_ns

    def update(self, due_ns: int, arrived_ns: int, computing_ns: int) -> None:
        """Take into account when truth arrived, and how long its shot took to compute."""
        after_due_ns = arrived_ns - due_ns
        if self._after_due_ns is None:
            self._after_due_ns = after_due_ns
        self._after_due_ns += (after_due_ns - self._after_due_ns) // _INERTIA
        self._computing_ns = computing_ns
