"""Lateness of packets, over a run and second by second, in constant memory; and the steal time of a virtual machine."""

from __future__ import annotations

from array import array
from math import ceil
from pathlib import Path

_EXACT_BITS = 8  # up to 2**8 ns every value has its own bucket
_HALF = 1 << (_EXACT_BITS - 1)  # above, each power of two is cut into this many: 1/128 is the resolution
_VALUE_BITS = 63
_BUCKETS = (_VALUE_BITS - _EXACT_BITS + 2) * _HALF
_STEAL_FIELD = 8
WINDOW_NS = 1_000_000_000


class LatenessHistogram:
    """Counts of integer nanoseconds in log-linear buckets, as in an HDR histogram.

    Every bucket is narrower than 1/128 of its values; count and maximum are exact. One long stall stays
    visible as the maximum and in the high quantiles, which a mean would hide.
    """

    def __init__(self) -> None:
        self._counts = array("Q", bytes(8 * _BUCKETS))
        self.count = 0
        self.max_ns: int | None = None

    def add(self, lateness_ns: int) -> None:
        """Count one value.

        Raises:
            ValueError: it is negative or does not fit 63 bits.
        """
        if not 0 <= lateness_ns < 1 << _VALUE_BITS:
            raise ValueError(f"a lateness of {lateness_ns} ns is out of range")
        self._counts[_bucket_of(lateness_ns)] += 1
        self.count += 1
        self.max_ns = lateness_ns if self.max_ns is None else max(self.max_ns, lateness_ns)

    def quantile_ns(self, fraction: float) -> int | None:
        """The smallest value that at least `fraction` of all values do not exceed, rounded up to the end of its bucket
        (by less than 1/128); None without values."""
        if self.max_ns is None:
            return None
        rank = max(1, ceil(fraction * self.count))
        seen = 0
        for bucket, count in enumerate(self._counts):
            seen += count
            if seen >= rank:
                return min(_last_value_of(bucket), self.max_ns)
        return self.max_ns

    def summary(self) -> dict[str, int | None]:
        """Count, p50, p99, p99.9 and maximum."""
        return {
            "count": self.count,
            "p50_ns": self.quantile_ns(0.5),
            "p99_ns": self.quantile_ns(0.99),
            "p99_9_ns": self.quantile_ns(0.999),
            "max_ns": self.max_ns,
        }


class RollingLateness:
    """The p99 of each window of one second of due times: the median and the worst second of a run.

    One quantile over a whole run cannot distinguish a bad minute from a steady trickle of late packets. Due times must
    not fall back into a window that has ended.
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
        """Number of windows with packets, median and maximum of their p99, and when the worst one began."""
        self._end_window()
        worst_ns, worst_at_s = self._worst or (None, None)
        return {
            "count": self._p99.count,
            "p99_median_ns": self._p99.quantile_ns(0.5),
            "p99_worst_ns": worst_ns,
            "worst_at_s": worst_at_s,
        }


def _bucket_of(value: int) -> int:
    shift = max(0, value.bit_length() - _EXACT_BITS)
    return shift * _HALF + (value >> shift)


def _last_value_of(bucket: int) -> int:
    shift = max(0, bucket // _HALF - 1)
    return ((bucket - shift * _HALF + 1) << shift) - 1


def steal_ticks(stat: Path = Path("/proc/stat")) -> int | None:
    """Ticks (1/100 s) that the host of this virtual machine gave to other machines since it started, over all cores.

    None where the system does not count them. On a virtual machine, lateness must be judged beside them.
    """
    try:
        fields = stat.read_text().splitlines()[0].split()
        return int(fields[_STEAL_FIELD])
    except (OSError, IndexError, ValueError):
        return None
