"""The only file that reads a clock."""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from datetime import UTC, datetime

_NS_PER_S = 1_000_000_000
_COARSE_ABOVE_NS = 2_000_000
_FINE_REST_NS = 1_000_000
_LONGEST_WAIT_NS = 3600 * _NS_PER_S


class Clock:
    """The clocks of the machine. Times are integer nanoseconds of the monotonic clock, which all processes share."""

    def now_ns(self) -> int:
        """Present instant of the monotonic clock."""
        return time.monotonic_ns()

    def processor_time_ns(self) -> int:
        """Processor time of this process, all its threads together."""
        return time.process_time_ns()

    def utc_now(self) -> datetime:
        """Present time of the wall clock, in UTC."""
        return datetime.now(UTC)

    def utc_ahead_ns(self) -> int:
        """What the wall clock is ahead of the monotonic clock now, by the quickest of three readings."""
        readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(3)]
        before_ns, utc_ns, after_ns = min(readings, key=lambda reading: reading[2] - reading[0])
        return utc_ns - (before_ns + after_ns) // 2

    def wait(
        self,
        until_ns: int | None,
        readable: Sequence[int] = (),
        writable: Sequence[int] = (),
        busy_wait: bool = False,
    ) -> tuple[list[int], list[int]]:
        """Sleep until an instant, or until one of the descriptors is ready; return the ready ones.

        Never returns early without a ready descriptor. Without an instant it waits for descriptors alone.

        Args:
            busy_wait: poll instead of sleeping, where the latency of a wake-up would be too long.
        """
        left_ns = None if until_ns is None else max(0, until_ns - self.now_ns())
        while True:
            ready, writable_now, _ = select.select(
                readable, writable, (), 0.0 if busy_wait else _timeout_s(left_ns)
            )
            if ready or writable_now:
                return ready, writable_now
            if until_ns is not None and (left_ns := until_ns - self.now_ns()) <= 0:
                return ready, writable_now


def _timeout_s(left_ns: int | None) -> float | None:
    if left_ns is None:
        return None
    # The kernel may round a wait by a thousandth of its length: the last millisecond is waited for separately.
    timeout_ns = left_ns - _FINE_REST_NS if left_ns > _COARSE_ABOVE_NS else left_ns
    # System calls cannot express a timeout of centuries.
    return min(timeout_ns, _LONGEST_WAIT_NS) / _NS_PER_S
