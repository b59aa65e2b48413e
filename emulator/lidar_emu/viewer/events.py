"""What happened in a run, as lines over time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lidar_emu.fmcw.reasons import Reason
from lidar_emu.measurement import Measurement
from lidar_emu.recording.json_messages import JsonMessage
from lidar_emu.report.recorded_run import RecordedRun


class Event(NamedTuple):
    """A line."""

    time_ns: int
    """Scenario time."""
    level: str
    """INFO, WARN or ERROR."""
    text: str


def events_of(run: RecordedRun) -> list[Event]:
    """Beams that are lost and found, faults, commands, and events of the link and of the processes, in order."""
    return sorted([*_lost_beams(run.measurement), *_faults(run), *_messages(run)])


def _lost_beams(measured: Measurement) -> Iterator[Event]:
    """Beams whose ranges become invalid, with the reason, and valid again."""
    valid = measured.range_valid
    for beam in range(measured.beam_count):
        changes = np.flatnonzero(np.diff(valid[:, beam], prepend=True))
        for shot in changes.tolist():
            time_ns = int(measured.time_ns[shot, beam])
            if valid[shot, beam]:
                yield Event(time_ns, "INFO", f"beam {beam}: valid")
            else:
                reason = Reason(measured.reason[shot, beam]).name.lower()
                yield Event(time_ns, "WARN", f"beam {beam}: {reason}")


def _faults(run: RecordedRun) -> Iterator[Event]:
    """The first shot of each time that a fault acts: shots that follow one another are one time."""
    apart_ns = 1.5e9 / run.recording.scenario.timing.rate_hz
    for kind, times_ns in run.faults_ns.items():
        acted_ns = np.unique(times_ns)
        first = np.diff(acted_ns, prepend=np.iinfo(np.int64).min // 2) > apart_ns
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
