"""The summary of a run: counted while it runs, written at its end."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import FloatArray
from lidar_emu.receiver.returns import FalseTarget, Reason
from lidar_emu.runtime.port.packets import DeliveryReport, DeliveryStatus, Pace
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.shots.model import Model

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
        shift = max(0, lateness_ns.bit_length() - _EXACT_BITS)
        self._counts[shift * _HALF + (lateness_ns >> shift)] += 1
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
                shift = max(0, bucket // _HALF - 1)
                last_ns = ((bucket - shift * _HALF + 1) << shift) - 1
                return min(last_ns, self.max_ns)
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


def steal_ticks(stat: Path = Path("/proc/stat")) -> int | None:
    """Ticks (1/100 s) that the host of this virtual machine gave to other machines since it started, over all cores.

    None where the system does not count them. On a virtual machine, lateness must be judged beside them.
    """
    try:
        fields = stat.read_text().splitlines()[0].split()
        return int(fields[_STEAL_FIELD])
    except (OSError, IndexError, ValueError):
        return None


_DROPS = {
    DeliveryStatus.DROPPED_FULL: "full",
    DeliveryStatus.DROPPED_NOBODY: "nobody_connected",
    DeliveryStatus.DROPPED_BROKEN: "broken",
}


@dataclass
class ErrorStatistics:
    """Moments of an error."""

    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0

    def add(self, error: FloatArray) -> None:
        """Add errors; NaN is ignored."""
        known = error[np.isfinite(error)]
        if known.size:
            self.count += known.size
            self.total += float(known.sum())
            self.squares += float((known**2).sum())
            self.largest = max(self.largest, float(np.abs(known).max()))

    def to_json(self) -> dict[str, float | int | None]:
        """Count, mean, root mean square and largest magnitude."""
        if not self.count:
            return {"count": 0, "mean": None, "rms": None, "max": None}
        mean, rms = self.total / self.count, float(np.sqrt(self.squares / self.count))
        return {"count": self.count, "mean": mean, "rms": rms, "max": self.largest}


@dataclass
class Tally:
    """Counts of a run in constant memory."""

    pace: Pace
    polled: bool = False
    """Whether packets wait for the host, which makes none of them late."""
    statuses: Counter[DeliveryStatus] = field(default_factory=Counter)
    lateness: LatenessHistogram = field(default_factory=LatenessHistogram)
    windows: RollingLateness = field(default_factory=RollingLateness)
    range_error_m: ErrorStatistics = field(default_factory=ErrorStatistics)
    speed_error_mps: ErrorStatistics = field(default_factory=ErrorStatistics)
    reasons: list[Counter[int]] = field(default_factory=list)
    false_targets: Counter[int] = field(default_factory=Counter)
    """Valid measurements with a peak that is not the surface's, by its source."""
    faults: Counter[str] = field(default_factory=Counter)
    """Shots that a fault affected, by its kind."""
    silent: int = 0
    """Shots that the device did not fire, because of its mode or its rate."""

    def add_measurement(self, block: Measurement) -> None:
        """Add shots whose delivery status is known."""
        self.range_error_m.add((block.range_m - block.true_range_m)[block.range_valid])
        self.speed_error_mps.add((block.closing_speed_mps - block.true_closing_speed_mps)[block.speed_valid])
        if not self.reasons:
            self.reasons = [Counter() for _ in range(block.beam_count)]
        for beam, counts in enumerate(self.reasons):
            counts.update(block.reason[:, beam].tolist())
        self.false_targets.update(
            block.true_peak_source[block.range_valid & (block.true_peak_source > 0)].tolist()
        )

    def add_report(self, report: DeliveryReport, silent: bool = False) -> None:
        """Count the delivery status of a packet; `silent`: the device sent none."""
        self.statuses[report.status] += 1
        self.silent += silent and report.status is DeliveryStatus.SUPPRESSED
        if report.status is DeliveryStatus.SENT and self.pace is Pace.WALL and not self.polled:
            lateness_ns = max(0, report.sent_ns - report.due_ns)
            self.lateness.add(lateness_ns)
            self.windows.add(report.due_ns, lateness_ns)

    @property
    def due(self) -> int:
        """Packets whose delivery status is known."""
        return self.statuses.total()

    @property
    def sent(self) -> int:
        """Packets that the link took."""
        return self.statuses[DeliveryStatus.SENT]

    @property
    def late(self) -> int:
        """Packets skipped because they were late."""
        return self.statuses[DeliveryStatus.LATE]

    @property
    def dropped(self) -> int:
        """Packets that the link did not take."""
        return sum(self.statuses[status] for status in _DROPS)

    def to_json(self) -> dict[str, Any]:
        """The counts, by the keys of the summary file."""
        return {
            "shots": {
                "due": self.due,
                "sent": self.sent,
                "late": self.late,
                "suppressed": self.silent,
                "not_polled": self.statuses[DeliveryStatus.NOT_POLLED],
                "dropped": {name: self.statuses[status] for status, name in _DROPS.items()},
            },
            "lateness": {**self.lateness.summary(), "windows": self.windows.summary()},
            "beams": [
                {Reason(code).name.lower(): count for code, count in sorted(counts.items())}
                for counts in self.reasons
            ],
            "false_targets": {
                FalseTarget(code).name.lower(): count for code, count in sorted(self.false_targets.items())
            },
            "faults": {
                "shots": dict(sorted(self.faults.items())),
                "suppressed": self.statuses[DeliveryStatus.SUPPRESSED] - self.silent,
                "held": self.statuses[DeliveryStatus.HELD],
            },
            "range_error_m": self.range_error_m.to_json(),
            "speed_error_mps": self.speed_error_mps.to_json(),
        }


class HostMessageTally:
    """Counts of one kind of message of the host.

    Args:
        sequence_steps: number of sequence numbers, after which they wrap.
    """

    def __init__(self, sequence_steps: int) -> None:
        self._steps, self._last = sequence_steps, -1
        self._verdicts: Counter[str] = Counter()
        self._lost = 0

    def add(self, sequence: int | None, verdict: str) -> None:
        """Count a message; a gap of less than half a cycle before it is counted as lost messages."""
        self._verdicts[verdict] += 1
        if sequence is None:
            return
        missing = (sequence - self._last - 1) % self._steps
        if self._last >= 0 and missing < self._steps // 2:
            self._lost += missing
        self._last = sequence

    def to_json(self) -> dict[str, Any]:
        """The counts, by the keys of the summary file."""
        rejected = {word: count for word, count in sorted(self._verdicts.items()) if word != "accepted"}
        return {"accepted": self._verdicts["accepted"], "rejected": rejected, "lost": self._lost}


@dataclass
class Outcome:
    """Result of a run."""

    tally: Tally
    details: dict[str, Any]
    error: str | None
    """Why the run ended early, if that is an error."""

    def to_json(self) -> dict[str, Any]:
        """The summary file."""
        return {**self.details, **self.tally.to_json()}


def planned_summary(scenario: FlightScenario | BenchScenario, model: Model) -> dict[str, Any]:
    """The part of the summary that is known before the run, by the keys of the summary file."""
    has_end = scenario.live is None or scenario.duration_s is not None  # otherwise the simulator decides
    return {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "epoch": scenario.timing.epoch.isoformat(),
        "rate_hz": scenario.timing.rate_hz,
        "planned_shots": model.shot_count if has_end else None,
        **_expectation(scenario, model),
        "left_out": [row for row in model.plan.rows() if not row["computed"]],
    }


def _expectation(scenario: FlightScenario | BenchScenario, model: Model) -> dict[str, Any]:
    """Expected errors by closed forms, by the keys of the summary file; null for a bench pattern and for a flight
    that is not known yet."""
    names = ("expected_range_error_m", "expected_speed_error_mps", "expected_dropout")
    if scenario.live or not isinstance(scenario, FlightScenario) or model.flight is None:
        return dict.fromkeys(names)
    from lidar_emu.plan.expected_error import expected_error

    expected = expected_error(scenario, model.flight, model.plan.beamlets).to_json()
    values = (
        {"mean": expected["range_bias_m"], "rms": expected["range_rms_m"]},
        {"mean": expected["speed_bias_mps"], "rms": expected["speed_rms_mps"]},
        expected["dropout"],
    )
    return dict(zip(names, values, strict=True))
