"""Lateness statistics of emulator and control process, and the emulator's own contribution."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from lidar_emu.numerics.arrays import BoolArray, IntArray

WINDOW_NS = 1_000_000_000
NEVER = -1
QUANTILES = {"p50_ns": 0.5, "p99_ns": 0.99, "p99_9_ns": 0.999, "max_ns": 1.0}


@dataclass(frozen=True)
class Side:
    """Instants of the emulator or of the control process, in the order of its shots: arrays of shape (shots,).

    All count in nanoseconds from the start of the run; `NEVER` where it did not happen.
    """

    due_ns: IntArray
    woke_ns: IntArray
    """When the process woke up for the shot."""
    written_ns: IntArray
    """When the write returned."""
    received_ns: IntArray
    """When the reader at the other end of the pty received it."""
    late: BoolArray
    """Shots that were skipped because they were too late."""

    def wake_up_ns(self) -> IntArray:
        """Lateness of waking up for all shots, including skipped ones."""
        return self._after_due(self.woke_ns)

    def due_to_written_ns(self) -> IntArray:
        """Lateness of the write for shots that were written."""
        return self._after_due(self.written_ns)

    def due_to_received_ns(self) -> IntArray:
        """Lateness of reception for shots that were received."""
        return self._after_due(self.received_ns)

    def _after_due(self, instant_ns: IntArray) -> IntArray:
        happened = instant_ns != NEVER
        lateness_ns: IntArray = np.maximum(0, instant_ns[happened] - self.due_ns[happened])
        return lateness_ns

    def where(self, chosen: BoolArray) -> Side:
        """The chosen shots."""
        return Side(*(getattr(self, each.name)[chosen] for each in fields(self)))


@dataclass(frozen=True)
class SecondComparison:
    """One second of due times: emulator and control process."""

    at_s: int
    """Start of the second."""
    p99_ns: int | None
    """p99 of the emulator's due-to-written; None if nothing was written."""
    control_p99_ns: int | None
    late: int
    control_late: int


def quantile_ns(values_ns: IntArray, fraction: float) -> int | None:
    """The smallest value that at least `fraction` of all do not exceed; None without values."""
    if not values_ns.size:
        return None
    return int(np.quantile(values_ns, fraction, method="inverted_cdf"))


def figures(values_ns: IntArray) -> dict[str, int | None]:
    """Count, p50, p99, p99.9 and maximum."""
    return {"count": values_ns.size} | {
        name: quantile_ns(values_ns, fraction) for name, fraction in QUANTILES.items()
    }


def windows(emulator: Side, control: Side) -> list[SecondComparison]:
    """Both sides, second by second; the last is left out if it holds less than half of a second's shots."""
    parts, control_parts = _full_seconds(emulator), _full_seconds(control)
    return [
        SecondComparison(
            second,
            quantile_ns(part.due_to_written_ns(), 0.99),
            quantile_ns(control_part.due_to_written_ns(), 0.99),
            int(part.late.sum()),
            int(control_part.late.sum()),
        )
        for second, part in parts.items()
        if (control_part := control_parts.get(second)) is not None
    ]


def _full_seconds(side: Side) -> dict[int, Side]:
    seconds = side.due_ns // WINDOW_NS
    names, counts = np.unique(seconds, return_counts=True)
    full = names[2 * counts >= counts.max(initial=0)]
    return {int(second): side.where(seconds == second) for second in full}


def median_excess_ns(of: list[SecondComparison]) -> float | None:
    """Median over seconds of the emulator's p99 minus the control's: the emulator's own contribution.

    A host that suspends the machine for a while affects both sides, or one of them in a second or two.
    """
    pairs = [(window.p99_ns, window.control_p99_ns) for window in of]
    excess = [ours - theirs for ours, theirs in pairs if ours is not None and theirs is not None]
    return float(np.median(excess)) if excess else None


def late_without_control(of: list[SecondComparison]) -> int:
    """Late shots in seconds in which the control process had none."""
    return sum(window.late for window in of if not window.control_late)


def histogram_edges_ns(*sides: IntArray) -> IntArray:
    """Edges in steps 1, 2, 5, from below the least to above the greatest of all values; at least two."""
    values = np.concatenate(sides)
    steps = np.array([digit * 10**power for power in range(3, 12) for digit in (1, 2, 5)], dtype=np.int64)
    if not values.size:
        return steps[:2]
    least = max(0, int(np.searchsorted(steps, values.min(), "right")) - 1)
    greatest = int(np.searchsorted(steps, values.max(), "right"))
    return np.concatenate(([0] if values.min() < steps[0] else [], steps[least : greatest + 1])).astype(
        np.int64
    )


def counts_between(values_ns: IntArray, edges_ns: IntArray) -> IntArray:
    """How many values lie in [edge, next edge), shape (edges - 1,)."""
    return np.diff(np.searchsorted(np.sort(values_ns), edges_ns, "left")).astype(np.int64)
