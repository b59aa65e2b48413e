"""What happened in a run, as lines over time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lidar_emu.fmcw.reasons import Reason
from lidar_emu.measurement import Measurement
from lidar_emu.numerics.arrays import BoolArray
from lidar_emu.recording.json_messages import JsonMessage
from lidar_emu.report.recorded_run import RecordedRun

_LONG_AGO_NS = np.iinfo(np.int64).min // 2


class Event(NamedTuple):
    """A line."""

    time_ns: int
    """Scenario time."""
    level: str
    """INFO, WARN or ERROR."""
    text: str


class EventFinder:
    """Finds the events in the parts of a run, in order."""

    def __init__(self) -> None:
        self._was_valid: BoolArray | bool = True
        self._acted_ns: dict[str, int] = {}

    def next_events(self, run: RecordedRun) -> list[Event]:
        """Beams that are lost and found, faults, commands, and events of the link and of the processes, in order.

        Args:
            run: what follows the part before.
        """
        return sorted([*self._lost_beams(run.measurement), *self._faults(run), *_messages(run)])

    def _lost_beams(self, measured: Measurement) -> Iterator[Event]:
        """Beams whose ranges become invalid, with the reason, and valid again."""
        before = np.broadcast_to(self._was_valid, (1, measured.beam_count))
        valid = np.concatenate([before, measured.range_valid])
        self._was_valid = valid[-1]
        for shot, beam in np.argwhere(np.diff(valid, axis=0)).tolist():
            time_ns = int(measured.time_ns[shot, beam])
            if measured.range_valid[shot, beam]:
                yield Event(time_ns, "INFO", f"beam {beam}: valid")
            else:
                reason = Reason(measured.reason[shot, beam]).name.lower()
                yield Event(time_ns, "WARN", f"beam {beam}: {reason}")

    def _faults(self, run: RecordedRun) -> Iterator[Event]:
        """The first shot of each time that a fault acts: shots that follow one another are one time."""
        apart_ns = 1.5e9 / run.recording.scenario.timing.rate_hz
        for kind, times_ns in run.faults_ns.items():
            acted_ns = np.unique(times_ns)
            first = np.diff(acted_ns, prepend=self._acted_ns.get(kind, _LONG_AGO_NS)) > apart_ns
            self._acted_ns[kind] = int(acted_ns[-1])
            for time_ns in acted_ns[first].tolist():
                yield Event(time_ns, "ERROR", f"fault: {kind}")


def _messages(run: RecordedRun) -> Iterator[Event]:
    for level, what, messages in (
        ("ERROR", "injected", run.injected_faults),
        ("INFO", "command", run.commands),
        ("INFO", "event", run.events),
    ):
        for message in messages:
            yield Event(message.time_ns, level, f"{what}: {_text(message)}")


def _text(message: JsonMessage) -> str:
    return ", ".join(f"{name} {value}" for name, value in message.values.items() if value not in (None, {}))
