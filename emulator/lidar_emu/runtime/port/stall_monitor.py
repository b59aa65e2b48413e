"""Notices when one of a run's two processes stands still: stopped, starved, or caught in a driver."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from lidar_emu.runtime.clock import Clock

STANDSTILL_NS = 100_000_000
"""How long a process may stand still before that is worth a word."""

Notice = Callable[[int, str], None]
"""Told of what happened, and when, in nanoseconds from the start of the run."""


class Watch:
    """In the model's process, which looks several times in `STANDSTILL_NS` unless it computes.

    The port's process reports every packet as soon as it is due, sent or not. The model's process computes or
    sleeps for a moment: time that passed between two looks without being computed in was not its own.

    Args:
        notice: told when the port's process is silent, when it answers again, and when the model's was away.
    """

    def __init__(self, clock: Clock, notice: Notice | None) -> None:
        self._clock = clock
        self._tell = notice or _nobody
        self._unreported_due_ns: deque[int] = deque()
        self._reported = 0
        self._start_ns: int | None = None
        self._looked_ns = self._computed_ns = 0
        self._waits_for = -1
        self._waits_since_ns = 0
        self._silent_since_ns: int | None = None

    def begin(self, start_ns: int) -> None:
        """The run keeps the pace of the clock, from this instant of the monotonic clock on."""
        self._start_ns = start_ns
        self._looked_ns, self._computed_ns = self._clock.now_ns() - start_ns, self._clock.computed_ns()

    def pushed(self, due_ns: int) -> None:
        """A packet was handed to the port's process."""
        self._unreported_due_ns.append(due_ns)

    def reported(self, count: int) -> None:
        """It has reported so many packets."""
        self._reported += count
        for _ in range(count):
            self._unreported_due_ns.popleft()

    def look(self) -> None:
        """After all reports that are there have been counted."""
        if self._start_ns is None:
            return
        now_ns = self._clock.now_ns() - self._start_ns
        self._look_at_the_port(now_ns)
        self._look_at_ourselves(now_ns)

    def _look_at_the_port(self, now_ns: int) -> None:
        due_ns = self._unreported_due_ns[0] if self._unreported_due_ns else now_ns
        if due_ns >= now_ns or self._waits_for != self._reported:
            # A packet that is overdue for the first time counts from now: it may have been pushed just now.
            self._waits_for, self._waits_since_ns = self._reported if due_ns < now_ns else -1, now_ns
            if self._silent_since_ns is not None:
                silent_ms = (now_ns - self._silent_since_ns) / 1e6
                self._silent_since_ns = None
                self._tell(now_ns, f"the port's process answers again, after {silent_ms:.0f} ms")
        elif self._silent_since_ns is None and now_ns - self._waits_since_ns > STANDSTILL_NS:
            self._silent_since_ns = self._waits_since_ns
            self._tell(now_ns, "the port's process does not answer")

    def _look_at_ourselves(self, now_ns: int) -> None:
        computed_ns = self._clock.computed_ns()
        away_ns = now_ns - self._looked_ns - (computed_ns - self._computed_ns)
        self._looked_ns, self._computed_ns = now_ns, computed_ns
        if away_ns > STANDSTILL_NS:
            self._tell(now_ns, f"the model's process stood still for {away_ns / 1e6:.0f} ms")


def _nobody(time_ns: int, text: str) -> None:
    """Whom nobody listens to."""
