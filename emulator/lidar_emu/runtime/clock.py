"""The only file that reads a clock."""

from __future__ import annotations

import select
import struct
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import NamedTuple

_NS_PER_S = 1_000_000_000
_COARSE_ABOVE_NS = 2_000_000
_FINE_REST_NS = 1_000_000
_LONGEST_WAIT_NS = 3600 * _NS_PER_S


_TIMEX_BYTES = 208
_MAX_ERROR, _STATUS = struct.Struct("@24xl"), struct.Struct("@40xi")  # of struct timex, adjtimex(2)
_STA_UNSYNC = 0x40


class SystemTime(NamedTuple):
    """The wall clock, and what the kernel says of it."""

    ahead_ns: int
    """What it is ahead of the monotonic clock."""
    uncertainty_ns: int
    synchronised: bool
    max_error_us: int
    """Maximum error, as the program that keeps the clock stated it, and 500 us more each second since."""


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
        """What the wall clock is ahead of the monotonic clock now."""
        return _utc_ahead_ns()[0]

    def system_time(self) -> SystemTime:
        """The wall clock now, which is read and never set. On Linux."""
        import ctypes

        timex = ctypes.create_string_buffer(_TIMEX_BYTES)  # Its first field, 0, asks for no change.
        ctypes.CDLL(None).adjtimex(timex)
        (max_error_us,), (status,) = _MAX_ERROR.unpack_from(timex), _STATUS.unpack_from(timex)
        return SystemTime(*_utc_ahead_ns(), not status & _STA_UNSYNC, max_error_us)

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


def _utc_ahead_ns() -> tuple[int, int]:
    """What the wall clock is ahead of the monotonic clock, by the quickest of three readings, and how long it took."""
    readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(3)]
    before_ns, utc_ns, after_ns = min(readings, key=lambda reading: reading[2] - reading[0])
    return utc_ns - (before_ns + after_ns) // 2, after_ns - before_ns


_GROWTH_US_PER_S = 500
_SHORT_OF_GROWTH_US = 750


class Discipline:
    """Finds out from the kernel's maximum error whether a program still keeps the wall clock.

    The error grows by 500 us each second, in one step (NTP, RFC 5905: 500 ppm), and falls with each update. Where it is
    one and a half steps short of that growth there was an update. The kernel's own flag follows hours later.

    Args:
        holdover_ns: time after an update until which the clock counts as kept; None: as long as the kernel's flag says.
    """

    def __init__(self, holdover_ns: int | None) -> None:
        self._holdover_ns = holdover_ns
        self._updated: tuple[int, int] | None = None
        self.since_ns: int | None = None
        """Instant since which the clock is kept; None: it is not."""

    def update(self, now_ns: int, system: SystemTime) -> None:
        """Take note of a reading."""
        if self._updated is None or system.max_error_us < self._grown_us(now_ns) - _SHORT_OF_GROWTH_US:
            self._updated = now_ns, system.max_error_us
        held = self._holdover_ns is None or now_ns - self._updated[0] <= self._holdover_ns
        if not (system.synchronised and held):
            self.since_ns = None
        elif self.since_ns is None:
            self.since_ns = now_ns

    def _grown_us(self, now_ns: int) -> float:
        assert self._updated is not None
        updated_ns, max_error_us = self._updated
        return max_error_us + _GROWTH_US_PER_S * (now_ns - updated_ns) / _NS_PER_S
