"""The end of a run, in which what was sent is still on its way."""

from __future__ import annotations

SETTLE_NS = 20_000_000
"""How long a line must look empty."""


class Drain:
    """The time at the end in which the other end still reads what was sent; it begins at once."""

    def __init__(self, now_ns: int, limit_ns: int) -> None:
        self._ends_ns = now_ns + limit_ns
        self._busy_ns = now_ns

    def is_over(self, busy: bool, now_ns: int) -> bool:
        """Whether nothing is on its way any more, or the other end was given long enough."""
        if busy:
            self._busy_ns = now_ns
        # Bytes on their way through a pty are counted nowhere for a moment: it must look empty for a while.
        return now_ns - self._busy_ns >= SETTLE_NS or now_ns >= self._ends_ns
