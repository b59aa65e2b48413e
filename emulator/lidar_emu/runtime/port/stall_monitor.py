"""Detects that one of a run's two processes stalls: stopped, starved of processor time, or blocked in a driver."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from lidar_emu.runtime.clock import Clock

STALL_NS = 100_000_000
"""Shortest stall that is reported."""

OnStall = Callable[[int, str], None]
"""Receives the time, in nanoseconds from the start of the run, and a description of the event."""


class StallMonitor:
    """Runs in the model process, which polls it several times in `STALL_NS` unless it computes.

    The port process reports every packet as soon as it is due, sent or not. The model process computes or sleeps for
    short times only: time between two polls in which it had no processor time is a stall of the model process.

    Args:
        on_stall: called when the port process stalls, when it resumes, and after a stall of the model process.
    """

    def __init__(self, clock: Clock, on_stall: OnStall | None) -> None:
        self._clock = clock
        self._on_stall = on_stall or _ignore
        self._unreported_due_ns: deque[int] = deque()
        self._reported = 0
        self._start_ns: int | None = None
        self._polled_ns = self._processor_time_ns = 0
        self._overdue_after = -1
        self._overdue_since_ns = 0
        self._silent_since_ns: int | None = None

    def begin(self, start_ns: int) -> None:
        """Start monitoring a run that keeps pace with the wall clock.

        Args:
            start_ns: start of the run, an instant of the monotonic clock.
        """
        self._start_ns = start_ns
        self._polled_ns, self._processor_time_ns = (
            self._clock.now_ns() - start_ns,
            self._clock.processor_time_ns(),
        )

    def pushed(self, due_ns: int) -> None:
        """Count a packet that was pushed to the port process."""
        self._unreported_due_ns.append(due_ns)

    def reported(self, count: int) -> None:
        """Count packets that the port process has reported."""
        self._reported += count
        for _ in range(count):
            self._unreported_due_ns.popleft()

    def poll(self) -> None:
        """Check both processes; call after all available reports were counted."""
        if self._start_ns is None:
            return
        now_ns = self._clock.now_ns() - self._start_ns
        self._check_port(now_ns)
        self._check_model(now_ns)

    def _check_port(self, now_ns: int) -> None:
        due_ns = self._unreported_due_ns[0] if self._unreported_due_ns else now_ns
        if due_ns >= now_ns or self._overdue_after != self._reported:
            # A packet that is overdue for the first time counts from now: it may have been pushed just now.
            self._overdue_after, self._overdue_since_ns = self._reported if due_ns < now_ns else -1, now_ns
            if self._silent_since_ns is not None:
                silent_ms = (now_ns - self._silent_since_ns) / 1e6
                self._silent_since_ns = None
                self._on_stall(now_ns, f"the port process responds again, after {silent_ms:.0f} ms")
        elif self._silent_since_ns is None and now_ns - self._overdue_since_ns > STALL_NS:
            self._silent_since_ns = self._overdue_since_ns
            self._on_stall(now_ns, "the port process does not respond")

    def _check_model(self, now_ns: int) -> None:
        processor_time_ns = self._clock.processor_time_ns()
        stalled_ns = now_ns - self._polled_ns - (processor_time_ns - self._processor_time_ns)
        self._polled_ns, self._processor_time_ns = now_ns, processor_time_ns
        if stalled_ns > STALL_NS:
            self._on_stall(now_ns, f"the model process stalled for {stalled_ns / 1e6:.0f} ms")


def _ignore(time_ns: int, text: str) -> None:
    """Without a callback, stalls are not reported."""
