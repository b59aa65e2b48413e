"""Lateness by the second: a run's median and worst second, in constant memory."""

from __future__ import annotations

from lidar_emu.runtime.lateness import LatenessHistogram

WINDOW_NS = 1_000_000_000


class RollingLateness:
    """The p99 of each window of one second of due times.

    Where one quantile over a whole run tells a bad minute from an even trickle of late packets by nothing, these do.
    Due times must not fall back into a window that has ended.
    """

    def __init__(self) -> None:
        self._window = LatenessHistogram()
        self._number: int | None = None
        self._p99 = LatenessHistogram()
        self._worst: tuple[int, int] | None = None

    def add(self, due_ns: int, lateness_ns: int) -> None:
        """Count the lateness of a packet."""
        number = due_ns // WINDOW_NS
        if number != self._number:
            self._end_window()
            self._number = number
        self._window.add(lateness_ns)

    def _end_window(self) -> None:
        p99_ns = self._window.quantile_ns(0.99)
        if p99_ns is None or self._number is None:
            return
        self._p99.add(p99_ns)
        if self._worst is None or p99_ns > self._worst[0]:
            self._worst = p99_ns, self._number
        self._window = LatenessHistogram()

    def summary(self) -> dict[str, int | None]:
        """How many windows had packets, the median and the greatest of their p99, and when the worst began."""
        self._end_window()
        worst_ns, worst_at_s = self._worst or (None, None)
        return {
            "count": self._p99.count,
            "p99_median_ns": self._p99.quantile_ns(0.5),
            "p99_worst_ns": worst_ns,
            "worst_at_s": worst_at_s,
        }
